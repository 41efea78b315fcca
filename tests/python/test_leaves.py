"""requires_grad of a state makes leaves of positions and velocities; .grad of arrays."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy.testing import assert_same_bits

diff = pytest.importorskip("novaphy.diff")
nova = pytest.importorskip("novaphy.nova")

DT, STEPS = 1e-2, 10


def particle(requires_grad: bool = True) -> novaphy.Model:
    builder = novaphy.ModelBuilder()
    builder.add_particle((0, 0, 1), (0, 1, 0), 2.0)
    return builder.finalize(requires_grad=requires_grad)


def loop(model, states):
    solver = novaphy.solvers.DiffSemiImplicitSolver(model)
    for now, then in zip(states, states[1:], strict=False):
        solver.step(now, then, None, None, DT)
    return nova.sum(diff.state_particle_q_tensor(states[-1]))


def rollout(model, trajectory):
    novaphy.solvers.DiffSemiImplicitSolver(model).rollout(trajectory, None, None, DT)
    return nova.sum(diff.state_particle_q_tensor(trajectory[STEPS]))


def test_the_flag_of_the_model_is_enough_for_gradients_of_positions_and_velocities():
    model = particle()
    states = [model.state() for _ in range(STEPS + 1)]
    with nova.Tape() as tape:
        tape.backward(loop(model, states))
    assert np.allclose(states[0].particle_q.grad.numpy(), 1.0)
    assert np.allclose(states[0].particle_qd.grad.numpy(), STEPS * DT)
    assert states[0].particle_q.requires_grad and states[0].particle_f.grad is None


def test_a_rollout_makes_leaves_of_its_first_state():
    model = particle()
    trajectory = diff.Trajectory(model, STEPS)
    with nova.Tape() as tape:
        tape.backward(rollout(model, trajectory))
    first = trajectory[0]
    assert np.allclose(first.particle_q.grad.numpy(), 1.0)
    assert np.allclose(first.particle_qd.grad.numpy(), STEPS * DT)
    assert_same_bits(first.particle_qd.grad, diff.state_particle_qd_tensor(first).grad)


def test_without_the_flag_nothing_is_recorded():
    model = particle(requires_grad=False)
    states = [model.state() for _ in range(STEPS + 1)]
    trajectory = diff.Trajectory(model, STEPS, requires_grad=False)
    with nova.Tape() as tape:
        loop(model, states)
        rollout(model, trajectory)
        assert len(tape) == 0
    for state in (states[0], trajectory[0]):
        assert state.particle_q.grad is None and not state.particle_q.requires_grad


def test_forces_are_leaves_on_request():
    model = particle(requires_grad=False)
    states = [model.state() for _ in range(STEPS + 1)]
    states[0].particle_f.requires_grad = True
    with nova.Tape() as tape:
        tape.backward(loop(model, states))
    moved = STEPS * DT * DT / 2.0  # a push in the first step moves the particle in all of them
    assert np.allclose(states[0].particle_f.grad.numpy(), moved, rtol=1e-5)
    assert states[0].particle_qd.grad is None


def test_the_gradient_of_an_array_is_the_gradient_of_its_tensor():
    array = novaphy.DeviceArray([[1, 2, 3]], novaphy.vec3)
    assert array.grad is None and not array.requires_grad
    array.requires_grad = True
    x = nova.from_device_array(array)
    assert x.requires_grad
    with nova.Tape() as tape:
        tape.backward(nova.dot(x, x))
    assert array.grad.dtype.name == "vec3" and array.grad.numpy().tolist() == [[2, 4, 6]]
    array.grad.zero_()
    assert x.grad.numpy().tolist() == [[0, 0, 0]]
    x.requires_grad = False
    assert not array.requires_grad


def test_integers_have_no_gradient():
    array = novaphy.DeviceArray([1, 2], novaphy.int32)
    assert array.grad is None and not array.requires_grad
    with pytest.raises(ValueError, match="requires_grad: only float32 values have gradients"):
        array.requires_grad = True


def test_backward_without_a_leaf_says_how_one_is_made():
    x = nova.tensor([1.0, 2.0])
    with nova.Tape() as tape, pytest.raises(ValueError, match="requires_grad=True"):
        tape.backward(nova.sum(x * x))


def test_a_rollout_refuses_forces_and_an_end_of_another_meaning():
    model = particle()
    trajectory = diff.Trajectory(model, 3)
    solver = novaphy.solvers.DiffSemiImplicitSolver(model)
    with pytest.raises(ValueError, match="forces: expected float32 {1, 3} or {steps, 1, 3}, got"):
        solver.rollout(trajectory, None, None, DT, forces=nova.zeros((3, 3)))
    with pytest.raises(ValueError, match="stop: expected a state from 0 to 3 or None, got -1"):
        solver.rollout(trajectory, None, None, DT, stop=-1)


def test_an_array_that_follows_another_is_refused_as_a_leaf():
    model = particle()
    model.particle_inv_mass.requires_grad = True
    trajectory = diff.Trajectory(model, STEPS)
    rollout(model, trajectory)
    with (
        nova.Tape(),
        pytest.raises(
            NotImplementedError, match="particle_inv_mass: it follows model.particle_mass"
        ),
    ):
        rollout(model, trajectory)
    model.particle_inv_mass.requires_grad = False
    with nova.Tape() as tape:
        tape.backward(rollout(model, trajectory))


@pytest.mark.parametrize("name", ["shape_transform", "shape_scale", "shape_margin", "shape_gap"])
def test_a_gradient_by_the_shapes_that_an_articulation_touches_is_refused(name):
    """None reaches them: contact points are frozen. Without contacts they play no part."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    builder.add_shape_sphere(builder.add_body(xform=(0, 0, 0.09, 0, 0, 0, 1)), radius=0.1)
    model = builder.finalize()
    getattr(model, name).requires_grad = True
    solver, pipeline = (
        novaphy.solvers.DiffFeatherstoneSolver(model),
        novaphy.CollisionPipeline(model),
    )
    contacts, state, after = pipeline.contacts(), model.state(), model.state()
    pipeline.collide(state, contacts)
    trajectory = diff.Trajectory(model, 2)
    with nova.Tape():
        with pytest.raises(NotImplementedError, match=f"model.{name}: expected requires_grad Fa"):
            solver.step(state, after, None, contacts, DT)
        with pytest.raises(NotImplementedError, match=f"model.{name}: expected requires_grad Fa"):
            solver.rollout(trajectory, None, None, DT, pipeline=pipeline)
        solver.rollout(trajectory, None, None, DT)
