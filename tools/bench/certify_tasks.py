#!/usr/bin/env python3
"""Certify the gradients of the eight tasks with contact events, of the code and of the motion.

The program prints a row of the table in docs/performance-event-gradients.md per task, solver, start
and contact_gradient. Three more scenes have a known verdict: a push out of reach, a double
pendulum and a pendulum with a policy.

    python tools/bench/certify_tasks.py --only ball --starts 2
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from functools import cache

import numpy as np
from certify_scenes import SCENES
from event_task_machines import TASKS
from event_task_scenes import Task
from event_tasks import start_of

from novaphy import diff, nova


def function_of(kind: type[Task], mode: str) -> Callable[[nova.Tensor], nova.Tensor]:
    """Give the losses of a task as a function of parameters {worlds, n}."""

    @cache
    def task(worlds: int) -> Task:
        return kind(worlds, mode)

    def losses(theta: nova.Tensor) -> nova.Tensor:
        of = task(theta.shape[0])
        of.path = diff.Trajectory(of.model, of.steps)
        return of.run(theta)

    return losses


def row_of(name: str, solver: str, what: str, found: diff.Certificate) -> str:
    """Give a row of the table."""
    wide, tiny = found.disagreements[1], found.disagreements[3]
    trust = "-" if found.trust_radius is None else f"{found.trust_radius:.2g}"
    return (
        f"| {name} | {solver} | {what} | {found.verdict} | {wide:.2f}, {tiny:.2f} "
        f"| {found.cosine:.2f}, {found.length:.2f} | {found.tail:.2g} | {trust} "
        f"| {found.cost:.1f} | {1e3 * found.seconds:.0f} ms |"
    )


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="part of the class names of tasks and scenes")
    parser.add_argument("--starts", type=int, default=1)
    parser.add_argument("--worlds", type=int, default=64, help="samples")
    options = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)
    print("| Task | Solver | Gradient, start | Verdict | Disagreement over 0.3, 0.01 sigma "
          "| Smoothed: cosine, length | Tail | Trust radius | Cost | One gradient |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|")
    for kind in TASKS:
        if options.only.lower() not in kind.__name__.lower():
            continue
        for number in range(options.starts):
            for mode in kind.modes:
                theta = np.float32(start_of(kind, number))
                sigma = np.broadcast_to(np.float64(kind.sigma), theta.shape)
                found = diff.certify(function_of(kind, mode), theta, sigma, options.worlds)
                what = f'"{mode}", {number}'
                print(row_of(kind.name, kind.solver_name, what, found), flush=True)
    for scene in SCENES:
        if options.only.lower() in scene.name.lower():
            found = diff.certify(scene.losses, scene.theta, scene.sigma, options.worlds)
            print(row_of(scene.name, scene.solver_name, scene.what, found), flush=True)


if __name__ == "__main__":
    main()
