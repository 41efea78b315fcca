#!/usr/bin/env python3
"""Optimize the tasks with contact events: with gradients, CMA-ES and random search.

Adam runs 100 iterations with the gradient of the motion, of the code, or of diff.smoothed with each
order. CMA-ES and random search get the processor time of Adam with the gradient of the motion. The
result of a run is the best loss of its points relative to the loss of its start. The table has the
median over the starts.
    python tools/bench/optimize_tasks.py --save runs.jsonl --jobs 8
    python tools/bench/optimize_tasks.py --table runs.jsonl --picture optimize-tasks.svg

Each run is a process with one thread, and writes one JSON line at its end. A run that has a line
does not run again. The first starts of all tasks run before the second starts. Only --picture needs
Matplotlib.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from event_task_machines import TASKS
from event_task_scenes import Task
from optimize_methods import GRADIENTS, ORDERS, SEARCHES, methods_of, run_one
from optimize_table import draw, table

# Tasks with slow gradients. Their runs begin first, so that no core is idle at the end.
LONG = ("ClothPenalty", "StrikePenalty", "TiltPenalty", "ClothVbdImplicit", "PushImpulse",
        "TossImpulse", "TossPenalty")  # fmt: skip
METHODS = [*GRADIENTS, *ORDERS, *SEARCHES]
GRACE = 60.0  # s beyond the limit of a run: for start-up and its last iteration


class Job(NamedTuple):
    """One run: a method on a task from one start."""

    kind: type[Task]
    start: int
    method: str

    @property
    def key(self) -> tuple[str, str, int, str]:
        """Return the key of the run's line."""
        return (self.kind.name, self.kind.solver_name, self.start, self.method)

    @property
    def base(self) -> Job:
        """Return the run whose processor time a search gets."""
        return self._replace(method=methods_of(self.kind)[0])

    @property
    def rank(self) -> tuple[int, bool, int, int]:
        """Return the sort key: starts first, then runs that searches need, then slow tasks."""
        name = self.kind.__name__
        long = LONG.index(name) if name in LONG else len(LONG)
        cost = ["smoothed 1", "smoothed mixed"].count(self.method)
        return (self.start, self != self.base, long, -cost)


class Running(NamedTuple):
    """A running process."""

    job: Job
    process: subprocess.Popen[str]
    output: Any
    began: float


def key_of(line: dict[str, Any]) -> tuple[str, str, int, str]:
    """Return the key of the run to which a line belongs."""
    return (line["task"], line["solver"], line["start"], line["method"])


def read(path: Path, settings: dict[str, Any]) -> dict[tuple[str, str, int, str], dict[str, Any]]:
    """Return the lines of a file by run. ValueError: a line has other settings."""
    if not path.exists():
        return {}
    lines = [json.loads(line) for line in path.read_text("utf-8").splitlines() if line]
    for line in lines:
        other = {name: line[name] for name in settings}
        if other != settings:
            raise ValueError(f"{path}: expected runs with {settings}, got {other}")
    return {key_of(line): line for line in lines}


def begin(job: Job, options: argparse.Namespace, seconds: float) -> Running:
    """Start the process of a run."""
    output = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115
    threads = dict.fromkeys(
        ("NOVAPHY_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
    )
    command = [
        sys.executable, __file__, "--run", job.kind.__name__, str(job.start), job.method,
        "--seconds", str(seconds), "--iterations", str(options.iterations),
        "--worlds", str(options.worlds), "--limit", str(options.limit),
    ]  # fmt: skip
    process = subprocess.Popen(
        command, stdout=output, stderr=subprocess.STDOUT, text=True, env=os.environ | threads
    )
    return Running(job, process, output, time.monotonic())


def end(of: Running, limit: float) -> dict[str, Any] | None:
    """Return the line of a run that has ended or exceeds its limit; None: it still runs."""
    late = time.monotonic() - of.began > limit + GRACE
    if of.process.poll() is None and not late:
        return None
    of.process.kill()
    code = of.process.wait()
    of.output.seek(0)
    said = of.output.read().strip().splitlines() or [""]
    of.output.close()
    if code == 0:
        return json.loads(said[-1])
    error = f"no end within {limit + GRACE:.0f} s" if late else f"exit code {code}: {said[-1]}"
    name = dict(zip(("task", "solver", "start", "method"), of.job.key))
    return name | {"iterations": 0, "seconds": [0.0], "best": [1.0], "error": error}


def next_of(waiting: list[Job], lines: dict[tuple[str, str, int, str], Any]) -> Job | None:
    """Remove and return the first job that can run. A search needs the time of its base."""
    for job in waiting:
        if job.method not in SEARCHES or job.base.key in lines:
            waiting.remove(job)
            return job
    return None


def run_all(jobs: list[Job], options: argparse.Namespace) -> None:
    """Run all jobs without a line, and append the lines as the runs end."""
    settings = {"wanted": options.iterations, "worlds": options.worlds}
    lines, began = read(options.save, settings), time.monotonic()
    waiting = sorted((job for job in jobs if job.key not in lines), key=lambda job: job.rank)
    running: list[Running] = []
    try:
        while (waiting or running) and time.monotonic() - began < options.budget:
            while len(running) < options.jobs and (job := next_of(waiting, lines)) is not None:
                base = lines.get(job.base.key, {"seconds": [0.0]})
                running.append(begin(job, options, base["seconds"][-1]))
            if not running:
                raise ValueError("--methods: expected the gradient of the motion with searches")
            for of in list(running):
                line = end(of, options.limit)
                if line is None:
                    continue
                running.remove(of)
                lines[of.job.key] = line | settings
                with options.save.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(lines[of.job.key]) + "\n")
                loss, seconds = line["best"][-1], line["seconds"][-1]
                name = ", ".join(map(str, of.job.key))
                print(f"{name}: {loss:.2g} in {seconds:.1f} s", flush=True)
            time.sleep(0.02)
    finally:
        for of in running:
            of.process.kill()
            of.process.wait()


def jobs_of(options: argparse.Namespace) -> list[Job]:
    """Return the jobs that the command line asks for."""
    kinds = [
        kind for kind in TASKS
        if any(part in kind.__name__.lower() for part in options.only.lower().split(","))
    ]  # fmt: skip
    wanted = options.methods.split(",") if options.methods else METHODS
    return [
        Job(kind, start, method)
        for kind in kinds
        for start in range(options.starts)
        for method in methods_of(kind)
        if method in wanted
    ]


def main() -> None:
    """Run one job, run all jobs, or print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="parts of the class names of tasks, by commas")
    parser.add_argument("--methods", default="", help="names of methods, by commas")
    parser.add_argument("--starts", type=int, default=4)
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--worlds", type=int, default=16, help="samples and populations")
    parser.add_argument("--save", type=Path, default=Path("optimize-tasks.jsonl"),
                        help="file for lines of JSON, which are appended")  # fmt: skip
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--limit", type=float, default=600.0, help="the most of one run, s")
    parser.add_argument("--budget", type=float, default=float("inf"),
                        help="the most of all runs, s; unfinished ones leave no line")  # fmt: skip
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of saved runs")
    parser.add_argument("--picture", metavar="FILE", help="with --table: draw the runs, too")
    parser.add_argument("--run", nargs=3, metavar=("CLASS", "START", "METHOD"), help="one run")
    parser.add_argument("--seconds", type=float, default=0.0, help="with --run: of a search")
    options = parser.parse_args()
    if options.run:
        name, start, method = options.run
        kind = next(kind for kind in TASKS if kind.__name__ == name)
        line = run_one(kind, int(start), method, options.worlds, options.iterations,
                       options.limit, options.seconds)  # fmt: skip
        return print(json.dumps(line))
    if options.table:
        order = [(kind.name, kind.solver_name) for kind in TASKS]
        lines = read(options.table, {})
        runs = [lines[key] for key in sorted(lines, key=lambda key: order.index(key[:2]))]
        print(table(runs, METHODS, runs[0]["wanted"]))
        return draw(runs, METHODS, options.picture) if options.picture else None
    return run_all(jobs_of(options), options)


if __name__ == "__main__":
    main()
