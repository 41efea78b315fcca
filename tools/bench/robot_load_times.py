#!/usr/bin/env python3
"""Time the loading of robot files into a model, in NovaPhy, MuJoCo, Pinocchio and Newton.
    python tools/bench/robot_load_times.py FOLDER [--kind mjcf|urdf] [--manifest OUT.json]

FOLDER is the folder of robot_files.py. Every engine loads a file twice, with meshes, and the
shorter time counts. Engines that are not installed are left out.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
import warnings
from pathlib import Path

from robot_collections import Worker, finish, read_options, run_files


def load_novaphy(path: str, kind: str, folders: list[str]) -> None:
    import novaphy

    builder = novaphy.ModelBuilder()
    add = builder.add_mjcf if kind == "mjcf" else builder.add_urdf
    add(path, package_dirs=folders)
    builder.finalize()


def load_newton(path: str, kind: str, folders: list[str]) -> None:
    import newton

    builder = newton.ModelBuilder()
    (builder.add_mjcf if kind == "mjcf" else builder.add_urdf)(path)
    builder.finalize(device="cpu")


def load_mujoco(path: str, kind: str, folders: list[str]) -> None:
    import mujoco

    mujoco.MjModel.from_xml_path(path)


def load_pinocchio(path: str, kind: str, folders: list[str]) -> None:
    import pinocchio

    model = pinocchio.buildModelFromUrdf(path)
    packages = [str(Path(path).parent), *folders]
    for what in (pinocchio.GeometryType.COLLISION, pinocchio.GeometryType.VISUAL):
        pinocchio.buildGeomFromUrdf(model, path, what, package_dirs=packages)


ENGINES = {
    "mjcf": {"NovaPhy": load_novaphy, "MuJoCo": load_mujoco, "Newton": load_newton},
    "urdf": {"NovaPhy": load_novaphy, "Pinocchio": load_pinocchio, "Newton": load_newton},
}


def seconds_of(load, *of) -> float | None:
    times = []
    for _ in range(2):
        start = time.perf_counter()
        try:
            load(*of)
        except Exception:
            return None
        times.append(time.perf_counter() - start)
    return min(times)


def worker() -> None:
    warnings.simplefilter("ignore")
    for line in sys.stdin:
        task = json.loads(line)
        of = task["path"], task["kind"], task["folders"]
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
            all_of = {name: seconds_of(load, *of) for name, load in ENGINES[task["kind"]].items()}
        seconds = {name: value for name, value in all_of.items() if value is not None}
        print("\0" + json.dumps({"seconds": seconds}), flush=True)


def table(rows: list[dict], kind: str) -> None:
    """Print the table of the files that NovaPhy and the other engine load."""
    print(
        "| engine | files that both load | NovaPhy | the other one | ratio of sums "
        "| ratio of medians |"
    )
    print("|---|---|---|---|---|---|")
    lines = []
    for other in list(ENGINES[kind])[1:]:
        both = [r for r in rows if {"NovaPhy", other} <= set(r["seconds"])]
        if not both:
            continue
        mine, theirs = ([r["seconds"][e] for r in both] for e in ("NovaPhy", other))
        middle = sorted(theirs)[len(both) // 2] / sorted(mine)[len(both) // 2]
        print(
            f"| {other} | {len(both)} | {sum(mine):.2f} s | {sum(theirs):.2f} s "
            f"| {sum(theirs) / sum(mine):.1f} | {middle:.1f} |"
        )
        ratios = sorted(
            (b / a, f"{1e3 * a:9.2f} ms {1e3 * b:9.2f} ms  {r['file']}")
            for a, b, r in zip(mine, theirs, both, strict=True)
        )
        above = sum(ratio >= 5.0 for ratio, _ in ratios)
        lines.append(f"\n{other}: {above} of {len(both)} files take 5 times as long or more")
        lines += [f"  {ratio:7.2f}  {text}" for ratio, text in ratios[:12]]
    print("\n".join(lines))


def main() -> None:
    args = read_options(__doc__.splitlines()[0])
    if args.worker:
        return worker()
    rows = [
        {"file": str(path.relative_to(args.folder)), "seconds": result.get("seconds", {})}
        for _, path, result in run_files(args, Worker(__file__))
    ]
    finish(args, rows, table)


if __name__ == "__main__":
    main()
