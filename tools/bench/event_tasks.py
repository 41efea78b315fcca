#!/usr/bin/env python3
"""Compare gradients through contact events with a zeroth-order gradient, on eight tasks.

The reference is the zeroth-order gradient of the smoothed loss at a quarter of the task's sigma:
the mean of (L(theta + s w) - L(theta - s w)) w / (2 s) over normal samples w. For each task, solver
and start, the program prints the standard error of the reference relative to its length. For each
contact_gradient it prints the cosine with the reference, the length relative to it, and the label.
    python tools/bench/event_tasks.py --only toss --samples 4096 --starts 4
"""

from __future__ import annotations

import argparse
import time
from typing import NamedTuple

import numpy as np
from event_task_machines import TASKS
from event_task_scenes import Task

PART_OF_SIGMA = 0.25


class Reference(NamedTuple):
    """A zeroth-order gradient and its relative standard error, in units of sigma."""

    gradient: np.ndarray
    error: float  # relative to the length of the gradient


class Gradient(NamedTuple):
    """A comparison of a gradient with a reference."""

    cosine: float
    length: float  # relative to the length of the reference
    label: str


def start_of(task: type[Task], number: int) -> np.ndarray:
    """Return the parameters of a start. Later starts are random, two sigma around the first."""
    noise = np.random.default_rng(number).normal(size=len(task.start)) if number > 0 else 0.0
    return np.float64(task.start) + 2.0 * np.float64(task.sigma) * noise


def smoothed(task: Task, theta: np.ndarray, samples: int, seed: int = 5) -> Reference:
    """Return the zeroth-order gradient in units of sigma, from antithetic samples."""
    half, rng = task.worlds // 2, np.random.default_rng(seed)
    step = PART_OF_SIGMA * np.float64(task.sigma)
    found = []
    for _ in range(-(-samples // task.worlds)):
        noise = rng.normal(size=(half, len(theta)))
        losses = task.losses(theta + np.concatenate([noise, -noise]) * step)
        found.append((losses[:half] - losses[half:])[:, None] * noise / (2 * PART_OF_SIGMA))
    each = np.concatenate(found)
    mean = each.mean(axis=0)
    spread = np.linalg.norm(each.std(axis=0)) / np.sqrt(len(each))
    return Reference(mean, float(spread / np.linalg.norm(mean)))


def compare(task: Task, theta: np.ndarray, reference: Reference) -> Gradient:
    """Compare the gradient of one world with a reference."""
    gradients, info = task.gradients(theta[None])
    ours = gradients[0] * np.float64(task.sigma)
    length = np.linalg.norm(ours)
    wanted = np.linalg.norm(reference.gradient)
    cosine = ours @ reference.gradient / max(length * wanted, 1e-30)
    return Gradient(float(cosine), float(length / wanted), info.label)


def main() -> None:
    """Print a line for each task, solver and start, and the medians over the starts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="part of the class names of tasks")
    parser.add_argument("--starts", type=int, default=4)
    parser.add_argument("--samples", type=int, default=4096)
    parser.add_argument("--worlds", type=int, default=64, help="samples of one rollout")
    options = parser.parse_args()
    for kind in TASKS:
        if options.only.lower() not in kind.__name__.lower():
            continue
        many = kind(options.worlds)
        singles = [kind(1, mode) for mode in kind.modes]
        all_of: dict[str, list[Gradient]] = {mode: [] for mode in kind.modes}
        for number in range(options.starts):
            began = time.perf_counter()
            theta = start_of(kind, number)
            reference = smoothed(many, theta, options.samples)
            line = f"{kind.name:9} {kind.solver_name:24} {number} error {reference.error:.3f}"
            for single in singles:
                of = compare(single, theta, reference)
                all_of[single.mode].append(of)
                line += f" | {single.mode} {of.cosine:.3f} {of.length:.3f} ({of.label})"
            print(f"{line} | {time.perf_counter() - began:.1f} s", flush=True)
        line = f"{kind.name:9} {kind.solver_name:24} medians"
        for mode, found in all_of.items():
            cosine, length = (np.median([of[i] for of in found]) for i in (0, 1))
            line += f" | {mode} {cosine:.3f} {length:.3f}"
        print(line, flush=True)


if __name__ == "__main__":
    main()
