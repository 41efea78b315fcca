"""Find robot files in folders, and run worker processes that read them."""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

SECONDS = 120.0  # longest time for a file (s)


def find_files(root: Path, kind: str) -> list[tuple[str, Path]]:
    """Return the collection and the path of each file with different content."""
    seen: set[str] = set()
    found = []
    for collection in sorted(p for p in root.iterdir() if p.is_dir()):
        files = sorted(collection.rglob("*.xml" if kind == "mjcf" else "*.urdf"))
        texts = {f: f.read_bytes() for f in files if f.is_file()}
        included = set()
        if kind == "mjcf":
            for file, text in texts.items():
                for name in re.findall(rb'<include[^>]*file="([^"]*)"', text):
                    included.add((file.parent / name.decode("utf-8", "replace")).resolve())
        for file, text in texts.items():
            if kind == "mjcf" and (
                b"<mujoco" not in text or not re.search(rb"<worldbody|<include", text)
            ):
                continue
            digest = hashlib.sha256(text).hexdigest()
            if digest in seen or file.resolve() in included:
                continue
            seen.add(digest)
            found.append((collection.name, file))
    return found


class Worker:
    """A worker process that reads files. It may crash or take too long."""

    def __init__(self, script: str) -> None:
        self.script = script
        self.process: subprocess.Popen | None = None

    def run(self, task: dict) -> dict:
        if self.process is None:
            self.process = subprocess.Popen(
                [sys.executable, self.script, "--worker"],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            )  # fmt: skip
        self.process.stdin.write(json.dumps(task) + "\n")
        self.process.stdin.flush()
        while True:
            ready, _, _ = select.select([self.process.stdout], [], [], SECONDS)
            line = self.process.stdout.readline() if ready else ""
            if line.startswith("\0"):
                return json.loads(line[1:])
            if not line:
                self.process.kill()
                what = "took too long" if not ready else f"crashed ({self.process.wait()})"
                self.process = None
                return {"novaphy": what, "warn": what, "oracle": "?", "difference": {}}


def read_options(description: str) -> argparse.Namespace:
    """Read the command line of a program that runs over collections, or as its worker process."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--kind", choices=("mjcf", "urdf"), default="mjcf")
    parser.add_argument("--only", help="collections, separated by commas")
    parser.add_argument("--manifest", type=Path, help="writes all results to this file")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.folder is None and not args.worker:
        parser.error("expected a folder of collections")
    return args


def run_files(args: argparse.Namespace, runner: Worker) -> Iterator[tuple[str, Path, dict]]:
    """Yield the collection, the path and the worker's result of each file."""
    for collection, path in find_files(args.folder, args.kind):
        if args.only and collection not in args.only.split(","):
            continue
        folders = [str(args.folder / collection)]
        result = runner.run({"path": str(path), "kind": args.kind, "folders": folders})
        yield collection, path, result


def finish(args: argparse.Namespace, rows: list[dict], table: Callable) -> None:
    """Write the manifest if the command line asks for one, and print the table."""
    if args.manifest:
        args.manifest.write_text(json.dumps(rows, indent=1))
    table(rows, args.kind)
