"""Write the table and the picture of the runs of optimize_tasks.py."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from optimize_methods import SEARCHES

Runs = list[dict[str, Any]]  # lines of optimize_methods.run_one
LEAST = 1e-8  # relative losses below this are equal, by float32 rounding


def by_task(runs: Runs) -> dict[tuple[str, str], dict[str, Runs]]:
    """Return the runs by (task, solver), and then by method."""
    rows: dict[tuple[str, str], dict[str, Runs]] = {}
    for run in runs:
        rows.setdefault((run["task"], run["solver"]), {}).setdefault(run["method"], []).append(run)
    return rows


def end_of(runs: Runs) -> tuple[float, float]:
    """Return the medians over runs of the last loss and of the processor time (s)."""
    medians = {key: np.median([run[key][-1] for run in runs]) for key in ("best", "seconds")}
    return float(medians["best"]), float(medians["seconds"])


def cell(runs: Runs, best: float, starts: int, iterations: int) -> str:
    """Return the median loss and time of runs as text. The least loss of a row is bold."""
    if not runs:
        return "-"
    loss, seconds = end_of(runs)
    text = f"{100 * loss:.2g} %" if loss > LEAST else f"< {100 * LEAST:.0e} %"
    parts = [f"**{text}**" if loss <= max(best, LEAST) else text, f"{seconds:.2g} s"]
    fewest = min(run["iterations"] for run in runs)
    if runs[0]["method"] not in SEARCHES and fewest < iterations:
        parts.append(f"{fewest} iterations")
    if len(runs) < starts:
        parts.append(f"{len(runs)} of {starts} starts")
    errors = sum(run["error"] is not None for run in runs)
    return ", ".join(parts + [f"{errors} ended by an error"] * (errors > 0))


def table(runs: Runs, methods: list[str], iterations: int) -> str:
    """Return a table with a row of medians for each task and solver, and the errors below."""
    lines = ["| Task | Solver | " + " | ".join(methods) + " |", "|---" * (len(methods) + 2) + "|"]
    for (task, solver), of in by_task(runs).items():
        starts = max(len(found) for found in of.values())
        best = min(end_of(found)[0] for found in of.values())
        cells = [cell(of.get(method, []), best, starts, iterations) for method in methods]
        lines.append(f"| {task} | {solver} | " + " | ".join(cells) + " |")
    for run in runs:
        if run["error"] is not None:
            name = f"{run['task']}, {run['solver']}, start {run['start']}, {run['method']}"
            lines.append(f"\n{name}: {run['error']}")
    return "\n".join(lines)


def draw(runs: Runs, methods: list[str], path: str) -> None:
    """Draw the median loss over processor time, one panel for each task and solver (Matplotlib)."""
    figure = importlib.import_module("matplotlib.figure")
    rows = by_task(runs)
    columns = min(4, len(rows))
    lines = -(-len(rows) // columns)
    drawing = figure.Figure(figsize=(3.6 * columns, 2.5 * lines), layout="constrained")
    named: dict[str, Any] = {}
    for k, ((task, solver), of) in enumerate(rows.items()):
        axes = drawing.add_subplot(lines, columns, k + 1)
        for method in (method for method in methods if method in of):
            grid = np.linspace(0.0, end_of(of[method])[1], 60)
            each = []
            for run in of[method]:
                last = np.searchsorted(run["seconds"], grid, side="right") - 1
                each.append(np.array(run["best"])[last])
            color = f"C{methods.index(method)}"
            median = np.median(each, axis=0)
            (named[method],) = axes.semilogy(grid, median, color=color, linewidth=1.2)
        axes.set_ylim(LEAST, 2.0)
        axes.set_title(f"{task}, {solver}", fontsize=8)
        axes.tick_params(labelsize=6)
    drawing.legend(named.values(), named, ncols=len(named), fontsize=8, loc="outside upper center")
    drawing.supxlabel("processor time, s", fontsize=8)
    drawing.supylabel("loss / loss of the start", fontsize=8)
    drawing.savefig(path)
