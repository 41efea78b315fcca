"""Captured rollouts of articulations with contacts and dry friction: the bits of what runs now."""

from __future__ import annotations

import numpy as np
import pytest
from test_articulation_contact_gradients import walker
from test_articulation_parameter_gradients import arm, walker_with_friction

import novaphy
from novaphy.testing import assert_same_bits

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

STEPS, DT = 9, 0.002


class Training:
    """The first velocity by a rollout whose contacts are found in every step, or given."""

    def __init__(self, builder, checkpoint: int | None, searches: bool) -> None:
        """Make all that a capture needs to stay where it is."""
        from novaphy.diff import Trajectory, state_joint_q_tensor, state_joint_qd_tensor

        self.model = builder.finalize()
        self.solver = novaphy.solvers.DiffFeatherstoneSolver(self.model, contact_gradient="code")
        self.trajectory = Trajectory(self.model, STEPS, checkpoint=checkpoint)
        first = self.trajectory[0]
        novaphy.eval_fk(self.model, first.joint_q, first.joint_qd, first)
        self.options = {}
        self.contacts = None
        if self.model.shape_count > 0:
            pipeline = novaphy.CollisionPipeline(self.model)
            self.contacts = pipeline.contacts()
            pipeline.collide(first, self.contacts)
            if searches:
                self.options, self.contacts = {"pipeline": pipeline}, None
        self.velocity = state_joint_qd_tensor(first, requires_grad=True)
        self.last = state_joint_q_tensor(self.trajectory[STEPS])

    def iteration(self):
        """Forward, backward and a step of descent; the loss."""
        from novaphy import nova

        with nova.Tape() as tape:
            self.solver.rollout(self.trajectory, None, self.contacts, DT, **self.options)
            loss = nova.sum(self.last * self.last)
            tape.backward(loss)
            nova.sgd_update_f32(self.velocity, 0.05)
            tape.zero()
        return loss


@pytest.mark.parametrize("checkpoint", [None, 4])
@pytest.mark.parametrize(
    "build, searches",
    [
        (walker, True),
        (walker, False),
        (lambda: walker_with_friction(0.2), True),
        (lambda: arm(0.3, 5.0), False),
    ],
    ids=["found", "given", "found, with friction", "friction alone"],
)
def test_a_replay_has_the_bits_of_what_runs_at_once(build, searches, checkpoint) -> None:
    from novaphy import nova

    now = Training(build(), checkpoint, searches)
    captured = Training(build(), checkpoint, searches)
    start = captured.velocity.numpy()
    with nova.ScopedCapture() as capture:
        loss = captured.iteration()
    assert_same_bits(captured.velocity, start, "recorded, not run")
    for _ in range(4):
        expected = now.iteration()
        capture.graph.launch()
        assert_same_bits(loss, expected, "loss")
        assert_same_bits(captured.velocity, now.velocity, "velocity")
        assert_same_bits(captured.trajectory[STEPS].joint_qd, now.trajectory[STEPS].joint_qd, "qd")
    assert not np.array_equal(captured.velocity.numpy(), start)
    assert captured.solver.gradient_info() == now.solver.gradient_info()


def test_a_replay_that_fails_gives_nan_and_the_next_call_says_why() -> None:
    from novaphy import nova

    training = Training(walker(), None, False)
    with nova.ScopedCapture() as capture:
        training.iteration()
    capture.graph.launch()
    shapes = training.contacts.rigid_contact_shape0.numpy()
    shapes[0] = 77
    training.contacts.rigid_contact_shape0.assign(shapes)
    capture.graph.launch()
    assert np.isnan(training.last.numpy()).all()
    with pytest.raises(novaphy.Error, match=r"replay .*rigid_contact_shape0\[0\]: .*got 77"):
        training.iteration()
