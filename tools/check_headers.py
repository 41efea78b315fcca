#!/usr/bin/env python3
"""Compile every header of an installation by itself.

    tools/check_headers.py PREFIX/include

CXX chooses the compiler. The exit code is 1 where a header needs another one before it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path


def errors(folder: Path, header: Path) -> str:
    """Return what the compiler says of a header; nothing: an empty string."""
    compiler = os.environ.get("CXX", "c++")
    words = [compiler, "-std=c++20", "-fsyntax-only", "-w", f"-I{folder}", "-include", header]
    done = subprocess.run(
        [*words, "-x", "c++", "/dev/null"], capture_output=True, text=True, check=False
    )
    return done.stderr if done.returncode != 0 else ""


def main(arguments: list[str]) -> int:
    """Check the headers of a folder."""
    if len(arguments) != 1:
        print(__doc__, file=sys.stderr)
        return 2
    folder = Path(arguments[0])
    headers = sorted(folder.rglob("*.h"))
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        said = list(pool.map(lambda header: errors(folder, header), headers))
    for header, text in zip(headers, said, strict=True):
        if text:
            print(f"{header.relative_to(folder)}:\n{text}")
    print(f"check_headers: {len(headers)} headers, {sum(map(bool, said))} faults")
    return 1 if any(said) or not headers else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
