#!/usr/bin/env python3
"""Measure the sources, and compare their faults with a list.
    tools/lint/measure_house.py            sizes of the folders, and the counts
    tools/lint/measure_house.py --lists    also print every entry of every count
    tools/lint/measure_house.py --check    compare the counts with tools/lint/house.txt
    tools/lint/measure_house.py --write    write lower counts, and remove entries without a fault

house.txt lists the known faults with their counts. The lists may only shrink: --check fails on a
new entry and on a higher count, and prints their names. --write never raises a count. The entry of
a renamed file is edited by hand. If house.txt does not exist, --write creates it.

Tests are not measured. Tokens are identifiers, numbers and operators, and a string is one token.
Line breaks and comments do not change the number of tokens.
"""

from __future__ import annotations

import re
import sys
from collections import Counter, defaultdict
from collections.abc import Callable

from house_sources import (
    ENGINE,
    PHYSICS,
    ROOMS,
    TOKEN,
    Source,
    cxx_functions,
    python_functions,
    read_sources,
)
from ratchet import Counts, check_or_write, read_options

MOST_FUNCTION_LINES = 60
MOST_FILE_LINES = 400
MOST_DRIVES = 8  # arrays of joint drives that a file may name, of 12

# ---- counts ----


def long_functions(sources: list[Source]) -> Counts:
    found: Counts = {}
    for source in sources:
        if source.name.endswith(".pyi"):
            continue
        functions = cxx_functions(source.code) if source.is_cxx else python_functions(source.tree)
        seen: Counter[str] = Counter()
        for name, lines in functions:
            if lines > MOST_FUNCTION_LINES:
                seen[name] += 1
                times = f" ({seen[name]})" if seen[name] > 1 else ""
                found[f"{source.name} {name}{times}"] = lines
    return found


def long_files(sources: list[Source]) -> Counts:
    return {s.name: s.lines for s in sources if s.tree is None or s.name.endswith(".py")
            if s.lines > MOST_FILE_LINES}  # fmt: skip


def matches(pattern: str, rooms: tuple[str, ...]) -> Callable[[list[Source]], Counts]:
    """Return a function that counts the matches of a pattern in the files of some folders."""
    compiled = re.compile(pattern, re.MULTILINE)

    def count(sources: list[Source]) -> Counts:
        numbers = {s.name: len(compiled.findall(s.code)) for s in sources if s.within(rooms)}
        return {name: number for name, number in numbers.items() if number}

    return count


TWIN = re.compile(
    r"\b(?:class|struct)\s+(?:NOVAPHY_\w+\s+)?"
    r"(Launched\w*|StepWork|ReversePass|TangentPass"
    r"|(?:Device|Host|Cpu|Gpu)\w*(?:Step|Contacts|Adjoint|Tangent|Backward|Solution)\w*)\b[^;]*?\{"
)


def twin_classes(sources: list[Source]) -> Counts:
    return {name: 1 for s in sources if s.within(PHYSICS) for name in TWIN.findall(s.code)}


DRIVES = (
    *("target_q", "target_qd", "target_ke", "target_kd", "damping", "armature"),
    *("limit_lower", "limit_upper", "limit_ke", "limit_kd", "effort_limit", "velocity_limit"),
)


def lists_of_drives(sources: list[Source]) -> Counts:
    spelled = [{d, "joint_" + d, d.title().replace("_", "")} for d in DRIVES]
    found = {}
    for source in sources:
        if source.within(("dynamics", "vbd", "diff")):
            words = set(re.findall(r"[A-Za-z_]\w*", source.code))
            number = sum(1 for names in spelled if names & words)
            if number > MOST_DRIVES:
                found[source.name] = number
    return found


KINDS = {
    "tetrahedron": r"[Tt]etrahedr|\bparticle_tet_|\bkTet",
    "bending hinge": r"[Hh]inge|[Bb]ending|\bparticle_edge_",
    "cone": (
        r"\bCONE\b|(?<!friction_)\bcone_(?:support|distance|feature|bounds|inertia|mesh)"
        r"|\bshape_cone\b|\bCone(?:Shape|Support|Law)\b"
    ),
    "ball joint": r"\bBALL\b|\bjoint_ball\b|\bLinkJoint::Ball\b",
}


def files_of_kinds(sources: list[Source]) -> Counts:
    """Return how many files name each kind, without demos and benchmarks."""
    found = {}
    for kind, pattern in KINDS.items():
        compiled = re.compile(pattern)
        users = [s for s in sources if not s.name.startswith(("tools/bench/", "python/demos/"))]
        found[kind] = sum(1 for s in users if compiled.search(s.code))
    return found


COUNTS: dict[str, Callable[[list[Source]], Counts]] = {
    f"functions over {MOST_FUNCTION_LINES} lines": long_functions,
    f"files over {MOST_FILE_LINES} lines": long_files,
    "kernels with counted words": matches(
        r"^NOVAPHY_(?:ROW|BLOCK|GRID)_KERNEL\(\s*\w+\s*,\s*(?:[^,)]*\d|\w*Words)[^,)]*,", ENGINE
    ),
    "positional argument lists": matches(
        r"vector<LaunchArgument>|\.launch\([^;{]*\{(?!\s*\.)", PHYSICS
    ),
    "branches by host or device": matches(
        r"\bis_cpu\(\)|\bon_cpu_\b|\blaunched_\b|\bon_device\(\)|#ifdef NOVAPHY_KERNEL", PHYSICS
    ),
    "twin classes": twin_classes,
    f"files with over {MOST_DRIVES} of the drive arrays": lists_of_drives,
    "files that name a kind": files_of_kinds,
}


# ---- the lists ----

HEAD = """\
# Today's faults, each with its number. The lists may only shrink: tools/lint/measure_house.py
# --check compares, --write writes lower numbers.
"""


# ---- printing ----


def print_sizes(sources: list[Source]) -> None:
    sizes: dict[str, Counter[str]] = defaultdict(Counter)
    for source in sources:
        tokens = len(TOKEN.findall(source.code))
        code = sum(1 for line in source.code.split("\n") if line.strip(' \t"'))
        row = Counter(files=1, lines=source.lines, code=code, tokens=tokens)
        sizes[source.room] += row
        for together, rooms in (("engine", ENGINE), ("physics", PHYSICS)):
            if source.within(rooms):
                sizes[together] += row
    columns = ("files", "lines", "code", "tokens")
    print(f"{'':24}" + "".join(f"{column:>10}" for column in columns))
    for room in (*ROOMS, "python/novaphy (stubs)", "engine", "physics"):
        print(f"{room:24}" + "".join(f"{sizes[room][column]:10,}" for column in columns))


def print_counts(now: dict[str, Counts], entries: bool) -> None:
    for title, counts in now.items():
        print(f"{title:48}{len(counts):5} entries, sum {sum(counts.values()):,}")
        if entries:
            for entry, number in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
                print(f"  {number:5} {entry}")


def main(arguments: list[str]) -> int:
    """Print the measures, compare the counts with the list, or write the list."""
    options = read_options(arguments, "Measure the sources.", "entry")
    sources = read_sources(options.root)
    now = {title: count(sources) for title, count in COUNTS.items()}
    if not (options.check or options.write):
        print_sizes(sources)
        print_counts(now, options.lists)
        return 0
    path = options.root / "tools" / "lint" / "house.txt"
    return check_or_write("measure_house", path, HEAD, now, options.write, len(sources))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
