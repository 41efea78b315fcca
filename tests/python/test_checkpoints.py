"""Trajectories that keep some of their states."""

import gc

import numpy as np
import pytest
from scenes import ball_contacts, ball_model

import novaphy
from novaphy import diff, nova, solvers

STEPS = 20
DT = 1.0 / 240


def rollout(checkpoint):
    """A trajectory after a rollout, and the gradient of its initial velocity."""
    model = ball_model()
    trajectory = diff.Trajectory(model, STEPS, checkpoint=checkpoint)
    contacts = ball_contacts(model, trajectory[0])
    velocity = diff.state_particle_qd_tensor(trajectory[0], requires_grad=True)
    with nova.Tape() as tape:
        solvers.DiffSemiImplicitSolver(model).rollout(trajectory, None, contacts, DT)
        last = diff.state_particle_q_tensor(trajectory[STEPS])
        tape.backward(diff.particle_point_loss_generated(last, 0, 0.0, -2.0, 1.5))
    return trajectory, velocity.grad.numpy()


@pytest.mark.parametrize("checkpoint", [1, 3, STEPS, 100, "1KiB"])
def test_kept_and_recomputed_states_and_the_gradient_are_those_of_keeping_all(checkpoint):
    all_states, gradient = rollout(None)
    some, same_gradient = rollout(checkpoint)
    np.testing.assert_array_equal(same_gradient, gradient)
    everything = all_states.particle_q.numpy()
    np.testing.assert_array_equal(some.particle_q.numpy(), everything[some.kept_steps])
    assert some.particle_q.shape == (len(some.kept_steps), 1, 3)
    gc.collect()  # solver and contacts live on with the trajectory
    for t in range(STEPS + 1):
        np.testing.assert_array_equal(some.recompute(t).particle_q.numpy(), everything[t])
    assert len(some) == STEPS + 1 and len(list(some)) == len(some.kept_steps)


def test_memory_chooses_the_interval():
    trajectory, _ = rollout("1KiB")
    assert trajectory.checkpoint_interval == 1  # 21 states of 24 bytes
    model = novaphy.ModelBuilder()
    model.add_particles(
        np.zeros((100, 3), np.float32), np.zeros((100, 3), np.float32), np.ones(100)
    )
    model = model.finalize()
    assert diff.Trajectory(model, 100, checkpoint="50KiB").checkpoint_interval == 8


@pytest.mark.parametrize(
    ("checkpoint", "error", "message"),
    [
        (0, ValueError, "checkpoint: expected an interval >= 1, got 0"),
        (-3, ValueError, "checkpoint: expected an interval >= 1, got -3"),
        ("64", ValueError, 'expected an interval or memory as "64MiB"'),
        ("MiB", ValueError, 'got "MiB"'),
        ("-1KiB", ValueError, "checkpoint"),
        ("99999999999999999999KiB", ValueError, "checkpoint"),
    ],
)
def test_a_checkpoint_that_makes_no_sense_is_refused(checkpoint, error, message):
    with pytest.raises(error, match=message):
        diff.Trajectory(ball_model(), STEPS, checkpoint=checkpoint)
    with pytest.raises(ValueError, match="need at least"):
        builder = novaphy.ModelBuilder()
        builder.add_particles(
            np.zeros((1000, 3), np.float32), np.zeros((1000, 3), np.float32), np.ones(1000)
        )
        diff.Trajectory(builder.finalize(), STEPS, checkpoint="1KiB")


def test_a_state_that_is_not_kept_is_refused_by_name():
    trajectory, _ = rollout(8)
    with pytest.raises(RuntimeError, match=r"state 9 is not kept, but those of t = 0, 8, 16"):
        trajectory[9]
    with pytest.raises(IndexError):
        trajectory.recompute(21)
    with pytest.raises(RuntimeError, match="no rollout yet"):
        diff.Trajectory(ball_model(), STEPS, checkpoint=8).recompute(3)
