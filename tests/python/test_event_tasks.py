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


def test_gradients_and_random_search_lower_the_loss_of_the_ball() -> None:
    import event_task_machines
    import numpy as np
    import optimize_tasks

    problem = optimize_tasks.Problem(event_task_machines.BallParticle, 0, 8)
    slope = problem.slope_of("motion")
    found = optimize_tasks.run_adam(problem, slope, 12)
    assert len(found.best) == 5 and found.best[-1] < 0.5
    search = optimize_tasks.random_search(problem, found.seconds[-1], 0)
    assert optimize_tasks.run_search(problem, search).best[-1] < 1.0
    loss, gradient = slope(np.zeros(3))
    smooth, by_samples = problem.smooth_slope(1, "motion")(np.zeros(3))
    assert loss == problem.first and abs(smooth - loss) < 0.5 * loss
    assert gradient @ by_samples > 0.9 * np.linalg.norm(gradient) * np.linalg.norm(by_samples)
