#!/usr/bin/env python3
"""Check that every header of an installation compiles by itself.
    tools/check_headers.py PREFIX/include

The environment variable CXX chooses the compiler. The exit code is 1 if a header does not compile
without another header before it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path


def errors(folder: Path, header: Path) -> str:
    """Return the compiler's message for a header; empty: the header compiles."""
    compiler = os.environ.get("CXX", "c++")
    words = [compiler, "-std=c++20", "-fsyntax-only", "-w", f"-I{folder}", "-include", header]
    done = subprocess.run(
        [*words, "-x", "c++", "/dev/null"], capture_output=True, text=True, check=False
    )
    return done.stderr if done.returncode != 0 else ""


def main(arguments: list[str]) -> int:
    """Check all headers of a folder."""
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
