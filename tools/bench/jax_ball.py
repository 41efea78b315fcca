#!/usr/bin/env python3
"""Time the ball training iteration, written in JAX, on the CPU.

The scene, the iteration and the JSON lines are those of newton_ball.py. An iteration is one call of
a compiled function: `value_and_grad` of a loss over `lax.scan` of the substeps, and the update. The
two contacts of every ball (wall and ground) are those that Newton and NovaPhy find for the first
state, and stay constant. Positions, velocities, contacts and material are arguments of the
function, so that the compiler cannot treat them as constants. A vector is a tuple of three arrays
{n}, the form that XLA compiles to the fastest code.

Modes:
* `full`: the contact law with every term: elastic force, damping, friction with its cone, the
  cut-off, the flag of the particle and the limit of its velocity.
* `lean`: without the terms that are zero in this scene: friction (kf is 0), the flag, the limit,
  the mass of 1, the cut-off of 0, the mean of material values that are equal.

In `full` a vector of length 0 has no gradient, so that gradients stay finite.

`compile_s` is the time of tracing and compiling the iteration. `first_s` is the time from the start
of building the scene to the end of the first iteration, with compilation. A case that needs more
memory than is free does not run, and its record has the reason in `skipped`.
    pip install jax==0.10.2 jaxlib==0.10.2
    python tools/bench/jax_ball.py --n 1 10 1000 --mode lean --iterations 20
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

MODES = ("full", "lean")
STEPS = 36 * 8
DT = np.float32((1.0 / 60) / 8)
TRAIN_RATE = np.float32(0.02)


Vector = tuple[Array, Array, Array]
State = tuple[Vector, Vector]  # positions, velocities


class Scene(NamedTuple):
    """The inputs of the iteration. The lists have an entry for each contact: wall, ground."""

    position: Vector
    target: Vector
    radius: Array  # {n}
    inverse_mass: Array  # {n}
    active: Array  # {n}
    point: list[Vector]
    normal: list[Vector]
    material: Array  # {4}: ke, kd, kf, mu of the model
    shape_material: Array  # {2, 4}
    gravity: Vector  # of scalars
    max_velocity: Array
    adhesion: Array


def ball_offsets(n: int) -> np.ndarray:
    """Return the x offsets of the balls {n} (m, float32)."""
    if n == 1:
        return np.zeros(1, np.float32)
    return (np.arange(n) % 7 - 3).astype(np.float32) * np.float32(0.05)


def make_scene(n: int) -> tuple[Scene, Vector]:
    """Return the scene and the initial velocity."""

    def vectors(x: np.ndarray | float, y: float, z: float) -> Vector:
        return tuple(jnp.asarray(np.full(n, c, np.float32)) for c in (x, y, z))

    x = ball_offsets(n)
    material = jnp.asarray(np.float32([1.0e4, 1.0e1, 0.0, 0.2]))
    scene = Scene(
        position=vectors(x, -0.5, 1.0),
        target=vectors(x, -2.0, 1.5),
        radius=jnp.full(n, 0.1, jnp.float32),
        inverse_mass=jnp.ones(n, jnp.float32),
        active=jnp.ones(n, jnp.int32),
        # The nearest points of the wall y = 1.75 and of the ground z = 0.
        point=[vectors(x, 1.75, 1.0), vectors(x, -0.5, 0.0)],
        normal=[vectors(0.0, -1.0, 0.0), vectors(0.0, 0.0, 1.0)],
        material=material,
        shape_material=jnp.stack([material, material]),
        gravity=tuple(map(jnp.float32, (0.0, 0.0, -9.81))),
        max_velocity=jnp.float32(1.0e5),
        adhesion=jnp.float32(0.0),
    )
    return scene, vectors(0.0, 5.0, -5.0)


def add(a: Vector, b: Vector) -> Vector:
    """Return the sums of vectors."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def sub(a: Vector, b: Vector) -> Vector:
    """Return the differences of vectors."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(a: Vector, b: Array) -> Vector:
    """Return vectors times numbers."""
    return (a[0] * b, a[1] * b, a[2] * b)


def select(condition: Array, a: Vector, b: Vector) -> Vector:
    """Return the values of a if the condition holds, else those of b."""
    return tuple(jnp.where(condition, p, q) for p, q in zip(a, b))


def dot(a: Vector, b: Vector) -> Array:
    """Return the dot products of vectors {n}."""
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]


def length_and_unit(a: Vector) -> tuple[Array, Vector]:
    """Return lengths and directions. A vector of length 0 has the direction 0 and no gradient."""
    square = dot(a, a)
    there = square > 0
    length = jnp.where(there, jnp.sqrt(jnp.where(there, square, 1.0)), 0.0)
    divisor = jnp.where(there, length, 1.0)
    return length, tuple(jnp.where(there, c / divisor, 0.0) for c in a)


def full_contact(scene: Scene, k: int, x: Vector, v: Vector) -> Vector:
    """Return the force of contact k with all terms. The caller subtracts this force."""
    ke, kd, kf, mu = 0.5 * (scene.material + scene.shape_material[k])
    normal = scene.normal[k]
    c = dot(normal, sub(x, scene.point[k])) - scene.radius
    vn = dot(normal, v)
    tangential, direction = length_and_unit(sub(v, scale(normal, vn)))
    elastic = scale(scale(normal, c), ke)
    damping = scale(scale(normal, jnp.minimum(vn, 0.0)), kd)
    friction = scale(direction, jnp.minimum(kf * tangential, jnp.abs((mu * c) * ke)))
    none = (0.0, 0.0, 0.0)
    return select(c > scene.adhesion, none, add(elastic, add(damping, friction)))


def full_step(scene: Scene, x: Vector, v: Vector) -> State:
    """Run one substep with all terms."""
    force = sub(scale(full_contact(scene, 0, x, v), -1.0), full_contact(scene, 1, x, v))
    gravity = scale(scene.gravity, jnp.where(scene.inverse_mass > 0, 1.0, 0.0))
    moved = add(v, scale(add(scale(force, scene.inverse_mass), gravity), DT))
    speed, _ = length_and_unit(moved)
    fast = speed > scene.max_velocity
    factor = scene.max_velocity / jnp.where(fast, speed, 1.0)
    moved = select(fast, scale(moved, factor), moved)
    active = scene.active != 0
    return select(active, add(x, scale(moved, DT)), x), select(active, moved, v)


def lean_contact(scene: Scene, k: int, x: Vector, v: Vector) -> Vector:
    """Return the force of contact k without the terms that are zero. The caller subtracts it."""
    ke, kd = scene.material[0], scene.material[1]
    normal = scene.normal[k]
    c = dot(normal, sub(x, scene.point[k])) - scene.radius
    vn = dot(normal, v)
    return scale(normal, jnp.where(c > 0.0, 0.0, c * ke + jnp.minimum(vn, 0.0) * kd))


def lean_step(scene: Scene, x: Vector, v: Vector) -> State:
    """Run one substep without the terms that are zero."""
    force = add(lean_contact(scene, 0, x, v), lean_contact(scene, 1, x, v))
    v = add(v, scale(sub(scene.gravity, force), DT))
    return add(x, scale(v, DT)), v


def make_iteration(mode: str) -> Callable[[Vector, Scene], tuple[Array, Vector]]:
    """Return a training iteration that maps the initial velocity to the loss and a new velocity."""
    step = full_step if mode == "full" else lean_step

    def loss_of(velocity: Vector, scene: Scene) -> Array:
        def substep(state: State, _: None) -> tuple[State, None]:
            return step(scene, *state), None

        (x, _), _ = lax.scan(substep, (scene.position, velocity), None, length=STEPS)
        delta = sub(x, scene.target)
        return jnp.sum(dot(delta, delta))

    def iterate(velocity: Vector, scene: Scene) -> tuple[Array, Vector]:
        loss, gradient = jax.value_and_grad(loss_of)(velocity, scene)
        return loss, sub(velocity, scale(gradient, TRAIN_RATE))

    return iterate


def free_memory() -> int:
    """Return the bytes that a program can still allocate."""
    for line in Path("/proc/meminfo").read_text().splitlines():
        if line.startswith("MemAvailable"):
            return int(line.split()[1]) * 1024
    raise SystemExit("jax_ball: /proc/meminfo does not tell the free memory")


def measure(n: int, mode: str, iterations: int) -> dict[str, object]:
    """Build the scene, run it, and return the record to print."""
    record: dict[str, object] = {
        "engine": "jax",
        "version": jax.__version__,
        "device": str(jax.devices()[0].platform),
        "scene": "ball",
        "mode": mode,
        "n": n,
        "iterations": iterations,
    }
    start = time.perf_counter()
    scene, initial = make_scene(n)
    before_compile = time.perf_counter()
    iterate = jax.jit(make_iteration(mode)).lower(initial, scene).compile()
    record["compile_s"] = time.perf_counter() - before_compile
    needed = iterate.memory_analysis().temp_size_in_bytes
    record["temporary_bytes"] = needed
    if needed > free_memory():
        return record | {"skipped": f"needs {needed / 2**30:.0f} GiB"}
    jax.block_until_ready(iterate(initial, scene))
    record["first_s"] = time.perf_counter() - start

    velocity = initial
    seconds = []
    for _ in range(iterations):
        before = time.perf_counter()
        loss, velocity = jax.block_until_ready(iterate(velocity, scene))
        seconds.append(time.perf_counter() - before)
    return record | {
        "median_s": statistics.median(seconds),
        "min_s": min(seconds),
        "loss": float(loss),
    }


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--n", type=int, nargs="+", default=[1], help="numbers of balls")
    parser.add_argument("--mode", choices=MODES, nargs="+", default=["full"])
    parser.add_argument(
        "--iterations", type=int, default=20, help="timed iterations per measurement"
    )
    arguments = parser.parse_args()
    if min(arguments.n) < 1 or arguments.iterations < 1:
        parser.error("--n and --iterations must be positive")
    return arguments


def main() -> None:
    """Run every requested measurement."""
    arguments = parse_arguments()
    jax.config.update("jax_platforms", "cpu")
    for mode in arguments.mode:
        for n in arguments.n:
            print(json.dumps(measure(n, mode, arguments.iterations)), flush=True)


if __name__ == "__main__":
    main()
