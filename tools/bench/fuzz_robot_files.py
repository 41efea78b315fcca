#!/usr/bin/env python3
"""Read mutated robot files, each of which must load or give an error with file and line.
    python tools/bench/fuzz_robot_files.py FOLDER [--count 20000] [--seed 1]

FOLDER has one folder for each collection, as for robot_files.py. Each round takes a file of at most
100 kB, and changes it in one to four places: numbers, attributes, elements, bytes, names of files,
includes, ends. Then the program reads the changed file in the folder of its meshes.

Prints the number of files that were read, refused with a line number, and refused without a line
number. Faults are a crash, more than 30 s, more than 4 GiB of memory, and an opened file outside of
the folders. The program prints the rounds of faults, and then exits with 1. Linux only.
"""

from __future__ import annotations

import argparse
import collections
import ctypes
import json
import os
import random
import re
import resource
import select
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

SECONDS, MEMORY, LARGEST = 30.0, 4 << 30, 100_000
NUMBERS = (
    "0",
    "-1",
    "1e38",
    "1e400",
    "-1e-320",
    "nan",
    "inf",
    "",
    "7 7",
    "x",
    "0x10",
    "1e9",
    "3.5",
)
IN_OPEN, IN_NONBLOCK = 0x20, 0x800


class Watch:
    """Detects whether a process opens a file of a folder."""

    def __init__(self, folder: Path) -> None:
        self.libc = ctypes.CDLL(None, use_errno=True)
        self.file = self.libc.inotify_init1(IN_NONBLOCK)
        if self.file < 0 or self.libc.inotify_add_watch(self.file, bytes(folder), IN_OPEN) < 0:
            raise OSError(ctypes.get_errno(), "inotify")

    def opened(self) -> bool:
        try:
            return bool(os.read(self.file, 65536))
        except BlockingIOError:
            return False


def mutate(text: bytes, random: random.Random, outside: Path, own: str) -> bytes:
    def places(pattern: bytes) -> list[re.Match]:
        return list(re.finditer(pattern, text))

    def put(match: re.Match | None, new: bytes) -> bytes:
        return text if match is None else text[: match.start()] + new + text[match.end() :]

    def one(pattern: bytes) -> re.Match | None:
        found = places(pattern)
        return random.choice(found) if found else None

    for _ in range(random.choice([1, 1, 1, 2, 3, 4])):
        kind = random.randrange(16)
        if kind <= 2:
            text = put(one(rb"[-+]?\d[\d.eE+-]*"), random.choice(NUMBERS).encode())
        elif kind == 3:
            text = put(one(rb'\s[\w:]+="[^"]*"'), b"")
        elif kind == 4:  # an attribute under another name, or of another element
            names = [m.group(1) for m in places(rb"\s([\w:]+)=")] or [b"x"]
            text = put(one(rb"(?<=\s)[\w:]+(?==)"), random.choice(names))
        elif kind == 5:
            values = [m.group() for m in places(rb'"[^"]*"')] or [b'""']
            text = put(one(rb'"[^"]*"'), random.choice(values))
        elif kind == 6:  # an element twice, or removed
            match = one(rb"<[^<>]*/>")
            again = b"" if match is None else match.group() * random.randint(0, 3)
            text = put(match, again)
        elif kind == 7:
            text = put(one(rb"</?\w+"), random.choice([b"<geom", b"</body", b"<", b"<!--", b"<x"]))
        elif kind == 8:  # cut off
            text = text[: random.randrange(len(text) + 1)]
        elif kind == 9:
            at = random.randrange(len(text) + 1)
            text = text[:at] + random.randbytes(random.randint(1, 8)) + text[at + 1 :]
        elif kind == 10:  # a part twice
            a, b = sorted(random.randrange(len(text) + 1) for _ in range(2))
            text = text[:b] + text[a : min(b, a + 4000)] + text[b:]
        elif kind == 11:  # a file name elsewhere
            name = random.choice(["secret.obj", "secret.stl", "secret.xml"])
            up = "../" * 12 + str(outside / name).lstrip("/")
            ways = [str(outside / name), f"file://{outside / name}", up, f"package://x/{up}"]
            named = rb'"[^"]*\.(?:obj|stl|STL|dae|xml|png|msh)"'
            text = put(one(named), f'"{random.choice(ways)}"'.encode())
        elif kind == 12:  # the file itself, a missing file, or one outside
            name = random.choice([own, "missing.xml", str(outside / "secret.xml")])
            text = put(one(rb"<(?=\w)"), f'<include file="{name}"/><'.encode())
        elif kind == 13:
            entities = b'<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]>'
            text = entities + text.replace(b'name="', b'name="&b;', 1)
        elif kind == 14:  # nested deeply, or long
            text = put(one(rb"<(?=\w)"), b"<body>" * random.choice([10, 100, 3000]) + b"<")
        else:
            text = put(one(rb'(?<=")[^"]*(?=")'), b"1 " * random.choice([100, 100000]))
    return text


def worker(folder: Path, count: int, seed: int, start: int) -> None:
    import novaphy

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    files = []
    for path in sorted([*folder.rglob("*.xml"), *folder.rglob("*.urdf")]):
        if path.name.startswith(".fuzz") or not 0 < path.stat().st_size <= LARGEST:
            continue
        text = path.read_bytes()
        if b"<robot" in text or (b"<mujoco" in text and b"<worldbody" in text):
            files.append(path)
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as name:
        outside = Path(name)
        for secret in ("secret.obj", "secret.stl", "secret.xml"):
            (outside / secret).write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        watch = Watch(outside)
        for k in range(start, count):
            chance = random.Random(seed * 1_000_003 + k)
            path = chance.choice(files)
            print(f"\0{k} {path}", flush=True)
            mutated = path.with_name(f".fuzz{os.getpid()}{path.suffix}")
            collection = folder / path.relative_to(folder).parts[0]
            result = read(novaphy, path, mutated, chance, outside, collection)
            if watch.opened():
                result = "outside"
            print("\0" + json.dumps(result), flush=True)


def read(novaphy, path, mutated, chance, outside, collection) -> str:
    mutated.write_bytes(mutate(path.read_bytes(), chance, outside, mutated.name))
    builder = novaphy.ModelBuilder()
    add = builder.add_urdf if path.suffix == ".urdf" else builder.add_mjcf
    try:
        unsupported = chance.choice(("error", "warn"))
        add(str(mutated), unsupported=unsupported, package_dirs=[str(collection)])
    except (ValueError, NotImplementedError) as error:
        if builder.body_count or builder.shape_count or builder.joint_count:
            return "builder changed"
        has_place = re.search(r"\.\w+:\d+: ", str(error))
        return "refused" if has_place else f"no place: {str(error)[:160]}"
    except MemoryError:
        return "memory"
    finally:
        mutated.unlink()
    try:
        builder.finalize()
    except (ValueError, NotImplementedError) as error:
        return f"refused by finalize: {str(error)[:80]}"
    return "read"


def said(process: subprocess.Popen) -> Iterator[str]:
    """Yield the lines of the worker process, until it ends or takes too long."""
    data, wait = b"", 4 * SECONDS
    while select.select([process.stdout], [], [], wait)[0]:
        more = os.read(process.stdout.fileno(), 65536)
        if not more:
            return
        *lines, data = (data + more).split(b"\n")
        for line in lines:
            if line.startswith(b"\0"):
                yield line[1:].decode()
        wait = SECONDS


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=20000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--start", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.start is not None:
        worker(args.folder, args.count, args.seed, args.start)
        return 0
    results: collections.Counter = collections.Counter()
    faults, notes, start = [], {}, 0
    while start < args.count:
        command = [sys.executable, __file__, str(args.folder), f"--count={args.count}"]
        process = subprocess.Popen(
            [*command, f"--seed={args.seed}", f"--start={start}"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        at = ""
        for text in said(process):
            if not text.startswith('"'):
                at = text
                continue
            result = json.loads(text)
            kind = result.partition(":")[0]
            results[kind] += 1
            if kind in ("outside", "memory", "builder changed"):
                faults.append(f"{kind}: round {at}")
            if ":" in result:
                notes.setdefault(result, at)
            start = int(at.split()[0]) + 1
        process.kill()
        code = process.wait()
        if start >= args.count:
            break
        what = f"crashed ({code})" if code not in (0, -9) else "took too long"
        results[what] += 1
        faults.append(f"{what}: round {at}")
        start = int(at.split()[0]) + 1 if at else args.count
    for kind, number in sorted(results.items()):
        print(f"{number:6d}  {kind}")
    for text, place in sorted(notes.items())[:20]:
        print(f"{text}  (round {place})")
    for fault in faults:
        print(f"FAULT {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
