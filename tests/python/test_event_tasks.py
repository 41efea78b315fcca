"""Gradients of the motion against slopes of smoothed losses, on tasks with contact events."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import novaphy

sys.path.insert(0, str(Path(__file__).parents[2] / "tools" / "bench"))

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

# Tasks whose reference of 1,024 samples takes a few seconds, and the number of the start.
SHORT = [
    ("BallParticle", 0),
    ("BallPenalty", 1),
    ("BallImpulse", 0),
    ("BilliardPenalty", 0),
    ("BilliardImpulse", 0),
    ("PushPenalty", 2),
    ("Hopper", 1),
]
# In these tasks the gradient of the code has another sign, or at least twice the length.
WRONG = {"BallPenalty", "BallImpulse", "BilliardPenalty"}


@pytest.mark.parametrize(("name", "start"), SHORT)
def test_a_gradient_of_the_motion_is_the_slope_of_the_smoothed_loss(name: str, start: int) -> None:
    import event_task_machines
    import event_tasks

    kind = getattr(event_task_machines, name)
    theta = event_tasks.start_of(kind, start)
    reference = event_tasks.smoothed(kind(64), theta, 1024)
    assert reference.error < 0.2
    found = event_tasks.compare(kind(1, "motion"), theta, reference)
    assert found.cosine > 0.9 and 0.7 < found.length < 1.4, found
    if name in WRONG:
        code = event_tasks.compare(kind(1), theta, reference)
        assert code.cosine < 0.0 or code.length > 2.0, code
