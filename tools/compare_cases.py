#!/usr/bin/env python3
"""Compare the names of the test cases in two sets of JUnit files.
    tools/compare_cases.py BEFORE AFTER

BEFORE and AFTER are folders with the JUnit files of a run (build/log). The program prints every
name that only BEFORE has, and the number of names in each folder. The exit code is 1 if a name is
missing from AFTER, and 2 if a folder has no JUnit file.
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from test_results import case_name


def names(folder: Path) -> set[str]:
    """Return the names of all test cases in a folder's JUnit files."""
    files = sorted(folder.glob("*.xml"))
    if not files:
        print(f"{folder}: no JUnit file", file=sys.stderr)
        sys.exit(2)
    return {case_name(c) for file in files for c in ElementTree.parse(file).iter("testcase")}


def main() -> int:
    """Compare the two folders that the command line names."""
    if len(sys.argv) != 3:
        print(__doc__, file=sys.stderr)
        return 2
    before, after = (names(Path(argument)) for argument in sys.argv[1:])
    missing = sorted(before - after)
    for name in missing:
        print(f"missing: {name}")
    print(
        f"{len(before)} names before, {len(after)} after, {len(missing)} missing, "
        f"{len(after - before)} new"
    )
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
