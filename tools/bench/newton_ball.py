#!/usr/bin/env python3
"""Time Newton's ball training iteration on many balls.

The scene is Newton's `diffsim_ball` example with N copies of its particle. An iteration is that of
the example: 288 semi-implicit substeps, the loss, the tape's backward pass, the update `v0 -= 0.02
* grad`, and clearing the gradients.

Scene, for ball k of N:
* offset `dx_k = ((k % 7) - 3) * 0.05` in float32 (0 if N is 1), position `(dx_k, -0.5, 1)`,
  velocity `(0, 5, -5)`, mass 1, radius 0.1, target `(dx_k, -2, 1.5)`;
* loss: the sum over k of `|x_k(288) - target_k|^2`;
* box wall and ground plane of the example, with contacts that are found once for the first state,
  with a gap of 10;
* no particle-particle contact (`model.particle_grid` is None). Newton skips this contact for one
  particle, and the distance of the copies is smaller than their diameter.

Modes:
* `eager`: every iteration launches its kernels from Python and records a new tape.
* `captured`: the iteration is captured once with `wp.ScopedCapture` and replayed, as the example.
* `captured-lean`: as `captured`, with a pipeline without rigid contacts (`rigid_contact_max=0`).
  The solver then does not launch the kernel of rigid contacts. In this scene that kernel has no
  effect, but runs over 1,000 empty slots in every substep.

Each measurement prints one JSON line. `first_s` is the time from the start of building the model to
the end of the first iteration. This time includes the capture and the loading of the kernels (with
`--cold`: the compilation of the kernels). Later measurements in the same process find the kernels
loaded. The initial velocity is then restored, and `iterations` iterations are timed one by one.

`loss` and `result_hash` are those of the last iteration. The hash is the first 16 hex digits of the
SHA-256 of the final `particle_q` and the gradient with respect to the initial velocity (float32
bytes). The loss of N > 1 balls is one float32 sum over all balls. The sum is inexact for large N
(0.1 % at N = 100,000) and may vary between runs on a GPU. The gradient and the hash do not depend
on the loss.
    pip install newton==1.8.0 warp-lang==1.19.0
    python tools/bench/newton_ball.py --n 1 10 1000 --mode captured --iterations 20
"""

from __future__ import annotations

import argparse
import hashlib
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version

import newton
import numpy as np
import warp as wp

MODES = ("eager", "captured", "captured-lean")
STEPS = 36
SUBSTEPS = 8
DT = (1.0 / 60) / SUBSTEPS
TRAIN_RATE = 0.02
GAP = 10.0
MATERIAL = {"ke": 1.0e4, "kd": 1.0e1, "kf": 0.0, "mu": 0.2}


@wp.kernel
def single_loss_kernel(pos: wp.array[wp.vec3], target: wp.array[wp.vec3], loss: wp.array[float]):
    """Compute the squared distance of the only ball to its target, as in the example."""
    delta = pos[0] - target[0]
    loss[0] = wp.dot(delta, delta)


@wp.kernel
def sum_loss_kernel(pos: wp.array[wp.vec3], target: wp.array[wp.vec3], loss: wp.array[float]):
    """Add the squared distance of one ball to its target."""
    tid = wp.tid()
    delta = pos[tid] - target[tid]
    wp.atomic_add(loss, 0, wp.dot(delta, delta))


@wp.kernel
def step_kernel(x: wp.array[wp.vec3], grad: wp.array[wp.vec3], alpha: float):
    """Take one step of gradient descent."""
    tid = wp.tid()
    x[tid] = x[tid] - grad[tid] * alpha


def ball_offsets(n: int) -> np.ndarray:
    """Return the x offsets of the balls {n} (m, float32)."""
    if n == 1:
        return np.zeros(1, np.float32)
    return (np.arange(n) % 7 - 3).astype(np.float32) * np.float32(0.05)


class Balls:
    """N balls, their states, contacts and training iteration."""

    def __init__(self, n: int, mode: str) -> None:
        """Build the model and the contacts, and capture the iteration unless it is eager."""
        self.n = n
        position = np.zeros((n, 3), np.float32)
        position[:, 0] = ball_offsets(n)
        target = position + np.float32([0.0, -2.0, 1.5])
        position += np.float32([0.0, -0.5, 1.0])
        self.velocity = np.tile(np.float32([0.0, 5.0, -5.0]), (n, 1))

        builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
        builder.add_particles(
            pos=position.tolist(), vel=self.velocity.tolist(), mass=[1.0] * n, radius=[0.1] * n
        )
        shape = newton.ModelBuilder.ShapeConfig(**MATERIAL)
        builder.add_shape_box(
            body=-1,
            xform=wp.transform(wp.vec3(0.0, 2.0, 1.0), wp.quat_identity()),
            hx=1.0,
            hy=0.25,
            hz=1.0,
            cfg=shape,
        )
        builder.add_ground_plane(cfg=shape)
        self.model = builder.finalize(requires_grad=True)
        self.model.particle_grid = None
        for name, value in MATERIAL.items():
            setattr(self.model, f"soft_contact_{name}", value)

        self.solver = newton.solvers.SolverSemiImplicit(self.model)
        self.states = [self.model.state() for _ in range(STEPS * SUBSTEPS + 1)]
        self.control = self.model.control()
        self.target = wp.array(target, dtype=wp.vec3)
        self.loss = wp.zeros(1, dtype=wp.float32, requires_grad=True)
        pipeline = newton.CollisionPipeline(
            self.model,
            broad_phase="explicit",
            soft_contact_gap=GAP,
            requires_grad=True,
            rigid_contact_max=0 if mode == "captured-lean" else None,
        )
        self.contacts = pipeline.contacts()
        pipeline.collide(self.states[0], self.contacts)

        self.tape: wp.Tape | None = None
        self.graph: wp.Graph | None = None
        if mode != "eager":
            with wp.ScopedCapture() as capture:
                self.forward_backward()
            self.graph = capture.graph

    def forward_backward(self) -> None:
        """Record and run the rollout and its backward pass."""
        self.tape = wp.Tape()
        if self.n > 1:
            self.loss.zero_()
        with self.tape:
            for before, after in zip(self.states[:-1], self.states[1:], strict=True):
                before.clear_forces()
                self.solver.step(before, after, self.control, self.contacts, DT)
            kernel = single_loss_kernel if self.n == 1 else sum_loss_kernel
            inputs = [self.states[-1].particle_q, self.target, self.loss]
            wp.launch(kernel, dim=self.n, inputs=inputs)
        self.tape.backward(self.loss)

    def iterate(self) -> None:
        """Run one training iteration. The gradients can be read until the next iteration."""
        if self.tape is not None:
            self.tape.zero()
        if self.graph is not None:
            wp.capture_launch(self.graph)
        else:
            self.forward_backward()
        x = self.states[0].particle_qd
        wp.launch(step_kernel, dim=self.n, inputs=[x, x.grad, TRAIN_RATE])
        wp.synchronize_device()

    def reset(self) -> None:
        """Restore the initial velocity."""
        self.states[0].particle_qd.assign(self.velocity)

    def result_hash(self) -> str:
        """Return the hash of the last iteration's final positions and gradient."""
        digest = hashlib.sha256(self.states[-1].particle_q.numpy().tobytes())
        digest.update(self.states[0].particle_qd.grad.numpy().tobytes())
        return digest.hexdigest()[:16]


def timed(function: Callable[[], None]) -> float:
    """Return the wall-clock time of one call (s)."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def measure(n: int, mode: str, iterations: int) -> dict[str, object]:
    """Build the scene, run it, and return the record to print."""
    start = time.perf_counter()
    balls = Balls(n, mode)
    balls.iterate()
    first = time.perf_counter() - start

    balls.reset()
    seconds = [timed(balls.iterate) for _ in range(iterations)]
    return {
        "engine": "newton",
        "version": version("newton"),
        "warp": wp.__version__,
        "device": str(wp.get_device()),
        "scene": "ball",
        "mode": mode,
        "n": n,
        "iterations": iterations,
        "median_s": statistics.median(seconds),
        "min_s": min(seconds),
        "first_s": first,
        "loss": float(balls.loss.numpy()[0]),
        "result_hash": balls.result_hash(),
    }


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--n", type=int, nargs="+", default=[1], help="numbers of balls")
    parser.add_argument("--mode", choices=MODES, nargs="+", default=["captured"])
    parser.add_argument(
        "--iterations", type=int, default=20, help="timed iterations per measurement"
    )
    parser.add_argument("--device", default="cpu", help="Warp device")
    parser.add_argument(
        "--cold", action="store_true", help="compile the kernels anew, in a temporary cache"
    )
    arguments = parser.parse_args()
    if min(arguments.n) < 1 or arguments.iterations < 1:
        parser.error("--n and --iterations must be positive")
    return arguments


def main() -> None:
    """Run every requested measurement."""
    arguments = parse_arguments()
    wp.config.log_level = wp.LOG_WARNING
    with tempfile.TemporaryDirectory() as cache:
        if arguments.cold:
            wp.config.kernel_cache_dir = cache
        wp.init()
        with wp.ScopedDevice(arguments.device):
            for mode in arguments.mode:
                for n in arguments.n:
                    print(json.dumps(measure(n, mode, arguments.iterations)), flush=True)


if __name__ == "__main__":
    main()
