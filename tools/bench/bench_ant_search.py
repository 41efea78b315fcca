#!/usr/bin/env python3
"""Compare analytic gradients with random search, for the Ant that learns to walk from zero.

All methods begin with 80 parameters of 0 and end with the stage `polish`, which uses no gradient
(demo_diffsim_ant_from_scratch.py). The methods differ in the stages before:
    derivatives  runs the stages of the demo
    staged       random search in the same stages, with the servo: the same losses and frames
    plain        random search only in the last of these stages, without the servo

Random search takes Gaussian steps of adaptive length. Random search gets the processor time that
derivatives took, and the same number of generations of `polish`. --seconds and --generations give
these budgets if derivatives has not run. Each seed is a process with two threads. A JSON file in
the folder stores the finished stages, so that an interrupted run can continue. Derivatives are not
random before `polish`, so they need one seed.
    python tools/bench/bench_ant_search.py results               # the missing runs, then the table
    python tools/bench/bench_ant_search.py results --jobs 8      # 8 processes at once
    python tools/bench/bench_ant_search.py results --page        # the table of the guide
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
GUIDE = ROOT / "docs" / "guide" / "trained-policy.md"
sys.path[:0] = [str(ROOT / "python" / "demos"), str(ROOT / "python" / "demos" / "diff")]
import demo_diffsim_ant_from_scratch as demo  # noqa: E402

from novaphy.io import atomic_path  # noqa: E402

METHODS = {
    "derivatives": "derivatives",
    "staged": "random search, the same stages with the servo",
    "plain": "random search without the servo",
}
THREADS = 2  # per process
COLUMNS = (
    "| method | seeds | cores, s | loss | checks | way in 30 s | "
    "checks behind `polish` | way behind it |"
)


def judged(actor: demo.Actor) -> dict[str, object]:
    """Return the loss of the last stage, and the checks of the gait that an actor passes."""
    trainer = demo.Trainer(actor, "frozen", "dva", candidates=1)
    name, horizon, _, strength = demo.STAGES[-1]
    trainer.enter(name, strength)
    loss = trainer.rollouts(actor.weights[None], horizon)[0][0]
    result = demo.validate(actor, demo.make_worlds(1, "dva"), range(600))
    checks = demo.checks_of(result, demo.friction_ratio(actor, "dva", 600))
    return {
        "loss": float(loss),
        "reached": sum(bool(passed) for passed, _ in checks.values()),
        "asked": len(checks),
        "way": float(result["distance"][0]),
        "slip": float(result["slip"][0]),
        "upright": bool(result["upright"][0]),
    }


class Run:
    """A run of a method with a seed, whose file stores the stages that are done."""

    def __init__(self, folder: Path, method: str, seed: int, budget: tuple[float, int]) -> None:
        """Read the file. `budget`: seconds of the stages, number of generations of `polish`."""
        self.folder, self.method, self.seed, self.budget = folder, method, seed, budget
        self.stages = demo.STAGES[-1:] if method == "plain" else demo.STAGES
        self.told = read(folder, method, seed) or {
            "method": method, "seed": seed, "weights": np.zeros((8, 10)).tolist(), "stages": [],
            "seconds": 0.0,
        }  # fmt: skip

    def save(self, actor: demo.Actor, begun: float, **more: object) -> None:
        """Write the weights and results to the file."""
        self.told |= {"weights": actor.weights.tolist(), **more}
        self.told["seconds"] += time.process_time() - begun
        with atomic_path(self.folder / f"{self.method}-{self.seed}.json") as path:
            Path(path).write_text(json.dumps(self.told, indent=1), "utf-8")

    def run(self) -> None:
        """Run the stages that the file does not have yet."""
        actor = demo.Actor(np.array(self.told["weights"]))
        trainer, (seconds, generations) = demo.Trainer(actor, "frozen", "dva"), self.budget
        share = seconds / sum(stage[1] * stage[2] for stage in self.stages)
        for k, stage in enumerate(self.stages):
            if k < len(self.told["stages"]):
                continue
            begun = time.process_time()
            if self.method == "derivatives":
                trainer.stage(*stage, np.inf)
                batches = len(trainer.losses)
            else:
                rng = demo.search_rng(self.seed, k)
                batches = len(demo.search_stage(trainer, rng, stage, share * stage[1] * stage[2]))
            stages = [*self.told["stages"], {"name": stage[0], "batches": batches}]
            self.save(actor, begun, stages=stages)
        if "before" not in self.told:
            seconds, before = self.told["seconds"], judged(actor)
            self.save(actor, time.process_time(), before=before, stages_seconds=seconds)
        if "after" not in self.told:
            begun = time.process_time()
            lacks = demo.polished(actor, "polish", "dva", self.seed, generations)
            self.save(actor, begun, generations=len(lacks), lacks=lacks)
            after = judged(actor)
            self.save(actor, time.process_time(), after=after)


def read(folder: Path, method: str, seed: int) -> dict | None:
    """Return the content of the file of a run; None if the run has not begun."""
    path = folder / f"{method}-{seed}.json"
    return json.loads(path.read_text("utf-8")) if path.exists() else None


def budget_of(args: argparse.Namespace, method: str) -> tuple[float, int]:
    """Return the seconds of the stages and the generations of `polish` of a method."""
    if method == "derivatives":
        return 0.0, args.generations or demo.GENERATIONS
    first = read(args.folder, "derivatives", 0) or {}
    if args.seconds and args.generations:
        return args.seconds, args.generations
    if "after" not in first:
        raise SystemExit(f"{args.folder}: expected derivatives-0.json, or --seconds, --generations")
    return args.seconds or first["stages_seconds"], args.generations or first["generations"]


def start(args: argparse.Namespace, method: str, seed: int) -> None:
    """Run a method with a seed in a separate process, and print the result."""
    done = read(args.folder, method, seed)
    if done and "after" in done:
        return
    number = str(THREADS)
    threads = {"NOVAPHY_NUM_THREADS": number, "OPENBLAS_NUM_THREADS": number}
    seconds, generations = map(str, budget_of(args, method))
    words = [sys.executable, __file__, str(args.folder), "--method", method, "--seed", str(seed)]
    words += ["--seconds", seconds, "--generations", generations]
    done = subprocess.run(words, env={**os.environ, **threads}, capture_output=True, text=True)
    last = (done.stdout + done.stderr).strip().splitlines()[-1:]
    print(f"{method}, seed {seed}: {'done' if done.returncode == 0 else last}", flush=True)


def spread(values: Iterable[float], digits: int, unit: str = "") -> str:
    """Return the median and the range of values as text."""
    values = list(values)
    text = f"{np.median(values):.{digits}f}{unit}"
    if len(values) > 1:
        text += f" ({min(values):.{digits}f} to {max(values):.{digits}f})"
    return text


def table(folder: Path, seeds: int) -> list[str]:
    """Return the rows of the guide's table."""
    lines = [COLUMNS, "|" + "---|" * (COLUMNS.count("|") - 1)]
    for method, name in METHODS.items():
        found = [read(folder, method, seed) for seed in range(seeds)]
        rows = [row for row in found if row and "before" in row]
        if rows:
            before, after = ([r[k] for r in rows if k in r] for k in ("before", "after"))
            of = before[0]["asked"]
            cells = [
                name,
                str(len(rows)),
                spread((row["stages_seconds"] for row in rows), 0),
                spread((row["loss"] for row in before), 1),
                f"{spread((row['reached'] for row in before), 0)} of {of}",
                spread((row["way"] for row in before), 2, " m"),
                f"{spread((row['reached'] for row in after), 0)} of {of}" if after else "–",
                spread((row["way"] for row in after), 2, " m") if after else "–",
            ]
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def write_page(lines: list[str]) -> None:
    """Replace the table in the guide."""
    text = GUIDE.read_text("utf-8").splitlines()
    first = text.index(COLUMNS)
    last = next(k for k in range(first, len(text)) if not text[k].startswith("|"))
    GUIDE.write_text("\n".join([*text[:first], *lines, *text[last:]]) + "\n", "utf-8")


def main() -> None:
    """Run the missing runs, and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of the files of JSON")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=1, help="processes at once")
    parser.add_argument("--seconds", type=float, default=0.0, help="of random search in the stages")
    parser.add_argument("--generations", type=int, default=0, help="of polish, at most")
    parser.add_argument("--method", choices=METHODS, help="one run, in this process")
    parser.add_argument("--seed", type=int, default=0, help="its seed")
    parser.add_argument("--page", action="store_true", help="write the table into the guide")
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    if args.method:
        Run(args.folder, args.method, args.seed, budget_of(args, args.method)).run()
        return
    if not args.page:
        first = [("derivatives", 0)]
        rest = [(method, seed) for seed in range(args.seeds) for method in ("staged", "plain")]
        for runs in [first + rest] if args.seconds else [first, rest]:
            with ThreadPoolExecutor(args.jobs) as pool:
                list(pool.map(lambda run: start(args, *run), runs))
    lines = table(args.folder, args.seeds)
    print("\n".join(lines))
    if args.page:
        write_page(lines)


if __name__ == "__main__":
    main()
