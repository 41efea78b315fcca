"""What the programs `*_rigid.py` have in common: scenes of rigid bodies, command line, timing.

Scenes, of size N:

* `columns`: N boxes (side 0.2 m, 8 kg) in aligned columns of ten that touch nothing else; `--turn`
  turns every box about its vertical axis.
* `pile`: N boxes in one pile: square layers, every second one shifted by half a box, so that every
  box stands on up to four. Contacts connect all of them.
* `dice`: N dice, each falling alone on the ground (the die of `demo_diffsim_dice.py`). One step
  of the measurement is a training iteration: 768 substeps, the squared norm of the last twists, the
  backward pass.

A record has the time of a step (its median over the timed steps, in CPU time of the process beside
wall time), how many contacts there are and how many of them touch, and the mean depth of those that
touch, after the timed steps.
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
SCENES = ("columns", "pile", "dice")
# The die.
DIE = {"ke": 1.0e4, "kd": 300.0, "kf": 500.0, "mu": 0.5}
DIE_MASS, DIE_HEIGHT, DIE_SPIN, DIE_SUBSTEPS, DIE_DT = 4.0, 0.6, (1.0, 5.0, 2.0), 768, 1.0 / 960


def box_poses(scene: str, n: int, turn: float) -> np.ndarray:
    """Positions and quaternions (x, y, z, w) of the boxes, {n, 7}."""
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
    return poses


class Scene(Protocol):
    """What an engine's program makes of a scene."""

    dt: float
    """Simulated time of a step, s."""

    def step(self) -> None:
        """One step, finished when it returns."""

    def contacts(self) -> np.ndarray:
        """Depths of all contacts, {count}; negative where they do not touch."""


class PenaltyBoxes:
    """Boxes under gravity on the ground, in Newton's interface, which NovaPhy's is too.

    Subclasses make `model`, `solver`, `pipeline`, its contacts `found`, and two states.
    """

    dt = 1.0 / 960

    def step(self) -> None:
        """Find contacts, step."""
        self.now.clear_forces()
        self.pipeline.collide(self.now, self.found)
        self.solver.step(self.now, self.next, None, self.found, self.dt)
        self.now, self.next = self.next, self.now

    def contacts(self) -> np.ndarray:
        """Depths of the present rows."""
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
    """Points of bodies in world coordinates; body -1 is the world."""
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
    """The command line of all programs. make(scene, n, turn, device) gives a scene."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", choices=scenes, default=scenes[0])
    parser.add_argument("--n", type=int, default=100, help="bodies")
    parser.add_argument("--turn", type=float, default=0.0, help="of every box, degrees")
    parser.add_argument("--warm", type=int, default=100, help="steps before those that are timed")
    parser.add_argument("--steps", type=int, default=200, help="timed steps")
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    if arguments.n < 1 or arguments.steps < 1 or arguments.warm < 0:
        parser.error("--n and --steps must be positive, --warm not negative")
    facts = {"engine": engine, "scene": arguments.scene, "n": arguments.n, "turn": arguments.turn}
    record = measure(
        lambda: make(arguments.scene, arguments.n, np.radians(arguments.turn), arguments.device),
        arguments.warm,
        arguments.steps,
        facts | {"device": arguments.device},
    )
    print(json.dumps(record))
