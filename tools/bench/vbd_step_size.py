#!/usr/bin/env python3
"""Measure error and time of VBD at ten times the largest stable step of the explicit solver.
    python tools/bench/vbd_step_size.py [--seconds T]

A cloth that is fixed at one side swings for T seconds (0.5). The explicit solver takes the largest
step h = 4 ms / 2^k that does not diverge, and its reference is the same solver at h/8. VBD takes 10
h, and its reference is VBD at h/8 with enough iterations. Errors are root mean squares over the
particles, relative to their displacement. Prints a JSON line for each run, with the CPU time of one
thread.
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np

import novaphy

CLOTH = {
    "dim_x": 16, "dim_y": 16, "cell_x": 0.03, "cell_y": 0.03, "mass": 1e-2, "tri_ke": 150.0,
    "tri_ka": 150.0, "tri_kd": 1e-2, "edge_ke": 1e-3, "edge_kd": 1e-5, "fix_left": True,
}  # fmt: skip


def make_model():
    """Build the cloth."""
    builder = novaphy.ModelBuilder()
    builder.add_cloth_grid(pos=(0.0, 0.0, 1.0), **CLOTH)
    builder.color()
    return builder.finalize()


def run(model, solver, dt, seconds):
    """Return the positions after `seconds` (s), and the CPU time (s)."""
    states = [model.state(), model.state()]
    steps = round(seconds / dt)
    start = time.process_time()
    for _ in range(steps):
        states[0].clear_forces()
        solver.step(states[0], states[1], None, None, seconds / steps)
        states.reverse()
    return states[0].particle_q.numpy().astype(np.float64), time.process_time() - start


def error(q, reference, start):
    """Return the root mean square error, relative to the displacement of the reference."""
    return float(np.sqrt(((q - reference) ** 2).sum() / ((reference - start) ** 2).sum()))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=0.5, help="that the cloth swings")
    args = parser.parse_args()
    novaphy.set_num_threads(1)
    model = make_model()
    start = model.particle_q.numpy().astype(np.float64)

    def explicit(dt):
        return run(model, novaphy.solvers.SolverSemiImplicit(model), dt, args.seconds)

    def vbd(dt, iterations):
        solver = novaphy.solvers.SolverVBD(model, iterations=iterations)
        q, taken = run(model, solver, dt, args.seconds)
        return q, taken, solver.residual().relative

    h = 4e-3
    while True:
        q, taken = explicit(h)
        if np.isfinite(q).all() and np.abs(q - start).max() < 1.0:
            break
        h /= 2
    finer, _ = explicit(h / 8)
    print(
        json.dumps({"solver": "explicit", "dt": h, "cpu_s": taken, "error": error(q, finer, start)})
    )
    reference, _, residual = vbd(h / 8, 100)
    print(json.dumps({"solver": "VBD, reference", "dt": h / 8, "residual": residual}))
    for dt, iterations in ((h, 10), (10 * h, 10), (10 * h, 40), (10 * h, 160)):
        q, taken, residual = vbd(dt, iterations)
        print(json.dumps({
            "solver": "VBD", "dt": dt, "iterations": iterations, "cpu_s": taken,
            "error": error(q, reference, start), "residual": residual,
        }))  # fmt: skip


if __name__ == "__main__":
    main()
