"""Scenes, command line and timing for newton_deformable.py and novaphy_deformable.py.

Scenes, of size N:
* `soft_body`: Newton's `diffsim_soft_body` example with a block of N³ cells (N = 2 in the example).
  Every particle has the same mass as in the example, so that the step stays stable. An iteration:
  materials from 2 parameters for each tetrahedron, 960 substeps, the squared distance of the
  centroid to the target, the backward pass, `p -= 1e7 * grad`, clamped to [500, 4e6].
* `cloth`: Newton's `diffsim_cloth` example with N² cells (N = 16 in the example) on one square
  meter. An iteration: 1,920 substeps, the squared distance of the centroid to the target, the
  backward pass, `v0 -= 5 * grad` over all particles.

`--steps` shortens the rollout, and the record has the number of timed substeps. The result hash is
the first 16 hex digits of the SHA-256 of the final positions of the first iteration (float32
bytes). For the soft body both engines give the same hash.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import resource
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np

SUBSTEPS = 16
DT = 1.0 / 60 / SUBSTEPS
STEPS = {"soft_body": 60 * SUBSTEPS, "cloth": 120 * SUBSTEPS}
TARGET = {"soft_body": (0.0, -1.0, 1.5), "cloth": (0.0, 8.0, 0.0)}
RATE = {"soft_body": 1.0e7, "cloth": 5.0}
BOUNDS = (500.0, 4.0e6)
GAP = 0.001
MATERIAL = {"ke": 1.0e3, "kd": 1.0, "kf": 0.0, "mu": 0.2}
YOUNG, POISSON = 1.5e4, 0.3


def soft_grid(n: int) -> dict[str, object]:
    """Return the arguments of add_soft_grid, which are the same in both engines."""
    cell = 0.1
    return {
        "pos": (-0.5 * cell * n, -0.5, 1.0),
        "rot": (0.0, 0.0, 0.0, 1.0),
        "vel": (0.0, 6.0, -6.0),
        "dim_x": n,
        "dim_y": n,
        "dim_z": n,
        "cell_x": cell,
        "cell_y": cell,
        "cell_z": cell,
        "density": (0.2 / 27) / cell**3,
        "k_mu": 0.5 * YOUNG / (1.0 + POISSON),
        "k_lambda": YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)),
        "k_damp": 0.0,
        "tri_ke": 1e-4,
        "tri_ka": 1e-4,
        "tri_kd": 1e-4,
    }


def cloth_grid(n: int) -> dict[str, object]:
    """Return the arguments of add_cloth_grid, which are the same in both engines."""
    half = -0.75 * np.pi / 2.0
    return {
        "pos": (0.0, 0.0, 0.0),
        "rot": (0.0, float(np.sin(half)), 0.0, float(np.cos(half))),
        "vel": (0.0, 0.1, 0.1),
        "dim_x": n,
        "dim_y": n,
        "cell_x": 1.0 / n,
        "cell_y": 1.0 / n,
        "mass": 1.0,
        "tri_ke": 1.0e4,
        "tri_ka": 1.0e4,
        "tri_kd": 100.0,
        "tri_lift": 10.0,
        "tri_drag": 5.0,
    }


class Scene(Protocol):
    """A scene in one engine, as the programs of the engines implement it."""

    def iterate(self) -> None:
        """Run one training iteration, which is finished when the call returns."""

    def prepare(self) -> None:
        """Wait for work that runs beside the first iterations, for example compilation."""

    def loss_value(self) -> float:
        """Return the loss of the last iteration, before its update."""

    def positions(self) -> np.ndarray:
        """Return the final positions of the last iteration {n, 3} (m)."""

    def elements(self) -> int:
        """Return the number of tetrahedra of a soft body, or of triangles of a cloth."""


def measure(
    make: Callable[[], Scene], iterations: int, facts: dict[str, object]
) -> dict[str, object]:
    """Build the scene, run it, and return the record to print."""
    start = time.perf_counter()
    scene = make()
    scene.iterate()
    first = time.perf_counter() - start
    loss = scene.loss_value()
    digest = hashlib.sha256(np.ascontiguousarray(scene.positions(), np.float32).tobytes())
    scene.prepare()
    seconds = []
    for _ in range(iterations):
        start = time.perf_counter()
        scene.iterate()
        seconds.append(time.perf_counter() - start)
    return facts | {
        "elements": scene.elements(),
        "iterations": iterations,
        "median_s": statistics.median(seconds),
        "min_s": min(seconds),
        "first_s": first,
        "first_loss": loss,
        "loss": scene.loss_value(),
        "peak_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
        "result_hash": digest.hexdigest()[:16],
    }


def run(
    doc: str, engine: str, modes: tuple[str, ...], make: Callable[..., Scene], facts: Callable
) -> None:
    """Run the command line of both programs. make(scene, n, mode, steps, device) makes a scene."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", choices=tuple(STEPS), nargs="+", default=["soft_body"])
    parser.add_argument("--n", type=int, nargs="+", default=[2], help="cells per side")
    parser.add_argument("--mode", choices=modes, nargs="+", default=["captured"])
    parser.add_argument("--iterations", type=int, default=5, help="timed iterations")
    parser.add_argument("--steps", type=int, help="substeps (default: those of the example)")
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    if min(arguments.n) < 1 or arguments.iterations < 1 or (arguments.steps or 1) < 1:
        parser.error("--n, --iterations and --steps must be positive")
    for scene in arguments.scene:
        steps = arguments.steps or STEPS[scene]
        for mode in arguments.mode:
            for n in arguments.n:
                build = partial(make, scene, n, mode, steps, arguments.device)
                record = {"engine": engine, "scene": scene, "mode": mode, "n": n, "substeps": steps}
                record["device"] = arguments.device
                record = measure(build, arguments.iterations, record | facts())
                print(json.dumps(record), flush=True)
