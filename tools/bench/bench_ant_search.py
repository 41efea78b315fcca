#!/usr/bin/env python3
"""The yardstick of analytic gradients: random search for the Ant that learns from zero.

Both begin with 80 zeros, and both may use the same seconds of the processor. The gradient has its
stages with the servo (demo_diffsim_ant_from_scratch.py). Random search, gaussian steps of
changing length, judges the same loss over the same frames: --plain without the servo, else in
the same stages. All are played for 600 frames behind, and the loss of the last stage is told.

    NOVAPHY_NUM_THREADS=1 python tools/bench/bench_ant_search.py --seconds 119
    NOVAPHY_NUM_THREADS=1 python tools/bench/bench_ant_search.py --seconds 119 --plain
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "python" / "demos"), str(ROOT / "python" / "demos" / "diff")]
import demo_diffsim_ant_from_scratch as demo  # noqa: E402


def told(actor: demo.Actor, horizon: int, **more: object) -> dict[str, object]:
    """The loss without the servo, and what of the gait is reached."""
    trainer = demo.Trainer(actor, "frozen", "dva", candidates=1)
    loss = trainer.rollouts(actor.weights[None], horizon)[0][0]
    result = demo.validate(actor, demo.make_worlds(1, "dva"), range(600))
    checks = demo.checks_of(result, demo.friction_ratio(actor, "dva", 600))
    row = {
        **more,
        "loss": round(float(loss), 4),
        "reached": sum(bool(passed) for passed, _ in checks.values()),
        "asked": len(checks),
        "upright": bool(result["upright"][0]),
        "way": round(float(result["distance"][0]), 3),
        "touchdowns": round(float(result["touchdowns"].mean()), 2),
        "slip": round(float(result["slip"][0]), 2),
    }
    print(json.dumps(row), flush=True)
    return row


def main() -> None:
    """A line of JSON for each, then median and range of random search."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--weights", default=str(demo.GAIT), help="what the gradient trained")
    parser.add_argument("--seconds", type=float, default=300.0, help="that it took")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--plain", action="store_true", help="no stages and no servo")
    parser.add_argument("--horizon", type=int, default=300, help="frames of the loss")
    args = parser.parse_args()
    told(demo.load(args.weights, "dva"), args.horizon, method="gradient")
    rows = []
    for seed in range(args.seeds):
        trainer = demo.Trainer(demo.Actor(), "frozen", "dva")
        stages = None if args.plain else demo.STAGES
        losses = demo.random_search(trainer, seed, args.seconds, stages)
        rows.append(told(trainer.actor, args.horizon, method="random search", seed=seed,
                         batches=len(losses), first=round(float(losses[0]), 4)))  # fmt: skip
    for key in ("loss", "reached", "way", "touchdowns", "slip"):
        values = [row[key] for row in rows]
        print(f"random search, {key}: {np.median(values)} ({min(values)} to {max(values)})")


if __name__ == "__main__":
    main()
