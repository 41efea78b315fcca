"""Lists of known faults with counts that may only shrink, for the lints of this folder."""

from __future__ import annotations

import argparse
from pathlib import Path

Counts = dict[str, int]  # entry -> its count
Lists = dict[str, Counts]  # title -> its entries


def read_lists(path: Path, titles: list[str]) -> Lists:
    """Read the lists of a file. A title that the file does not have gets no entries."""
    lists: Lists = {title: {} for title in titles}
    title = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            title = line.strip("[]")
        elif line and not line.startswith("#"):
            number, entry = line.split(" ", 1)
            lists.setdefault(title, {})[entry] = int(number)
    return lists


def write_lists(path: Path, head: str, lists: Lists) -> None:
    """Write the lists to a file, below the comment `head`."""
    parts = [head]
    for title, counts in lists.items():
        parts.append(f"\n[{title}]\n")
        parts += [f"{number} {entry}\n" for entry, number in sorted(counts.items())]
    path.write_text("".join(parts), encoding="utf-8")


def compare(listed: Lists, now: Lists) -> tuple[list[str], list[str]]:
    """Return the messages for counts that grew, and the messages for counts that shrank."""
    worse, better = [], []
    for title, counts in now.items():
        known = listed[title]
        for entry, number in counts.items():
            if number > known.get(entry, 0):
                was = f"was {known[entry]}" if entry in known else "is new"
                worse.append(f"{title}: {entry}: {number}, {was}")
        for entry, number in known.items():
            if counts.get(entry, 0) < number:
                better.append(f"{title}: {entry}: {counts.get(entry, 'none')}, was {number}")
    return worse, better


def shrunk(listed: Lists, now: Lists) -> Lists:
    """Return the lists with lower counts, and without entries that have no fault now."""
    return {
        title: {e: min(n, counts[e]) for e, n in listed[title].items() if counts.get(e)}
        for title, counts in now.items()
    }


def check_or_write(program: str, path: Path, head: str, now: Lists, write: bool, files: int) -> int:
    """Compare the counts with the file, or write lower counts to it. Return the exit status."""
    listed = read_lists(path, list(now)) if path.exists() or not write else now
    worse, better = compare(listed, now)
    for fault in worse:
        print(f"worse: {fault}")
    if write:
        write_lists(path, head, shrunk(listed, now))
        print(f"{program}: {len(better)} entries written")
    else:
        for gain in better:
            print(f"better: {gain}")
        if better:
            print(f"{program}: write the lower numbers with tools/lint/{program}.py --write")
    print(f"{program}: {files} files, {len(worse)} faults")
    return 1 if worse else 0


def read_options(arguments: list[str], description: str, lists: str) -> argparse.Namespace:
    """Read the command line of a lint. `lists` names what the option --lists prints."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--lists", action="store_true", help=f"print every {lists}")
    parser.add_argument("--check", action="store_true", help="compare with the lists")
    parser.add_argument("--write", action="store_true", help="write what became better")
    parser.add_argument("root", nargs="?", type=Path, default=Path(__file__).resolve().parents[2])
    return parser.parse_args(arguments)
