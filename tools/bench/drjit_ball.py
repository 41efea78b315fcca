#!/usr/bin/env python3
"""Time the ball training iteration, written in Dr.Jit with its LLVM backend.

The scene, the iteration and the JSON lines are those of newton_ball.py. The substeps are unrolled,
because Dr.Jit cannot differentiate a recorded loop backward over its states. The two contacts of
every ball (wall and ground) are those that Newton and NovaPhy find for the first state, and stay
constant. Terms that are zero in this scene are left out, as in the mode `lean` of jax_ball.py.

Modes:
* `lean`: Python traces all substeps in every iteration. From the second iteration on, Dr.Jit finds
  the kernel in its cache.
* `frozen`: the iteration is a function under `drjit.freeze`, which is traced once and replayed.

A single ball runs as two balls, and the loss counts only the first. LLVM takes minutes to compile a
kernel whose arrays have one entry, and a vector register has room for more than two balls.

The cache of kernels on disk is not used. `compile_s` is the time of the first iteration minus the
median. `first_s` is the time from the start of building the scene to the end of the first
iteration. Dr.Jit loads libLLVM, version 15 or newer, at run time. If it is not found,
`DRJIT_LIBLLVM_PATH` can name the file. Without libLLVM the record has the reason in `skipped`.
    pip install drjit==1.5.0 numpy
    python tools/bench/drjit_ball.py --n 1 10 1000 --iterations 20
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time

import numpy as np

MODES = ("lean", "frozen")
STEPS = 36 * 8
DT = float(np.float32((1.0 / 60) / 8))
TRAIN_RATE = float(np.float32(0.02))


def ball_offsets(n: int) -> np.ndarray:
    """Return the x offsets of the balls {n} (m, float32)."""
    if n == 1:
        return np.zeros(1, np.float32)
    return (np.arange(n) % 7 - 3).astype(np.float32) * np.float32(0.05)


class Balls:
    """N balls, their contacts and training iteration."""

    def __init__(self, n: int, mode: str) -> None:
        """Build the scene."""
        import drjit as dr
        from drjit.llvm.ad import Array3f, Float

        def vectors(x: np.ndarray | float, y: float, z: float) -> Array3f:
            return Array3f(*(Float(np.full(n, c, np.float32)) for c in (x, y, z)))

        def numbers(value: float) -> Float:
            return dr.opaque(Float, value)  # an input of the kernel, not a constant

        self.dr, self.vector = dr, Array3f
        x = ball_offsets(n)
        counted = np.ones(n, np.float32)
        if n == 1:
            n, x, counted = 2, np.zeros(2, np.float32), np.float32([1.0, 0.0])
        self.scene = {
            "position": vectors(x, -0.5, 1.0),
            "target": vectors(x, -2.0, 1.5),
            "radius": Float(np.full(n, 0.1, np.float32)),
            # The nearest points of the wall y = 1.75 and of the ground z = 0.
            "points": [vectors(x, 1.75, 1.0), vectors(x, -0.5, 0.0)],
            "normals": [vectors(0.0, -1.0, 0.0), vectors(0.0, 0.0, 1.0)],
            "counted": Float(counted),
            "ke": numbers(1.0e4),
            "kd": numbers(1.0e1),
            "gravity": Array3f(numbers(0.0), numbers(0.0), numbers(-9.81)),
        }
        self.velocity = vectors(0.0, 5.0, -5.0)
        dr.eval(self.scene, self.velocity)
        self.step = dr.freeze(self.train) if mode == "frozen" else self.train

    def loss_of(self, velocity, scene):
        """Return the loss of the rollout."""
        dr = self.dr
        x, v = scene["position"], velocity
        for _ in range(STEPS):
            force = scene["gravity"]
            for point, normal in zip(scene["points"], scene["normals"]):
                c = dr.dot(normal, x - point) - scene["radius"]
                vn = dr.dot(normal, v)
                damping = dr.select(vn < 0, vn, 0)  # LLVM 15 cannot compile dr.minimum
                push = c * scene["ke"] + damping * scene["kd"]
                force = force - normal * dr.select(c > 0, 0, push)
            v = v + force * DT
            x = x + v * DT
        delta = x - scene["target"]
        return dr.sum(dr.dot(delta, delta) * scene["counted"])

    def train(self, velocity, scene):
        """Return the loss and the updated velocity."""
        dr = self.dr
        velocity = self.vector(velocity)
        dr.enable_grad(velocity)
        loss = self.loss_of(velocity, scene)
        dr.backward(loss)
        updated = dr.detach(velocity) - dr.grad(velocity) * TRAIN_RATE
        loss = dr.detach(loss)
        dr.eval(loss, updated)
        return loss, updated

    def iterate(self) -> None:
        """Run one training iteration."""
        self.loss, self.velocity = self.step(self.velocity, self.scene)
        self.dr.eval(self.loss, self.velocity)
        self.dr.sync_thread()


def measure(n: int, mode: str, iterations: int) -> dict[str, object]:
    """Build the scene, run it, and return the record to print."""
    import drjit as dr

    record: dict[str, object] = {
        "engine": "drjit",
        "version": dr.__version__,
        "scene": "ball",
        "mode": mode,
        "n": n,
        "iterations": iterations,
    }
    if not dr.has_backend(dr.JitBackend.LLVM):
        return record | {"skipped": "Dr.Jit finds no libLLVM of version 15 or newer"}
    start = time.perf_counter()
    balls = Balls(n, mode)
    initial = balls.velocity
    balls.iterate()
    first = time.perf_counter() - start
    balls.iterate()  # `frozen` replays from the second call on

    balls.velocity = initial
    seconds = []
    for _ in range(iterations):
        before = time.perf_counter()
        balls.iterate()
        seconds.append(time.perf_counter() - before)
    median = statistics.median(seconds)
    return record | {
        "median_s": median,
        "min_s": min(seconds),
        "first_s": first,
        "compile_s": first - median,
        "loss": float(balls.loss[0]),
    }


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--n", type=int, nargs="+", default=[1], help="numbers of balls")
    parser.add_argument("--mode", choices=MODES, nargs="+", default=["lean"])
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
    with tempfile.TemporaryDirectory() as home:
        os.environ["HOME"] = home  # Dr.Jit stores compiled kernels below it
        for mode in arguments.mode:
            for n in arguments.n:
                print(json.dumps(measure(n, mode, arguments.iterations)), flush=True)


if __name__ == "__main__":
    main()
