#!/usr/bin/env python3
"""Optimize the tasks with contact events: with gradients, CMA-ES and random search.

Adam takes 100 iterations with the gradient of the motion, of the code, or with diff.smoothed of
each order. CMA-ES and random search take the processor time of Adam with the motion's gradient.
A run ends with the best loss of its points, relative to the loss of its start. The table has the
median of the starts.

    python tools/bench/optimize_tasks.py --only ball --save losses.jsonl
    python tools/bench/optimize_tasks.py --plot losses.jsonl optimize-tasks.svg

CMA-ES needs the package cma.
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from certify_tasks import function_of
from event_task_machines import TASKS
from event_task_scenes import Task
from event_tasks import start_of

from novaphy import diff, nova

STEP = 1.0  # of Adam, sigmas; falls to a tenth
PART = 0.25  # of sigma, of the samples of diff.smoothed
SPREAD = 2.0  # of random search and of the first generation of CMA-ES, sigmas
Slope = Callable[[np.ndarray], tuple[float, np.ndarray]]


class Run(NamedTuple):
    """The losses of a run, relative to the start, over processor time (s)."""

    seconds: list[float]
    best: list[float]


class Problem:
    """A task in units of sigma around one start."""

    def __init__(self, kind: type[Task], number: int, worlds: int) -> None:
        self.kind, self.worlds = kind, worlds
        self.start = start_of(kind, number)
        self.sigma = np.broadcast_to(np.float64(kind.sigma), self.start.shape)
        self.functions = {mode: function_of(kind, mode) for mode in kind.modes}
        self.first = float(self.losses(np.zeros((1, len(self.start))))[0])

    def losses(self, moves: np.ndarray) -> np.ndarray:
        """Return the losses {rows} of moves {rows, n} in units of sigma."""
        theta = nova.tensor(np.float32(self.start + moves * self.sigma))
        return self.functions["code"](theta).numpy().astype(np.float64)

    def slope_of(self, mode: str) -> Slope:
        """Return the loss and its gradient by a move."""

        def slope(move: np.ndarray) -> tuple[float, np.ndarray]:
            theta = nova.tensor(
                np.float32(self.start + move * self.sigma)[None], requires_grad=True
            )
            with nova.Tape() as tape:
                loss = self.functions[mode](theta)
                tape.backward(loss, nova.ones((1,)))
            return float(loss.numpy()[0]), theta.grad.numpy()[0] * self.sigma

        return slope

    def smooth_slope(self, order: Any, mode: str) -> Slope:
        """Return the mean loss of samples and its gradient; each call draws new samples."""
        calls = iter(range(1 << 30))

        def slope(move: np.ndarray) -> tuple[float, np.ndarray]:
            info: dict[str, Any] = {}
            loss = diff.smoothed(
                self.functions[mode], np.float32(self.start + move * self.sigma),
                PART * self.sigma, self.worlds, order, seed=next(calls), info=info,
            )  # fmt: skip
            return float(loss.numpy()[0]), np.float64(info["gradient"]) * self.sigma

        return slope


def adam(slope: Slope, size: int, iterations: int) -> Iterator[np.ndarray]:
    """Yield the points of Adam from 0; its steps fall to a tenth along a cosine."""
    x, m, v = np.zeros(size), np.zeros(size), np.zeros(size)
    for k in range(iterations):
        _, g = slope(x)
        m, v = 0.9 * m + 0.1 * g, 0.99 * v + 0.01 * g * g
        part = 0.55 + 0.45 * np.cos(np.pi * k / iterations)
        moved = m / (1 - 0.9 ** (k + 1)) / (np.sqrt(v / (1 - 0.99 ** (k + 1))) + 1e-12)
        x = x - STEP * part * moved
        yield x


def random_search(problem: Problem, seconds: float, seed: int) -> Iterator[tuple[float, float]]:
    """Yield processor time and loss of samples around the best point, until the time is over."""
    rng, began = np.random.default_rng(seed), time.process_time()
    best, size, width = problem.first, len(problem.start), SPREAD
    at = np.zeros(size)
    while (spent := time.process_time() - began) < seconds:
        moves = at + width * rng.normal(size=(problem.worlds, size))
        losses = problem.losses(moves)
        k = int(np.nanargmin(losses))
        if losses[k] < best:
            best, at = float(losses[k]), moves[k]
        else:
            width = max(0.7 * width, 1e-3)
        yield spent, float(losses[k])


def cma_es(problem: Problem, seconds: float, seed: int) -> Iterator[tuple[float, float]]:
    """Yield processor time and loss of the generations of CMA-ES, until the time is over."""
    cma = importlib.import_module("cma")
    began, size = time.process_time(), len(problem.start)
    options = {"popsize": problem.worlds, "seed": seed + 1, "verbose": -9, "tolfun": 0}
    search = cma.CMAEvolutionStrategy(np.zeros(size), 0.5 * SPREAD, options)
    while (spent := time.process_time() - began) < seconds:
        moves = np.array(search.ask())
        losses = problem.losses(moves)
        search.tell(list(moves), list(losses))
        yield spent, float(np.nanmin(losses))


def run_adam(problem: Problem, slope: Slope, iterations: int) -> Run:
    """Run Adam; the losses of its points are evaluated outside of its time."""
    seconds, best, outside, began = [0.0], [1.0], 0.0, time.process_time()
    for k, move in enumerate(adam(slope, len(problem.start), iterations)):
        if k % 5 and k != iterations - 1:
            continue
        paused = time.process_time()
        loss = float(problem.losses(move[None])[0]) / problem.first
        outside += time.process_time() - paused
        seconds.append(paused - began - outside + (time.process_time() - paused))
        best.append(min(best[-1], loss))
    return Run(seconds, best)


def run_search(problem: Problem, search: Iterator[tuple[float, float]]) -> Run:
    """Run a search to its end."""
    seconds, best = [0.0], [1.0]
    for spent, loss in search:
        seconds.append(spent)
        best.append(min(best[-1], loss / problem.first))
    return Run(seconds, best)


def runs_of(problem: Problem, iterations: int, number: int) -> Iterator[tuple[str, Run]]:
    """Yield the name and the run of each method."""
    modes = problem.functions
    mode = "motion" if "motion" in modes else "code"
    one = problem.slope_of(mode)
    one(np.zeros(len(problem.start)))  # compiles
    first = run_adam(problem, one, iterations)
    yield mode, first
    if mode == "motion":
        yield "code", run_adam(problem, problem.slope_of("code"), iterations)
    for order in (0, 1, "mixed"):
        slope = problem.smooth_slope(order, mode)
        yield f"smoothed {order}", run_adam(problem, slope, iterations)
    problem.losses(np.zeros((problem.worlds, len(problem.start))))
    for name, search in (("random search", random_search), ("CMA-ES", cma_es)):
        yield name, run_search(problem, search(problem, first.seconds[-1], number))


def medians(found: list[dict[str, Any]]) -> dict[tuple[str, str], dict[str, tuple[float, float]]]:
    """Return the median of the last losses and times, by task and solver, and by method."""
    rows: dict[tuple[str, str], dict[str, tuple[float, float]]] = {}
    for of in found:
        mine = [x for x in found if all(x[k] == of[k] for k in ("task", "solver", "method"))]
        ends = [(x["best"][-1], x["seconds"][-1]) for x in mine]
        loss, seconds = (float(np.median([end[k] for end in ends])) for k in (0, 1))
        rows.setdefault((of["task"], of["solver"]), {})[of["method"]] = (loss, seconds)
    return rows


def print_table(found: list[dict[str, Any]]) -> None:
    """Print a row of medians per task and solver."""
    rows = medians(found)
    methods = list(dict.fromkeys(of["method"] for of in found))
    print("| Task | Solver | " + " | ".join(methods) + " |")
    print("|---" * (len(methods) + 2) + "|")
    for (task, solver), of in rows.items():
        cells = [f"{100 * of[m][0]:.2g} %, {of[m][1]:.1f} s" if m in of else "-" for m in methods]
        print(f"| {task} | {solver} | " + " | ".join(cells) + " |")


def plot(found: list[dict[str, Any]], path: str) -> None:
    """Draw the median loss over processor time, a panel per task and solver."""
    figure = importlib.import_module("matplotlib.figure")
    panels = list(medians(found))
    columns = min(3, len(panels))
    lines = -(-len(panels) // columns)
    drawing = figure.Figure(figsize=(4.2 * columns, 2.9 * lines), layout="constrained")
    for k, (task, solver) in enumerate(panels):
        axes = drawing.add_subplot(lines, columns, k + 1)
        methods: dict[str, list[dict[str, Any]]] = {}
        for of in found:
            if (of["task"], of["solver"]) == (task, solver):
                methods.setdefault(of["method"], []).append(of)
        for method, runs in methods.items():
            end = float(np.median([run["seconds"][-1] for run in runs]))
            grid = np.linspace(0.0, end, 60)
            each = []
            for run in runs:
                last = np.searchsorted(run["seconds"], grid, side="right") - 1
                each.append(np.array(run["best"])[last])
            axes.semilogy(grid, np.median(each, axis=0), label=method, linewidth=1.3)
        axes.set(title=f"{task}, {solver}", xlabel="processor time, s", ylim=(1e-5, 1.2))
        axes.title.set_fontsize(9)
        if k == 0:
            axes.set_ylabel("loss / loss of the start")
            axes.legend(fontsize=6)
    drawing.savefig(path)


def main() -> None:
    """Print a table, and keep the runs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="part of the class names of tasks")
    parser.add_argument("--starts", type=int, default=4)
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--worlds", type=int, default=16, help="samples and populations")
    parser.add_argument("--save", type=Path, help="file for lines of JSON, which are appended")
    parser.add_argument("--plot", nargs=2, metavar=("RUNS", "PICTURE"), help="draw saved runs")
    options = parser.parse_args()
    if options.plot:
        lines = Path(options.plot[0]).read_text("utf-8").splitlines()
        found = [json.loads(line) for line in lines]
        print_table(found)
        return plot(found, options.plot[1])
    found = []
    for kind in TASKS:
        if options.only.lower() not in kind.__name__.lower():
            continue
        for number in range(options.starts):
            problem = Problem(kind, number, options.worlds)
            for method, run in runs_of(problem, options.iterations, number):
                of = {"task": kind.name, "solver": kind.solver_name, "start": number,
                      "method": method, "seconds": run.seconds, "best": run.best}  # fmt: skip
                found.append(of)
                if options.save is not None:
                    with options.save.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(of) + "\n")
    print_table(found)
    return None


if __name__ == "__main__":
    main()
