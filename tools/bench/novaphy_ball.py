#!/usr/bin/env python3
"""Time NovaPhy's ball training iteration on many balls.

The scene, the iteration and the JSON lines are those of newton_ball.py. Contacts are found once,
for the first state.

Modes:
* `step`: a Python loop of `clear_forces` and `DiffSemiImplicitSolver.step` over one state for each
  substep, recorded on a new tape in every iteration. Newton's example has this form.
* `rollout`: one call of `rollout` over a `Trajectory`, recorded on a new tape in every iteration.
* `captured`: the `rollout` iteration, captured once with `nova.ScopedCapture` and replayed.
* `leaves`: as `captured`, on a tape that keeps only the gradients of leaves.

With `--memory` the program prints, instead of times, the memory of `step`, `rollout` or `leaves`
for each particle and substep, without a capture. `states_bytes` is the memory of the states, and
`tape_bytes` the additional resident memory of recording and `backward`.

On a GPU the program first runs until the clock rates are high. `device_median_s` is the time
between two events of the device around an iteration.

With `--operations` the program prints the number of float32 operations in the Programs of one
iteration for each particle and substep (see `count_operations`).
    python tools/bench/novaphy_ball.py --n 1 10 1000 --mode step captured --iterations 20
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import novaphy
from novaphy import diff, nova

MODES = ("step", "rollout", "captured", "leaves")
STEPS = 36 * 8
DT = (1.0 / 60) / 8
TRAIN_RATE = 0.02
GAP = 10.0
WARM_UP = 0.3  # s
MATERIAL = {"ke": 1.0e4, "kd": 1.0e1, "kf": 0.0, "mu": 0.2}


def ball_offsets(n: int) -> np.ndarray:
    """Return the x offsets of the balls {n} (m, float32)."""
    if n == 1:
        return np.zeros(1, np.float32)
    return (np.arange(n) % 7 - 3).astype(np.float32) * np.float32(0.05)


def resident_bytes() -> int:
    """Return the resident memory of this process (bytes)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


class Balls:
    """N balls, their states, contacts and training iteration."""

    def __init__(self, n: int, mode: str, device: str, capture: bool = True) -> None:
        """Build the model and the contacts. Capture the iteration if the mode needs a capture."""
        self.n = n
        self.mode = mode
        position = np.zeros((n, 3), np.float32)
        position[:, 0] = ball_offsets(n)
        self.target = nova.tensor(position + np.float32([0.0, -2.0, 1.5]), device=device)
        position += np.float32([0.0, -0.5, 1.0])
        self.start = np.tile(np.float32([0.0, 5.0, -5.0]), (n, 1))

        builder = novaphy.ModelBuilder()
        builder.add_particles(position, self.start, np.ones(n, np.float32))
        shape = novaphy.ShapeConfig(**MATERIAL)
        wall = ((0.0, 2.0, 1.0), (0.0, 0.0, 0.0, 1.0))
        builder.add_shape_box(-1, xform=wall, hx=1.0, hy=0.25, hz=1.0, cfg=shape)
        builder.add_ground_plane(cfg=shape)
        self.model = builder.finalize(device, requires_grad=True)
        for name, value in MATERIAL.items():
            setattr(self.model, f"soft_contact_{name}", value)

        config = novaphy.solvers.DiffSolverConfig(contact_gradient="code")  # as in captures
        self.solver = novaphy.solvers.DiffSemiImplicitSolver(self.model, config)
        pipeline = novaphy.CollisionPipeline(self.model, soft_contact_margin=GAP)
        self.contacts = pipeline.contacts()
        pipeline.collide(self.model.state(), self.contacts)
        self.scene_resident = resident_bytes()
        if mode == "step":
            self.states = [self.model.state() for _ in range(STEPS + 1)]
            self.first, self.last = self.states[0], self.states[-1]
        else:
            self.trajectory = diff.Trajectory(self.model, STEPS)
            self.first, self.last = self.trajectory[0], self.trajectory[STEPS]
        self.velocity = diff.state_particle_qd_tensor(self.first, requires_grad=True)

        self.graph = None
        if capture and mode in ("captured", "leaves"):
            with nova.ScopedCapture() as captured:
                self.loss = self.record()
            self.graph = captured.graph

    def simulate(self) -> None:
        """Run all substeps."""
        if self.mode != "step":
            self.solver.rollout(self.trajectory, None, self.contacts, DT)
            return
        for before, after in zip(self.states, self.states[1:]):
            before.clear_forces()
            self.solver.step(before, after, None, self.contacts, DT)

    def record(self, update: bool = True) -> nova.Tensor:
        """Record one training iteration on a new tape. Return the loss before the update."""
        with nova.Tape(leaf_gradients_only=self.mode == "leaves") as tape:
            self.simulate()
            final = diff.state_particle_q_tensor(self.last)
            if self.n == 1:
                loss = diff.particle_point_loss_generated(final, 0, 0.0, -2.0, 1.5)
            else:
                delta = final - self.target
                loss = nova.dot(delta, delta)
            tape.backward(loss)
            if update:
                nova.sgd_update_f32(self.velocity, TRAIN_RATE)
                tape.zero()
        return loss

    def iterate(self) -> None:
        """Run one training iteration."""
        if self.graph is not None:
            self.graph.launch()
        else:
            self.loss = self.record()

    def reset(self) -> None:
        """Restore the initial velocity."""
        self.velocity.assign(self.start)

    def gradient(self, velocity: np.ndarray) -> np.ndarray:
        """Return the gradient at an initial velocity, outside of the timed iterations."""
        self.velocity.assign(velocity)
        self.velocity.zero_grad()
        self.record(update=False)
        return self.velocity.grad.numpy()


def timed(function: Callable[[], None], device: str) -> float:
    """Return the wall-clock time of one call until the device has finished (s)."""
    novaphy.synchronize(device)
    start = time.perf_counter()
    function()
    novaphy.synchronize(device)
    return time.perf_counter() - start


def timed_on_device(function: Callable[[], None], device: str) -> float:
    """Return the time between two events of a GPU around one call (s)."""
    start, stop = novaphy.Event(device), novaphy.Event(device)
    start.record()
    function()
    stop.record()
    return novaphy.Event.elapsed(start, stop)


def warm_up(function: Callable[[], None], device: str) -> None:
    """Run until the clock rates of a GPU are high, which fall while it is idle between scenes."""
    end = time.perf_counter() + WARM_UP
    while time.perf_counter() < end:
        function()
        novaphy.synchronize(device)


def measure(n: int, mode: str, iterations: int, device: str) -> dict[str, object]:
    """Build the scene, run it, and return the record to print."""
    start = time.perf_counter()
    balls = Balls(n, mode, device)
    balls.iterate()
    first = time.perf_counter() - start
    if balls.graph is not None:
        balls.graph.prepare()

    on_device: dict[str, float] = {}
    if novaphy.Device(device).is_cuda:
        warm_up(balls.iterate, device)
        events = [timed_on_device(balls.iterate, device) for _ in range(iterations)]
        on_device["device_median_s"] = statistics.median(events)
    balls.reset()
    seconds = [timed(balls.iterate, device) for _ in range(iterations - 1)]
    before = balls.velocity.numpy()  # the next iteration computes the same again
    seconds.append(timed(balls.iterate, device))
    loss = balls.loss.item()
    digest = hashlib.sha256(balls.last.particle_q.numpy().tobytes())
    digest.update(balls.gradient(before).tobytes())
    return {
        "engine": "novaphy",
        "version": novaphy.__version__,
        "device": str(balls.model.device),
        "threads": novaphy.num_threads(),
        "scene": "ball",
        "mode": mode,
        "n": n,
        "iterations": iterations,
        "median_s": statistics.median(seconds),
        "min_s": min(seconds),
        **on_device,
        "first_s": first,
        "loss": loss,
        "result_hash": digest.hexdigest()[:16],
    }


def measure_memory(n: int, mode: str, device: str) -> dict[str, object]:
    """Measure the memory of the states, and of recording and backward."""
    Balls(1, mode, device, capture=False).record()  # creates what all runs share
    balls = Balls(n, mode, device, capture=False)
    with nova.no_grad():
        balls.simulate()
    states = resident_bytes()
    balls.record()
    recorded = resident_bytes()
    per = n * STEPS
    return {
        "engine": "novaphy",
        "version": novaphy.__version__,
        "scene": "ball",
        "measure": "memory",
        "mode": mode,
        "n": n,
        "substeps": STEPS,
        "states_bytes": (states - balls.scene_resident) / per,
        "tape_bytes": (recorded - states) / per,
    }


ARITHMETIC = frozenset(["ADD", "SUB", "MUL", "DIV", "NEG", "ABS", "SQRT", "MIN", "MAX"])


def operations_of(program: str, items: int) -> int:
    """Return the float32 operations of one row of a Program's text, with loops over `items` items.

    Every instruction is a line `%number = NAME operands`, with a larger indent inside a loop. A
    fused multiply-add counts as two operations. Comparisons, selections, loads and casts do not
    count.
    """
    total = 0
    for line in program.splitlines():
        indent, _, rest = line.partition("%")
        _, assigned, instruction = rest.partition(" = ")
        if not assigned or indent.strip():
            continue
        name = instruction.split()[0]
        total += ((name in ARITHMETIC) + 2 * (name == "FMA")) * (items if len(indent) > 2 else 1)
    return total


def count_operations(device: str) -> dict[str, object]:
    """Return the operations of a substep and of its adjoint for each particle.

    The operations are counted in the text of the Programs, with all regions. The count is an upper
    bound, because kernels skip regions that no lane of a group takes. Each ball has two contacts.
    """
    balls = Balls(1, "leaves", device)
    balls.iterate()
    texts = diff.engine_programs()
    counts: dict[str, int] = {}
    for info in nova.kernel_info():  # finds the longest adjoint of a substep
        if info.name.split(".")[0] == "step_particles":
            operations = operations_of(texts[info.hash], 2)
            counts[info.name] = max(counts.get(info.name, 0), operations)
    if sorted(counts) != ["step_particles", "step_particles.adjoint"] or not all(counts.values()):
        raise SystemExit(f"novaphy_ball: unexpected Programs in a rollout: {counts}")
    return {
        "engine": "novaphy",
        "version": novaphy.__version__,
        "scene": "ball",
        "measure": "operations",
        "programs": counts,
        "operations": sum(counts.values()),
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
    parser.add_argument("--device", default="cpu", help="NovaPhy device")
    parser.add_argument(
        "--memory", action="store_true", help="measure the memory instead of the time"
    )
    parser.add_argument(
        "--operations", action="store_true", help="count the float32 operations instead"
    )
    arguments = parser.parse_args()
    if min(arguments.n) < 1 or arguments.iterations < 1:
        parser.error("--n and --iterations must be positive")
    if arguments.memory and (arguments.mode == ["captured"] or len(arguments.mode) > 1):
        parser.error("--memory takes one of the modes step, rollout and leaves")
    if arguments.memory and len(arguments.n) > 1:
        parser.error("--memory takes one number of balls: memory that was used is used again")
    return arguments


def main() -> None:
    """Run every requested measurement."""
    arguments = parse_arguments()
    if arguments.operations:
        print(json.dumps(count_operations(arguments.device)))
        return
    for mode in arguments.mode:
        for n in arguments.n:
            if arguments.memory:
                record = measure_memory(n, mode, arguments.device)
            else:
                record = measure(n, mode, arguments.iterations, arguments.device)
            print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
