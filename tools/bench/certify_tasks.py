#!/usr/bin/env python3
"""Certify the gradients of the eight tasks with contact events, of the code and of the motion.

The program prints a row of the table in docs/performance-event-gradients.md for each task, solver,
start and contact_gradient. Three more scenes have a known verdict: a push out of reach, a double
pendulum, and a pendulum with a policy.
    python tools/bench/certify_tasks.py --only ball --starts 2

With --samples N the last column compares the gradient with the reference of event_tasks.py, from N
samples.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from functools import cache

import numpy as np
from certify_scenes import SCENES
from event_task_machines import TASKS, StrikePenalty
from event_task_scenes import Task
from event_tasks import smoothed, start_of

from novaphy import diff, nova


class StrikeMean(StrikePenalty):
    """The strike with the mean force of penalty contacts, whose loss is smooth."""

    solver_name = "semi-implicit, mean force"
    modes = ("code",)

    def settings(self) -> dict:
        """Return additional options of the solver."""
        return {**super().settings(), "penalty_law": "mean"}


def function_of(kind: type[Task], mode: str) -> Callable[[nova.Tensor], nova.Tensor]:
    """Return a function that maps parameters to the losses of a task."""

    @cache
    def task(worlds: int) -> Task:
        return kind(worlds, mode)

    def losses(theta: nova.Tensor) -> nova.Tensor:
        of = task(theta.shape[0])
        of.path = diff.Trajectory(of.model, of.steps)
        return of.run(theta)

    return losses


def compared(kind: type[Task], theta: np.ndarray, samples: int) -> Callable[[np.ndarray], str]:
    """Return a function of a gradient (per sigma) that gives cosine and relative length as text."""
    if samples == 0:
        return lambda gradient: "-"
    reference = smoothed(kind(64), theta, samples).gradient

    def text(gradient: np.ndarray) -> str:
        ours, wanted = np.linalg.norm(gradient), np.linalg.norm(reference)
        return f"{gradient @ reference / (ours * wanted):.3f}, {ours / wanted:.2f}"

    return text


def row_of(name: str, solver: str, what: str, found: diff.Certificate, truth: str = "-") -> str:
    """Return a row of the table."""
    wide, tiny = found.disagreements[1], found.disagreements[3]
    trust = "-" if found.trust_radius is None else f"{found.trust_radius:.2g}"
    return (
        f"| {name} | {solver} | {what} | {found.verdict} | {wide:.2f}, {tiny:.2f} "
        f"| {found.cosine:.2f}, {found.length:.2f} | {found.tail:.2g} | {trust} "
        f"| {found.cost:.1f} | {1e3 * found.seconds:.0f} ms | {truth} |"
    )


def main() -> None:
    """Print the rows of the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="part of the class names of tasks and scenes")
    parser.add_argument("--starts", type=int, default=1)
    parser.add_argument("--worlds", type=int, default=64, help="samples of a certificate")
    parser.add_argument("--samples", type=int, default=0, help="of the reference; 0: none")
    parser.add_argument("--seed", type=int, default=0, help="of the certificate")
    options = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)
    print("| Task | Solver | Gradient, start | Verdict | Disagreement over 0.3, 0.01 sigma "
          "| Smoothed: cosine, length | Tail | Trust radius | Cost | One gradient | Reference |"
          "\n|---|---|---|---|---|---|---|---|---|---|---|")  # fmt: skip
    for kind in [*TASKS, StrikeMean]:
        if options.only.lower() not in kind.__name__.lower():
            continue
        for number in range(options.starts):
            theta = start_of(kind, number)
            sigma = np.broadcast_to(np.float64(kind.sigma), theta.shape)
            text = compared(kind, theta, options.samples)
            for mode in kind.modes:
                f = function_of(kind, mode)
                found = diff.certify(f, theta, sigma, options.worlds, options.seed)
                what, truth = f'"{mode}", {number}', text(found.gradient)
                print(row_of(kind.name, kind.solver_name, what, found, truth), flush=True)
    for scene in SCENES:
        if options.only.lower() in scene.name.lower():
            found = diff.certify(
                scene.losses, scene.theta, scene.sigma, options.worlds, options.seed
            )
            print(row_of(scene.name, scene.solver_name, scene.what, found), flush=True)


if __name__ == "__main__":
    main()
