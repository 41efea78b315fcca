"""The ball against Newton 1.8.0: states, forces, contacts and loss to the bit, the rest closely."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import DT, LEARNING_RATE, STEPS, TARGET, Ball, ball_contacts, ball_model, golden

from novaphy import diff, nova, solvers
from novaphy.testing import assert_same_bits


@pytest.fixture(scope="module")
def newton():
    """Newton's numbers."""
    return golden("newton_ball_strict")


def test_the_model_has_newtons_values(newton):
    model = ball_model()
    compared = 0
    for key, expected in newton.items():
        name = key.removeprefix("model_")
        if not key.startswith("model_") or not hasattr(model, name):
            continue
        value = getattr(model, name)
        if hasattr(value, "numpy"):
            assert_same_bits(value.numpy(), expected, name)
        else:
            assert np.float32(value) == expected, name
        compared += 1
    assert compared >= 25


def test_the_contacts_equal_newtons_to_the_bit(newton):
    model = ball_model()
    contacts = ball_contacts(model, model.state())
    count = int(newton["contact_count"])
    assert contacts.soft_contact_count[0] == count == 2
    for name in ("particle", "shape", "body_pos", "body_vel", "normal"):
        values = getattr(contacts, f"soft_contact_{name}").numpy()[:count]
        assert_same_bits(values, newton[f"contact_{name}"], name)


@pytest.mark.parametrize("forward_only", [False, True])
def test_a_loop_of_steps_has_newtons_bits(newton, forward_only):
    ball = Ball()
    if forward_only:
        ball.solver = solvers.SolverSemiImplicit(ball.model)
    loss = ball.forward()
    assert_same_bits(ball.array("particle_q"), newton["particle_q"], "particle_q")
    assert_same_bits(ball.array("particle_qd"), newton["particle_qd"], "particle_qd")
    assert_same_bits(ball.array("particle_f")[:-1], newton["particle_f"][:-1], "particle_f")
    assert_same_bits(loss, newton["loss"], "loss")


def test_a_rollout_has_newtons_bits(newton):
    model = ball_model()
    trajectory = diff.Trajectory(model, STEPS)
    contacts = ball_contacts(model, trajectory[0])
    solvers.DiffSemiImplicitSolver(model).rollout(trajectory, None, contacts, DT)
    assert len(trajectory) == STEPS + 1 and trajectory.steps == STEPS
    assert trajectory.particle_q.shape == (STEPS + 1, 1, 3)
    assert_same_bits(trajectory.particle_q, newton["particle_q"], "particle_q")
    assert_same_bits(trajectory.particle_qd, newton["particle_qd"], "particle_qd")
    assert_same_bits(trajectory[-1].particle_q, newton["particle_q"][-1], "last state")


@pytest.mark.parametrize("rollout", [False, True])
def test_the_gradient_equals_newtons(newton, rollout):
    ball = Ball()
    with nova.Tape() as tape:
        if rollout:
            trajectory = diff.Trajectory(ball.model, STEPS)
            velocity = diff.state_particle_qd_tensor(trajectory[0], requires_grad=True)
            position = diff.state_particle_q_tensor(trajectory[0], requires_grad=True)
            ball.solver.rollout(trajectory, None, ball.contacts, DT)
            last = diff.state_particle_q_tensor(trajectory[STEPS])
            loss = diff.particle_point_loss_generated(last, 0, *TARGET)
        else:
            velocity = ball.velocity
            position = diff.state_particle_q_tensor(ball.states[0], requires_grad=True)
            loss = ball.forward()
            assert tape.size == 2 * STEPS + 1
        tape.backward(loss)
    expected = newton["grad_ad"]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(velocity.grad.numpy(), expected, rtol=0, atol=1e-6 * scale)
    adjoint = newton["adj_q"][0]
    np.testing.assert_allclose(
        position.grad.numpy(), adjoint, rtol=0, atol=1e-6 * np.abs(adjoint).max()
    )


def test_thirty_iterations_follow_newton(newton):
    ball = Ball()
    for k, expected in enumerate(newton["train_loss"]):
        np.testing.assert_allclose(ball.velocity[0], newton["train_vel"][k], atol=1e-5)
        with nova.Tape() as tape:
            loss = ball.forward()
            tape.backward(loss)
            nova.sgd_update_f32(ball.velocity, LEARNING_RATE)
            tape.zero()
        assert loss.item() == pytest.approx(float(expected), rel=1e-5)
    np.testing.assert_allclose(ball.velocity[0], newton["train_final_vel"], atol=1e-5)


def test_the_gradient_agrees_with_central_differences():
    ball = Ball()
    with nova.Tape() as tape:
        tape.backward(ball.forward())
    gradient = ball.velocity.grad.numpy().ravel()
    start, quotients = ball.velocity.numpy(), []
    for k in range(3):
        values = []
        for step in (1e-3, -1e-3):
            moved = start.copy()
            moved[0, k] += np.float32(step)
            ball.velocity.assign(moved)
            values.append(ball.forward().item())
        quotients.append((values[0] - values[1]) / 2e-3)
    error = np.abs(gradient - quotients).max() / np.abs(quotients).max()
    assert error < 3e-3
