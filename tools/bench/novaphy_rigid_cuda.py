#!/usr/bin/env python3
"""Time NovaPhy on rigid bodies on a GPU, and on the CPU of the same machine.

Scenes, of size N:
* `dice`: N dice, each falling alone on the ground (rigid.py). An iteration: 768 substeps, a loss of
  the last twists, the backward pass. The iteration is captured once and replayed.
* `worlds`: N worlds of a plane, a stack of three boxes and a ball that hits it. A captured rollout
  that finds contacts in every substep, forward, and with its backward pass.
* `columns`, `pile`: N boxes of one world (rigid.py), by sweep and prune. A captured rollout, the
  same number of searches alone, and single steps that are launched one by one.

Prints a JSON line for each: the medians of `repeats` runs (s).
    python tools/bench/novaphy_rigid_cuda.py --device cuda:0 --scene dice --n 4096
    python tools/bench/novaphy_rigid_cuda.py --scene columns --n 1000 10000 100000
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable

import numpy as np
from rigid import (
    DENSITY,
    DIE,
    DIE_DT,
    DIE_HEIGHT,
    DIE_MASS,
    DIE_SPIN,
    DIE_SUBSTEPS,
    HALF,
    SURFACE,
    box_poses,
)

import novaphy
from novaphy import diff, nova, solvers

DT = 1.0 / 960
FIRST = 4  # runs before the timed runs
SCENES = ("dice", "worlds", "columns", "pile")


def median_time(device: str, repeats: int, run: Callable[[], None]) -> float:
    """Return the median wall time of a run until the device has finished (s)."""
    times = []
    for k in range(FIRST + repeats):
        start = time.perf_counter()
        run()
        novaphy.synchronize(device)
        if k >= FIRST:
            times.append(time.perf_counter() - start)
    return statistics.median(times)


def captured(record: Callable[[], None]) -> nova.Graph:
    """Return a graph of the launches of `record`, ready for replays."""
    with nova.ScopedCapture() as capture:
        record()
    # prepare() is not called, because the fused kernel of dice does not compile.
    return capture.graph


def dice(n: int, device: str, repeats: int) -> dict[str, object]:
    """Time a training iteration of dice that do not touch each other."""
    surface = novaphy.ShapeConfig(**DIE)
    one = novaphy.ModelBuilder()
    one.add_ground_plane(cfg=surface)
    die = one.add_body(xform=(0.0, 0.0, DIE_HEIGHT, 0.0, 0.0, 0.0, 1.0), mass=DIE_MASS)
    one.add_shape_box(die, hx=HALF, hy=HALF, hz=HALF, cfg=surface)
    builder = novaphy.ModelBuilder()
    builder.replicate(one, n, (1.0, 0.0, 0.0))
    model = builder.finalize(device, requires_grad=True)
    config = solvers.DiffSolverConfig(
        enable_static_contacts=True, friction_law="huber", friction_smoothing=0.1
    )
    solver = solvers.DiffSemiImplicitSolver(model, config)
    trajectory = diff.Trajectory(model, DIE_SUBSTEPS)
    start = np.random.default_rng(1).normal(DIE_SPIN, 1.0, (n, 3)).astype(np.float32)
    spin = nova.tensor(start, device=device)
    spin.requires_grad = True

    def iterate() -> None:
        with nova.Tape(leaf_gradients_only=True) as tape:
            twist = diff.body_twist_from_omega_generated(spin, 1.0, 0.0, 0.0)
            diff.state_body_qd_tensor(trajectory[0]).copy_(twist)
            solver.rollout(trajectory, None, None, DIE_DT)
            end = diff.state_body_qd_tensor(trajectory[DIE_SUBSTEPS])
            tape.backward(nova.sum(end * end))

    graph = captured(iterate)
    spent = median_time(device, repeats, graph.launch)
    gradient = spin.grad.numpy()
    assert np.isfinite(gradient).all() and gradient.any()
    return {"iteration_s": spent, "substeps": DIE_SUBSTEPS, "gradient": checksum(gradient)}


def checksum(values: np.ndarray) -> int:
    """Return a number that differs if the bits of values differ."""
    words = values.astype(np.float32).view(np.uint32).astype(np.uint64).ravel()
    return int((words * (2 * np.arange(words.size, dtype=np.uint64) + 1)).sum() % (1 << 32))


def stack() -> novaphy.ModelBuilder:
    """Build a plane, three boxes on each other, and a ball that hits the uppermost."""
    surface = novaphy.ShapeConfig(ke=2e4, kd=100.0, kf=200.0, mu=0.5)
    one = novaphy.ModelBuilder()
    one.add_ground_plane(cfg=surface)
    for k in range(3):
        box = one.add_body(xform=((0.0, 0.0, HALF * (1 + 2 * k)), (0, 0, 0, 1)))
        one.add_shape_box(box, hx=HALF, hy=HALF, hz=HALF, cfg=surface)
    ball = one.add_body(xform=((-0.45, 0.02, 0.5), (0, 0, 0, 1)))
    one.add_shape_sphere(ball, radius=HALF, cfg=surface)
    one.body_qd[ball] = (3.0, 0, 0, 0, 0, 0)
    return one


def worlds(n: int, device: str, repeats: int) -> dict[str, object]:
    """Time rollouts of many small worlds."""
    steps = 96
    builder = novaphy.ModelBuilder()
    builder.replicate(stack(), n)
    model = builder.finalize(device, requires_grad=True)
    pipeline = novaphy.CollisionPipeline(model, rigid_contact_max=48 * n)
    solver = solvers.DiffSemiImplicitSolver(model)
    trajectory = diff.Trajectory(model, steps)
    graph = captured(lambda: solver.rollout(trajectory, None, None, DT, pipeline=pipeline))
    forward = median_time(device, repeats, graph.launch)
    end = trajectory[steps].body_qd.numpy().reshape(n, -1)
    assert (end == end[0]).all() and np.isfinite(end).all() and end[0, -6] < 2.9
    found = pipeline.contacts()
    pipeline.collide(trajectory[steps], found)
    assert not found.overflowed
    facts = {
        "substep_s": forward / steps,
        "world_substeps_per_s": n * steps / forward,
        "rows": int(found.rigid_contact_count.numpy()[0]),
        "end": checksum(end[0]),
    }
    velocity = diff.state_body_qd_tensor(trajectory[0], requires_grad=True)

    def iterate() -> None:
        with nova.Tape(leaf_gradients_only=True) as tape:
            solver.rollout(trajectory, None, None, DT, pipeline=pipeline)
            last = diff.state_body_qd_tensor(trajectory[steps])
            tape.backward(nova.sum(last * last))

    graph = captured(iterate)
    facts["with_backward_substep_s"] = median_time(device, repeats, graph.launch) / steps
    facts["gradient"] = checksum(velocity.grad.numpy().reshape(n, -1)[0])
    return facts


def boxes(scene: str, n: int, device: str, repeats: int) -> dict[str, object]:
    """Time many boxes in one world."""
    steps = 16
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(density=DENSITY, gap=0.01, **SURFACE)
    builder.add_ground_plane(cfg=surface)
    for pose in box_poses(scene, n, 0.0):
        body = builder.add_body(xform=tuple(map(float, pose)))
        builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF, cfg=surface)
    model = builder.finalize(device)
    pipeline = novaphy.CollisionPipeline(model, broad_phase="sap", rigid_contact_max=36 * n)
    found = pipeline.contacts()
    now, then = model.state(), model.state()
    solver = solvers.SolverSemiImplicit(model)
    pipeline.collide(now, found)

    def step() -> None:
        nonlocal now, then
        pipeline.collide(now, found)
        solver.step(now, then, None, found, DT)
        now, then = then, now

    facts: dict[str, object] = {"step_s": median_time(device, 40, step)}
    facts["collide_s"] = median_time(device, 40, lambda: pipeline.collide(now, found))
    step()
    facts["rows"] = int(found.rigid_contact_count.numpy()[0])
    facts["touching"] = int(np.any(found.rigid_contact_force.numpy(), axis=1).sum())
    assert facts["rows"] and not found.overflowed

    def search() -> None:
        for _ in range(steps):
            pipeline.collide(now, found)

    graph = captured(search)
    facts["captured_search_s"] = median_time(device, repeats, graph.launch) / steps
    trajectory = diff.Trajectory(model, steps)
    forward = solvers.DiffSemiImplicitSolver(model)
    graph = captured(lambda: forward.rollout(trajectory, None, None, DT, pipeline=pipeline))
    facts["captured_step_s"] = median_time(device, repeats, graph.launch) / steps
    end = trajectory[steps].body_q.numpy()
    assert np.isfinite(end).all()
    return facts


def main() -> None:
    """Run one scene for each size."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", choices=SCENES, default="dice")
    parser.add_argument("--n", type=int, nargs="+", default=[1024])
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--repeats", type=int, default=10)
    arguments = parser.parse_args()
    device, repeats = arguments.device, arguments.repeats
    for n in arguments.n:
        if arguments.scene == "dice":
            facts = dice(n, device, repeats)
        elif arguments.scene == "worlds":
            facts = worlds(n, device, repeats)
        else:
            facts = boxes(arguments.scene, n, device, repeats)
        record = {"scene": arguments.scene, "n": n, "device": device, "repeats": repeats}
        print(json.dumps(record | {"name": novaphy.get_device(device).name} | facts), flush=True)


if __name__ == "__main__":
    main()
