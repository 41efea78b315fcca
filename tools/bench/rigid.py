"""Scenes of rigid bodies, command line and timing for the programs `*_rigid.py`.

Scenes, of size N:
* `columns`: N boxes (side 0.2 m, 8 kg) in aligned columns of ten that do not touch each other.
  `--turn` rotates every box about its vertical axis.
* `pile`: N boxes in one pile of square layers. Every second layer is shifted by half a box, so that
  a box stands on up to four boxes. Contacts connect all boxes.
* `mixed`: N shapes (spheres, capsules, cylinders, boxes, hulls, in turn) that lie on hills of 2048
  triangles.
* `dice`: N dice, each falling alone on the ground (the die of `demo_diffsim_dice.py`). A step of
  the measurement is a training iteration: 768 substeps, the squared norm of the last twists, the
  backward pass.

`--stiffer X` multiplies the stiffness of penalty forces by X and divides the step by the square
root of X. Boxes then overlap X times less, while damping and friction keep the same relation to
their stability limits.

A record has the median CPU and wall time of the timed steps, the number of contacts, the number of
touching contacts, and the mean depth of touching contacts after the timed steps.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

HALF, DENSITY, GRAVITY = 0.1, 1000.0, 9.81
SURFACE = {"ke": 2.0e5, "kd": 300.0, "kf": 200.0, "mu": 0.5}
SCENES = ("columns", "pile", "mixed", "dice")
# The hills: cells along a side, and the length of a cell (m). Contacts on hills are softer.
HILLS, HILL_CELL = 32, 0.35
MIXED_SURFACE = {"ke": 2.0e4, "kd": 60.0, "kf": 80.0, "mu": 0.5}
MIXED_KINDS = ("sphere", "capsule", "cylinder", "box", "hull")
# The contact material of the die.
DIE = {"ke": 1.0e4, "kd": 300.0, "kf": 500.0, "mu": 0.5}
DIE_MASS, DIE_HEIGHT, DIE_SPIN, DIE_SUBSTEPS, DIE_DT = 4.0, 0.6, (1.0, 5.0, 2.0), 768, 1.0 / 960


def box_poses(scene: str, n: int, turn: float, factor: float = 1.0) -> np.ndarray:
    """Return positions and quaternions (x, y, z, w) of the boxes {n, 7}.

    Columns start with the overlap at which the penalty forces of `--stiffer factor` carry them on
    four rows for each face. They are therefore at rest from the first step on.
    """
    weight = DENSITY * (2 * HALF) ** 3 * GRAVITY
    poses = np.zeros((n, 7))
    poses[:, 5:] = np.sin(turn / 2), np.cos(turn / 2)
    columns = max(1, n // 10)
    side = int(np.ceil(columns**0.5)) if scene == "columns" else max(1, round(n ** (1 / 3)))
    for i in range(n):
        if scene == "columns":
            layer, place = divmod(i, columns)
            gap, shift = 0.5, 0.0
        else:
            layer, place = divmod(i, side * side)
            gap, shift = 2.02 * HALF, HALF * (layer % 2)
        poses[i, :3] = gap * (place % side) + shift, gap * (place // side) + shift, 0.0
        poses[i, 2] = HALF * (1 + 2 * layer)
        if scene == "columns":
            height = -(-n // columns)
            borne = sum(height - below for below in range(layer + 1))
            poses[i, 2] -= borne * weight / (4 * SURFACE["ke"] * factor)
    return poses


def hill_height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of the ground of the scene `mixed` (m)."""
    return 0.25 * np.sin(1.3 * x) * np.sin(1.1 * y)


def hills() -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles of the hills, counter-clockwise seen from above."""
    line = (np.arange(HILLS + 1) - HILLS / 2) * HILL_CELL
    x, y = (grid.ravel() for grid in np.meshgrid(line, line))
    row = HILLS + 1
    corner = (np.arange(HILLS)[:, None] * row + np.arange(HILLS)).reshape(-1, 1)
    triangles = np.concatenate([corner + np.array(k) for k in ((0, 1, row + 1), (0, row + 1, row))])
    return (
        np.stack([x, y, hill_height(x, y)], axis=1).astype(np.float32),
        triangles.astype(np.int32),
    )


def mixed_poses(n: int) -> np.ndarray:
    """Return positions and quaternions {n, 7} of `mixed`, slightly above the ground."""
    side = int(np.ceil(n**0.5))
    poses = np.zeros((n, 7))
    poses[:, 6] = 1.0
    poses[:, 0], poses[:, 1] = (0.45 * (k - (side - 1) / 2) for k in np.divmod(np.arange(n), side))
    poses[:, 2] = hill_height(poses[:, 0], poses[:, 1]) + 0.17
    return poses


def stone() -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles of a truncated pyramid with eight sides."""
    angles = np.arange(8) * np.pi / 4
    rings = [
        np.stack([r * np.cos(angles), r * np.sin(angles), np.full(8, z)], axis=1)
        for r, z in ((0.12, -0.08), (0.08, 0.08))
    ]
    k, next_k = np.arange(8), (np.arange(8) + 1) % 8
    sides = [np.stack([k, next_k, next_k + 8], 1), np.stack([k, next_k + 8, k + 8], 1)]
    fan, zero = np.arange(1, 7), np.zeros(6, int)
    caps = [np.stack([zero, fan + 1, fan], 1), np.stack([zero + 8, fan + 8, fan + 9], 1)]
    return np.concatenate(rings).astype(np.float32), np.concatenate([*sides, *caps]).astype(
        np.int32
    )


def stiffer(surface: dict[str, float], factor: float) -> dict[str, float]:
    """Return the material of a surface with the stiffness of --stiffer."""
    root = factor**0.5
    return surface | {
        "ke": surface["ke"] * factor,
        "kd": surface["kd"] * root,
        "kf": surface["kf"] * root,
    }


class Scene(Protocol):
    """A scene in one engine, as the programs of the engines implement it."""

    dt: float
    """Simulated time of a step, s."""

    def step(self) -> None:
        """Run one step, which is finished when the call returns."""

    def contacts(self) -> np.ndarray:
        """Return the depths of all contacts {count} (m). A negative depth means a gap."""


class PenaltyBoxes:
    """Boxes under gravity on the ground, by the interface that Newton and NovaPhy share.

    Subclasses make `model`, `solver`, `pipeline`, the contacts `found`, and two states.
    """

    dt = 1.0 / 960

    def step(self) -> None:
        """Find contacts, and run one step."""
        self.now.clear_forces()
        self.pipeline.collide(self.now, self.found)
        self.solver.step(self.now, self.next, None, self.found, self.dt)
        self.now, self.next = self.next, self.now

    def contacts(self) -> np.ndarray:
        """Return the depths of the current contact rows (m)."""
        self.pipeline.collide(self.now, self.found)
        count = int(self.found.rigid_contact_count.numpy()[0])
        rows = {
            name: getattr(self.found, f"rigid_contact_{name}").numpy()[:count]
            for name in ("shape0", "shape1", "point0", "point1", "normal", "margin0", "margin1")
        }
        bodies, poses = self.model.shape_body.numpy(), self.now.body_q.numpy()
        ends = [in_world(poses, bodies[rows[f"shape{k}"]], rows[f"point{k}"]) for k in (0, 1)]
        apart = np.einsum("ij,ij->i", ends[1] - ends[0], rows["normal"])
        return rows["margin0"] + rows["margin1"] - apart


def in_world(poses: np.ndarray, bodies: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points of bodies in world coordinates. Body -1 is the world."""
    result = points.astype(np.float64)
    own = bodies >= 0
    q = poses[bodies[own]].astype(np.float64)
    v, w, p = q[:, 3:6], q[:, 6:], result[own]
    result[own] = q[:, :3] + p + 2 * np.cross(v, np.cross(v, p) + w * p)
    return result


def measure(
    make: Callable[[], Scene], warm: int, steps: int, facts: dict[str, object]
) -> dict[str, object]:
    """Build the scene, run it, and return the record to print."""
    scene = make()
    for _ in range(warm):
        scene.step()
    wall, cpu = [], []
    for _ in range(steps):
        start, used = time.perf_counter(), time.process_time()
        scene.step()
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - used)
    depth = scene.contacts()
    touching = depth[depth > 0]
    return facts | {
        "steps": steps,
        "dt_s": scene.dt,
        "median_s": statistics.median(wall),
        "cpu_median_s": statistics.median(cpu),
        "contacts": len(depth),
        "touching": len(touching),
        "mean_depth_m": float(touching.mean()) if len(touching) else 0.0,
    }


def run(doc: str, engine: str, make: Callable[..., Scene], scenes: tuple[str, ...]) -> None:
    """Run the command line of all programs. make(scene, n, turn, factor, device) makes a scene."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", choices=scenes, default=scenes[0])
    parser.add_argument("--n", type=int, default=100, help="bodies")
    parser.add_argument("--turn", type=float, default=0.0, help="of every box, degrees")
    parser.add_argument("--stiffer", type=float, default=1.0, help="factor, of penalty forces")
    parser.add_argument("--warm", type=int, default=100, help="steps before those that are timed")
    parser.add_argument("--steps", type=int, default=200, help="timed steps")
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    if arguments.n < 1 or arguments.steps < 1 or arguments.warm < 0:
        parser.error("--n and --steps must be positive, --warm not negative")
    if not arguments.stiffer > 0:
        parser.error(f"--stiffer: expected a number > 0, got {arguments.stiffer}")
    facts = {"engine": engine, "scene": arguments.scene, "n": arguments.n, "turn": arguments.turn}
    facts["stiffer"] = arguments.stiffer
    record = measure(
        lambda: make(
            arguments.scene,
            arguments.n,
            np.radians(arguments.turn),
            arguments.stiffer,
            arguments.device,
        ),
        arguments.warm,
        arguments.steps,
        facts | {"device": arguments.device},
    )
    print(json.dumps(record))
