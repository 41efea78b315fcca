#!/usr/bin/env python3
"""Time a fresh process from its start to the first gradient.

Starts a new `python`, which imports NovaPhy, builds the ball, runs its 288 substeps in a Python
loop of `step` on a tape, runs `backward` and prints the gradient. The soft body and the cloth
(deformable.py) are captured and launched once, and print the loss and the first parameters after
their update. The measured time begins just before the process is started, and ends when its line
has arrived. Prints one JSON line. The program fails if the printed values differ between runs.
NOVAPHY_CACHE_DIR=off measures with an empty cache.
    python tools/bench/start_up.py --runs 10
    python tools/bench/start_up.py --scene cloth --n 16 --device cuda:0
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

BALL = """
import sys
import novaphy
from novaphy import diff, nova

builder = novaphy.ModelBuilder()
builder.add_particle(pos=(0, -0.5, 1), vel=(0, 5, -5), mass=1.0)
cfg = novaphy.ShapeConfig(ke=1e4, kd=10, kf=0, mu=0.2)
builder.add_shape_box(-1, xform=((0, 2, 1), (0, 0, 0, 1)), hx=1, hy=0.25, hz=1, cfg=cfg)
builder.add_ground_plane(cfg=cfg)
model = builder.finalize(sys.argv[1], requires_grad=True)
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
CAPTURED = """
import sys
device, name, n, folder = sys.argv[1:]
sys.path.insert(0, folder)
from deformable import STEPS
from novaphy_deformable import Deformable

scene = Deformable(name, int(n), "captured", STEPS[name], device)
scene.iterate()
print([scene.loss_value(), *scene.params.numpy().ravel()[:3].tolist()], flush=True)
"""


def run_once(scene: str, n: int, device: str) -> tuple[float, str]:
    """Return the seconds until the gradient was printed, and the printed line."""
    code = BALL if scene == "ball" else CAPTURED
    folder = str(Path(__file__).resolve().parent)
    start = time.perf_counter()
    command = [sys.executable, "-c", code, device, scene, str(n), folder]
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
    parser.add_argument("--scene", choices=("ball", "soft_body", "cloth"), default="ball")
    parser.add_argument("--n", type=int, default=2, help="cells per side, but for the ball")
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    if min(arguments.runs, arguments.n) < 1:
        parser.error("--runs and --n must be positive")

    once = partial(run_once, arguments.scene, arguments.n, arguments.device)
    first, line = once()  # fills the file caches, not part of the median
    results = [once() for _ in range(arguments.runs)]
    if any(other != line for _, other in results):
        raise SystemExit("start_up: the gradients of two runs differ")
    seconds = [s for s, _ in results]
    record = {
        "engine": "novaphy",
        "measure": "start_up",
        "scene": arguments.scene,
        "device": arguments.device,
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
