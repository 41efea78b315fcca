#!/usr/bin/env python3
"""Time a fresh process from its start to the first gradient.

Starts `python` anew, imports NovaPhy, builds the ball, runs its 288 substeps in a Python loop of
`step` on a tape, runs `backward` and prints the gradient. The clock runs from just before the
process is started until its line has arrived. Prints one JSON line; the gradient that it holds is
the same in every run, or the program fails.

    python tools/bench/start_up.py --runs 10
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time

CHILD = """
import novaphy
from novaphy import diff, nova

builder = novaphy.ModelBuilder()
builder.add_particle(pos=(0, -0.5, 1), vel=(0, 5, -5), mass=1.0)
cfg = novaphy.ShapeConfig(ke=1e4, kd=10, kf=0, mu=0.2)
builder.add_shape_box(-1, xform=((0, 2, 1), (0, 0, 0, 1)), hx=1, hy=0.25, hz=1, cfg=cfg)
builder.add_ground_plane(cfg=cfg)
model = builder.finalize(requires_grad=True)
model.soft_contact_ke, model.soft_contact_kd = 1e4, 10.0
model.soft_contact_kf, model.soft_contact_mu = 0.0, 0.2
solver = novaphy.solvers.DiffSemiImplicitSolver(model)
states = [model.state() for _ in range(289)]
pipeline = novaphy.CollisionPipeline(model, soft_contact_margin=10.0)
contacts = pipeline.contacts()
pipeline.collide(states[0], contacts)
velocity = diff.state_particle_qd_tensor(states[0], requires_grad=True)
with nova.Tape() as tape:
    for now, then in zip(states, states[1:]):
        now.clear_forces()
        solver.step(now, then, None, contacts, 1 / 480)
    last = diff.state_particle_q_tensor(states[-1])
    tape.backward(diff.particle_point_loss_generated(last, 0, 0.0, -2.0, 1.5))
print(velocity.grad.tolist(), flush=True)
"""


def run_once() -> tuple[float, str]:
    """Seconds until the gradient was printed, and the line."""
    start = time.perf_counter()
    command = [sys.executable, "-c", CHILD]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        line = child.stdout.readline().strip()
        seconds = time.perf_counter() - start
    if child.returncode != 0 or not line:
        raise SystemExit(f"start_up: the process ended with {child.returncode}")
    return seconds, line


def main() -> None:
    """Time all runs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=10, help="fresh processes")
    arguments = parser.parse_args()
    if arguments.runs < 1:
        parser.error("--runs must be positive")

    first, line = run_once()  # file caches; reported, not part of the median
    results = [run_once() for _ in range(arguments.runs)]
    if any(other != line for _, other in results):
        raise SystemExit("start_up: the gradients of two runs differ")
    seconds = [s for s, _ in results]
    record = {
        "engine": "novaphy",
        "measure": "start_up",
        "runs": arguments.runs,
        "median_s": statistics.median(seconds),
        "min_s": min(seconds),
        "max_s": max(seconds),
        "first_s": first,
        "gradient": json.loads(line),
    }
    print(json.dumps(record))


if __name__ == "__main__":
    main()
