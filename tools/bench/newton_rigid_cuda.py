#!/usr/bin/env python3
"""Time Newton on one world of boxes in columns (rigid.py) on a GPU.

The program times ten captured steps that find contacts again in each step, and the search alone. It
prints a JSON line with the best of five times (s).
    pip install newton==1.8.0 warp-lang==1.19.0
    python tools/bench/newton_rigid_cuda.py --n 1000 --broad-phase sap
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import newton
import numpy as np
import warp as wp
from rigid import DENSITY, HALF, SURFACE, box_poses

DT, STEPS = 1.0 / 960, 10


def best_time(record: Callable[[], None]) -> float:
    """Return the best of five times of a captured function (s)."""
    with wp.ScopedCapture() as capture:
        record()
    times = []
    for _ in range(6):  # the first one is not counted
        wp.synchronize()
        start = time.perf_counter()
        for _ in range(3):
            wp.capture_launch(capture.graph)
        wp.synchronize()
        times.append((time.perf_counter() - start) / 3)
    return min(times[1:])


def main() -> None:
    """Run one size, and print its line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=1000)
    parser.add_argument("--broad-phase", choices=("sap", "nxn"), default="sap")
    arguments = parser.parse_args()
    wp.config.quiet = True
    wp.set_device("cuda:0")
    n = arguments.n
    surface = newton.ModelBuilder.ShapeConfig(density=DENSITY, **SURFACE)
    builder = newton.ModelBuilder()
    builder.add_ground_plane(cfg=surface)
    for pose in box_poses("columns", n, 0.0):
        body = builder.add_body(xform=wp.transform(pose[:3], wp.quat(*pose[3:])))
        builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF, cfg=surface)
    model = builder.finalize()
    solver = newton.solvers.SolverSemiImplicit(model)
    pipeline = newton.CollisionPipeline(
        model, broad_phase=arguments.broad_phase, rigid_contact_max=max(4096, 16 * n)
    )
    found, control = pipeline.contacts(), model.control()
    states = [model.state(), model.state()]

    def steps() -> None:
        for _ in range(STEPS):
            states[0].clear_forces()
            pipeline.collide(states[0], found)
            solver.step(states[0], states[1], control, found, DT)
            states.reverse()

    start = time.perf_counter()
    steps()
    wp.synchronize()
    facts = {
        "n": n,
        "broad_phase": arguments.broad_phase,
        "first_s": time.perf_counter() - start,
        "captured_step_s": best_time(steps) / STEPS,
        "captured_search_s": best_time(lambda: pipeline.collide(states[0], found)),
        "rows": int(found.rigid_contact_count.numpy()[0]),
        "version": newton.__version__,
    }
    assert np.isfinite(states[0].body_q.numpy()).all()
    print(json.dumps(facts), flush=True)


if __name__ == "__main__":
    main()
