"""Gradients of the motion against slopes of smoothed losses, on tasks with contact events."""

from __future__ import annotations

import json
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
    import optimize_methods as methods

    problem = methods.Problem(event_task_machines.BallParticle, 0, 8)
    slope = problem.slope_of("motion")
    found, searched = (methods.Run(problem.first, 60.0) for _ in range(2))
    methods.run_adam(found, problem, slope, 12)
    assert len(found.best) == 4 and found.iterations == 12 and found.best[-1] < 0.5
    search = methods.random_search(problem.size, 8, 0)
    methods.run_search(searched, problem, search, found.seconds[-1])
    assert searched.best[-1] < 1.0
    gradient = slope(np.zeros(3))
    by_samples = problem.smooth_slope(1, "motion")(np.zeros(3))
    assert gradient @ by_samples > 0.9 * np.linalg.norm(gradient) * np.linalg.norm(by_samples)


def test_cma_es_finds_the_least_of_a_turned_narrow_valley() -> None:
    import numpy as np
    from cma_es import CmaEs

    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(6, 6)))
    search = CmaEs(6, 1.0, 16, seed=0)
    for _ in range(250):
        points = search.ask()
        search.tell(points, ((points - 2.0) @ turn) ** 2 @ np.logspace(0, 5, 6))
    assert abs(search.mean - 2.0).max() < 1e-6


def test_runs_that_have_a_line_are_not_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import optimize_tasks

    runs = tmp_path / "runs.jsonl"

    def run(iterations: int) -> str:
        command = f"- --only BallParticle --starts 1 --jobs 2 --worlds 4 --iterations {iterations}"
        more = ["--save", str(runs), "--methods", "motion,random search"]
        monkeypatch.setattr(sys, "argv", [*command.split(), *more])
        optimize_tasks.main()
        return capsys.readouterr().out

    assert len(run(2).splitlines()) == 2
    lines = [json.loads(line) for line in runs.read_text().splitlines()]
    assert [line["method"] for line in lines] == ["motion", "random search"]
    assert lines[0]["iterations"] == 2 and all(line["error"] is None for line in lines)
    assert lines[1]["seconds"][-1] >= lines[0]["seconds"][-1]
    assert run(2) == ""
    with pytest.raises(ValueError, match="got {'wanted': 2, 'worlds': 4}"):
        run(3)
