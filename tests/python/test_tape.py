"""The tape tells the truth: what it records, what it refuses, and how gradients add up."""

from __future__ import annotations

import ctypes
import gc
import warnings

import numpy as np
import pytest
from scenes import DT, Ball, ball_contacts, ball_model

import novaphy
from novaphy import diff, nova
from novaphy.testing import assert_same_bits


def square_of(x):
    """The sum of squares, whose adjoint reads x."""
    return nova.sum(x * x)


def test_backward_twice_gives_exactly_twice():
    ball = Ball()
    with nova.Tape() as tape:
        loss = ball.forward()
        tape.backward(loss)
        once = ball.velocity.grad.numpy()
        tape.backward(loss)
    assert_same_bits(ball.velocity.grad, once + once)


def test_leaf_gradients_are_the_same_bits_when_only_they_are_kept():
    gradients = []
    for leaf_gradients_only in (False, True):
        ball = Ball()
        with nova.Tape(leaf_gradients_only=leaf_gradients_only) as tape:
            tape.backward(ball.forward())
        gradients.append(ball.velocity.grad.numpy())
        middle = diff.state_particle_qd_tensor(ball.states[5])
        if leaf_gradients_only:
            with pytest.raises(novaphy.Error, match="leaves only"):
                _ = middle.grad
        else:
            assert np.any(middle.grad.numpy())
    assert_same_bits(*gradients)
    with pytest.raises(TypeError):
        nova.Tape(True)


def test_two_losses_give_the_sum():
    x = nova.tensor([1.0, -2.0, 3.0], requires_grad=True)
    grads = []
    for weights in ((1, 0), (0, 1), (1, 1)):
        x.zero_grad()
        with nova.Tape() as tape:
            losses = [nova.sum(x * x), nova.sum(nova.sin(x))]
            for weight, loss in zip(weights, losses):
                if weight:
                    tape.backward(loss)
        grads.append(x.grad.numpy())
    np.testing.assert_allclose(grads[2], grads[0] + grads[1], rtol=1e-6)


def test_the_next_iteration_goes_on_from_gradients_that_were_not_zeroed():
    x = nova.tensor([3.0], requires_grad=True)
    for expected in (6, 12):
        with nova.Tape() as tape:
            tape.backward(square_of(x))
        assert x.grad.tolist() == [expected]
    with nova.Tape() as tape:
        loss = square_of(x)
        tape.zero()
        tape.backward(loss)
        assert x.grad.tolist() == [6]
        tape.zero()
        assert x.grad.tolist() == [0]


@pytest.mark.parametrize(
    "overwrite",
    [
        lambda ball: ball.states[5].particle_q.fill_(0.0),
        lambda ball: ball.states[5].particle_q.assign([(0, 0, 0)]),
        lambda ball: ball.states[5].particle_q.__setitem__(0, (0, 0, 0)),
        lambda ball: setattr(ball.states[5], "particle_q", [(0, 0, 0)]),
        lambda ball: ball.states[5].assign(ball.states[0]),
        lambda ball: diff.state_particle_q_tensor(ball.states[5]).zero_(),
        lambda ball: ball.solver.step(ball.states[0], ball.states[5], None, ball.contacts, DT),
    ],
)
def test_an_input_that_was_overwritten_is_reported_and_no_gradient_was_touched(overwrite):
    ball = Ball(steps=10)
    with nova.Tape() as tape:
        loss = ball.forward()
        tape.backward(loss)
        before = ball.velocity.grad.numpy()
        with nova.no_grad():
            overwrite(ball)
        with pytest.raises(novaphy.Error, match="input 'particle_qd?' of op '.*' was modified"):
            tape.backward(loss)
    assert_same_bits(ball.velocity.grad, before)


def test_forces_may_be_cleared_and_read_between_steps():
    ball = Ball(steps=20)
    with nova.Tape() as tape:
        loss = ball.forward()
        for state in ball.states:
            state.clear_forces()
        tape.backward(loss)
    assert np.abs(ball.velocity.grad.numpy()).max() > 0


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_write_through_an_exported_view_is_noticed(when):
    x = nova.tensor([1.0, 2.0], requires_grad=True)
    alias = x.numpy(copy=False, writable=True) if when == "before" else None
    with nova.Tape() as tape:
        loss = square_of(x)
        if alias is None:
            alias = x.numpy(copy=False, writable=True)
        tape.backward(loss)
        assert x.grad.tolist() == [2, 4]
        alias[0] = 7.0
        with pytest.raises(novaphy.Error, match="was modified after recording"):
            tape.backward(loss)
        alias[0] = 1.0
        tape.backward(loss)
    assert x.grad.tolist() == [4, 8]


def test_a_write_through_a_dlpack_import_is_noticed():
    values = np.float32([1, 2])
    x = nova.from_dlpack(values)
    x.requires_grad = True
    with nova.Tape() as tape:
        loss = square_of(x)
        values[1] = 5
        with pytest.raises(novaphy.Error, match="was modified"):
            tape.backward(loss)


def test_a_write_through_an_old_dlpack_capsule_is_noticed():
    array = novaphy.DeviceArray([1.0, 2.0])
    x = nova.from_device_array(array, requires_grad=True)
    capsule_owner = type("Old", (), {"__dlpack__": lambda self: array.__dlpack__()})()
    other = novaphy.DeviceArray.from_dlpack(capsule_owner)
    with nova.Tape() as tape:
        loss = square_of(x)
        other.fill_(3.0)
        with pytest.raises(novaphy.Error, match="was modified"):
            tape.backward(loss)


def write_at(tensor, row, value):
    """Write as a consumer of DLPack does that ignores the read-only flag."""
    ctypes.c_float.from_address(tensor.data_ptr + 4 * row).value = value


def test_a_write_through_a_read_only_dlpack_export_is_noticed_also_when_it_has_ended():
    for end_first in (False, True):
        x = nova.tensor([1.0, 2.0], requires_grad=True)
        capsule = x.__dlpack__(max_version=(1, 0))
        with nova.Tape() as tape:
            loss = square_of(x)
            write_at(x, 1, 5.0)
            if end_first:
                del capsule
            with pytest.raises(novaphy.Error, match="was modified after recording"):
                tape.backward(loss)
            write_at(x, 1, 2.0)
            tape.backward(loss)
        assert x.grad.tolist() == [2, 4]


def test_a_write_through_dlpack_into_the_middle_of_a_rollout_is_noticed():
    ball = Ball()
    with nova.Tape() as tape:
        loss = ball.forward()
        middle = ball.states[5].particle_qd
        capsule = middle.__dlpack__(max_version=(1, 0))
        ctypes.c_float.from_address(middle.ptr).value += 1.0
        with pytest.raises(novaphy.Error, match="was modified after recording"):
            tape.backward(loss)
    del capsule


def test_a_training_iteration_over_exported_memory_can_be_captured():
    x = nova.tensor([1.0, 2.0], requires_grad=True)
    capsule = x.__dlpack__(max_version=(1, 0))
    with nova.ScopedCapture() as capture:
        x.zero_grad()
        with nova.Tape() as tape:
            tape.backward(square_of(x))
    for value in (3.0, -7.0):
        write_at(x, 0, value)
        capture.graph.launch()
        assert x.grad.tolist() == [2 * value, 4]
    del capsule


def test_a_write_of_torch_is_noticed():
    torch = pytest.importorskip("torch")
    x = nova.tensor([1.0, 2.0, 3.0], requires_grad=True)
    theirs = torch.from_dlpack(x)
    with nova.Tape() as tape:
        loss = square_of(x)
        theirs.mul_(5)
        with pytest.raises(novaphy.Error, match="was modified after recording"):
            tape.backward(loss)
        theirs.div_(5)
        tape.backward(loss)
    assert x.grad.tolist() == [2, 4, 6]


def test_a_read_only_export_costs_nothing_and_cannot_write():
    x = nova.tensor([1.0], requires_grad=True)
    alias = x.numpy(copy=False)
    with pytest.raises(ValueError):
        alias.flags.writeable = True
    with nova.Tape() as tape:
        tape.backward(square_of(x))
    assert x.grad.tolist() == [2]


def test_overlapping_memory_is_refused():
    ball = Ball()
    state = ball.states[0]
    with nova.Tape():
        with pytest.raises(novaphy.Error, match="state_out: expected another state"):
            ball.solver.step(state, state, None, ball.contacts, DT)
    x = nova.tensor([1.0, 2.0], requires_grad=True)
    with nova.Tape() as tape, pytest.raises(ValueError, match="overlaps"):
        tape.record_custom("inplace", [x], [x], lambda g: g)


def test_backward_needs_a_loss_on_the_tape():
    x = nova.tensor([1.0, 2.0], requires_grad=True)
    outside = nova.sum(x)
    with nova.Tape() as tape:
        inside = x * 2
        for loss in (outside, x, nova.tensor([1.0])):
            with pytest.raises(ValueError, match="loss"):
                tape.backward(loss)
        with pytest.raises(ValueError, match="one value"):
            tape.backward(inside)
        for grad in (nova.tensor([1.0]), nova.tensor([1, 2])):
            with pytest.raises(ValueError, match="grad"):
                tape.backward(inside, grad)
        tape.backward(inside, nova.tensor([3.0, 4.0]))
        assert x.grad.tolist() == [6, 8]
        for bad in (None, 1.0, np.ones(1)):
            with pytest.raises(TypeError):
                tape.backward(bad)


def test_a_view_outlives_its_model():
    model = ball_model()
    state = model.state()
    q = diff.state_particle_q_tensor(state, requires_grad=True)
    with nova.Tape() as tape:
        loss = square_of(q)
    del model, state
    gc.collect()
    tape.backward(loss)
    np.testing.assert_allclose(q.grad.numpy(), [[0, -1, 2]])


def test_views_of_a_field_are_one_tensor():
    model = ball_model()
    state = model.state()
    q = diff.state_particle_q_tensor(state)
    assert q is diff.state_particle_q_tensor(state, requires_grad=True) and q.requires_grad
    assert diff.state_particle_q_tensor(state, requires_grad=False).requires_grad
    assert diff.state_particle_qd_tensor(state) is not q
    assert q.data_ptr == state.particle_q.ptr and q is nova.from_device_array(state.particle_q)
    mass = diff.model_particle_mass_tensor(model)
    assert mass is diff.model_particle_mass_tensor(model) and mass.shape == (1,)
    assert diff.state_body_q_tensor(state).shape == (0, 7)
    assert diff.state_joint_q_tensor(state).shape == (0,)
    trajectory = diff.Trajectory(model, 3)
    assert trajectory[1] is trajectory[1]
    first = diff.state_particle_qd_tensor(trajectory[1])
    assert first is diff.state_particle_qd_tensor(trajectory[1])
    for bad in (4, -5):
        with pytest.raises(IndexError):
            trajectory[bad]
    with pytest.raises(ValueError, match="steps"):
        diff.Trajectory(model, -1)


def test_gradients_reach_masses_radii_gravity_and_materials():
    ball = Ball(steps=200)
    views = [
        diff.model_particle_mass_tensor(ball.model, requires_grad=True),
        diff.model_gravity_tensor(ball.model, requires_grad=True),
        diff.model_shape_material_ke_tensor(ball.model, requires_grad=True),
        diff.model_particle_radius_tensor(ball.model, requires_grad=True),
    ]
    with nova.Tape() as tape:
        tape.backward(ball.forward())
    for view in views:
        assert np.isfinite(view.grad.numpy()).all() and np.abs(view.grad.numpy()).max() > 0
    mass = views[0]
    mass.assign([2.0])
    assert ball.model.particle_inv_mass[0] == 0.5


def test_states_used_again_in_a_loop_are_refused_when_the_tape_needs_them():
    ball = Ball(steps=1)
    a, b = ball.states
    with nova.Tape() as tape:
        for _ in range(3):
            a.clear_forces()
            ball.solver.step(a, b, None, ball.contacts, DT)
            b.clear_forces()
            ball.solver.step(b, a, None, ball.contacts, DT)
        last = diff.state_particle_q_tensor(a)
        loss = diff.particle_point_loss_generated(last, 0, 0.0, 0.0, 0.0)
        with pytest.raises(novaphy.Error, match="modified|overwritten"):
            tape.backward(loss)


def test_copies_are_recorded():
    x = nova.tensor([1.0, 2.0], requires_grad=True)
    for copy in (
        lambda: x.clone(),
        lambda: nova.zeros(2).copy_(x),
    ):
        x.zero_grad()
        with nova.Tape() as tape:
            tape.backward(square_of(copy()))
        assert x.grad.tolist() == [2, 4]
    with nova.Tape() as tape:
        with pytest.raises(ValueError, match="loss"):
            tape.backward(square_of(x.detach()))
    model = ball_model()
    a, b = model.state(), model.state()
    q = diff.state_particle_q_tensor(a, requires_grad=True)
    with nova.Tape() as tape:
        b.assign(a)
        tape.backward(square_of(diff.state_particle_q_tensor(b)))
    np.testing.assert_allclose(q.grad.numpy(), 2 * q.numpy())


def test_assigned_tensors_and_arrays_are_recorded_and_parts_are_refused():
    model = ball_model()
    x = nova.tensor([[1.0, 2.0, 3.0]], requires_grad=True)

    def attribute(state, values):
        state.particle_qd = values

    for assign in (
        lambda state, values: state.particle_qd.assign(values),
        lambda state, values: state.particle_qd.copy_from(values),
        lambda state, values: diff.state_particle_qd_tensor(state).assign(values),
        attribute,
    ):
        state = model.state()
        x.zero_grad()
        with nova.Tape() as tape:
            assign(state, x * 3.0)
            tape.backward(square_of(diff.state_particle_qd_tensor(state)))
        np.testing.assert_allclose(x.grad.numpy(), 18.0 * x.numpy())
    state = model.state()
    with nova.Tape():
        y = x * 3.0
        for silent in (
            lambda: state.particle_qd.__setitem__(slice(None), y),
            lambda: state.particle_qd.fill_(y),
            lambda: nova.tensor(y),
        ):
            with pytest.raises(novaphy.Error, match="without a gradient"):
                silent()
        state.particle_qd[:] = y.detach()
        state.particle_qd[:] = y.numpy()
    np.testing.assert_array_equal(state.particle_qd.numpy(), y.numpy())


def test_a_forward_solver_refuses_a_tape():
    ball = Ball(steps=1)
    solver = novaphy.solvers.SolverSemiImplicit(ball.model)
    with nova.Tape():
        with pytest.raises(novaphy.Error, match="Tape"):
            solver.step(*ball.states, None, ball.contacts, DT)
        with nova.no_grad():
            solver.step(*ball.states, None, ball.contacts, DT)


def test_nothing_is_recorded_in_no_grad_or_without_a_gradient():
    x = nova.tensor([1.0], requires_grad=True)
    assert nova.grad_enabled()
    with nova.Tape() as tape:
        nova.tensor([1.0]) * 2
        assert tape.size == len(tape) == 0
        with nova.no_grad(), nova.no_grad():
            assert not nova.grad_enabled()
            x * 2
        assert nova.grad_enabled() and tape.size == 0
        y = x * 2
        assert tape.size == 1 and tape.op_names() == ["mul_scalar"] and tape.memory_bytes > 0
        assert not y.is_leaf and x.is_leaf
        tape.reset()
        assert tape.size == 0 and y.is_leaf
        with pytest.raises(ValueError):
            tape.backward(y)


def test_one_tape_at_a_time_is_active():
    tape = nova.Tape()
    with tape:
        with pytest.raises(novaphy.Error, match="already active"):
            tape.__enter__()
        with pytest.raises(novaphy.Error, match="another tape"), nova.Tape():
            pass
    with pytest.raises(ZeroDivisionError), nova.Tape():
        _ = 1 / 0
    with tape:
        pass


def test_a_tape_may_go_on_after_its_block():
    x = nova.tensor([2.0], requires_grad=True)
    tape = nova.Tape()
    with tape:
        y = x * x
    z = y * 2
    with tape:
        loss = nova.sum(y * y)
    tape.backward(loss)
    assert x.grad.tolist() == [32] and z.tolist() == [8]


# ---------------------------------------------------------------------------- custom operations


def cube(tape, x):
    """x^3 by NumPy, with its derivative."""
    y = nova.tensor(x.numpy() ** 3)
    tape.record_custom("cube", [x], [y], lambda grads: [grads[0] * x * x * 3])
    return y


def test_a_custom_operation_is_differentiated_by_its_function():
    x = nova.tensor([1.0, 2.0], requires_grad=True)
    with nova.Tape() as tape:
        loss = nova.sum(cube(tape, x) * 2)
        assert tape.op_names()[0] == "cube"
        tape.backward(loss)
        assert x.grad.tolist() == [6, 24]
        tape.backward(loss)
    assert x.grad.tolist() == [12, 48]


def test_a_custom_operation_may_leave_out_gradients():
    x, y = (nova.tensor([1.0], requires_grad=True) for _ in range(2))
    given = []

    def backward(grads):
        given.append(grads)
        return [grads[0], None]

    with nova.Tape() as tape:
        a, b = nova.tensor([5.0]), nova.tensor([6.0])
        tape.record_custom("pair", [x, y], [a, b], backward)
        tape.backward(nova.sum(a * 3))
    assert x.grad.tolist() == [3] and y.grad.tolist() == [0]
    assert given[0][0].tolist() == [3] and given[0][1] is None


@pytest.mark.parametrize(
    ("backward", "error"),
    [
        (lambda g: 1 / 0, ZeroDivisionError),
        (lambda g: None, TypeError),
        (lambda g: [1.0], TypeError),
        (lambda g: [], ValueError),
        (lambda g: [g[0], g[0]], ValueError),
        (lambda g: [nova.zeros(3)], ValueError),
    ],
)
def test_errors_of_a_custom_operation_reach_the_caller(backward, error):
    x = nova.tensor([1.0], requires_grad=True)
    with nova.Tape() as tape:
        y = nova.tensor([1.0])
        tape.record_custom("bad", [x], [y], backward)
        with pytest.raises(error):
            tape.backward(y)
    with nova.Tape() as tape:
        tape.backward(square_of(x))


def test_arguments_of_a_custom_operation_are_checked():
    x = nova.tensor([1.0], requires_grad=True)
    with nova.Tape() as tape:
        for arguments in (
            ("a", [x], [nova.zeros(1)], None),
            ("a", [1.0], [nova.zeros(1)], lambda g: g),
            ("a", [nova.tensor([1])], [nova.zeros(1)], lambda g: g),
            ("a", [None], [nova.zeros(1)], lambda g: g),
        ):
            with pytest.raises(TypeError):
                tape.record_custom(*arguments)
        with pytest.raises(ValueError):
            tape.record_custom("a", [x], [], lambda g: g)


def test_what_a_custom_operation_holds_is_let_go_with_the_tape():
    class Held:
        """Something to watch."""

    import weakref

    held = Held()
    watch = weakref.ref(held)
    x = nova.tensor([1.0], requires_grad=True)
    with nova.Tape() as tape:
        y = nova.tensor([1.0])
        tape.record_custom("hold", [x], [y], lambda g, held=held: g)
    del held
    gc.collect()
    assert watch() is not None
    tape.reset()
    gc.collect()
    assert watch() is None


# ---------------------------------------------------------------------------- operators


def test_the_operators_agree_with_the_solver():
    ball = Ball(steps=1)
    state = ball.states[0]
    q, qd, f = (
        nova.tensor(getattr(state, n).numpy()) for n in ("particle_q", "particle_qd", "particle_f")
    )
    q1, qd1 = diff.integrate_particles_generated(ball.model, q, qd, f, DT)
    config = novaphy.solvers.DiffSolverConfig(enable_particle_contacts=False)
    solver = novaphy.solvers.DiffSemiImplicitSolver(ball.model, config)
    solver.step(*ball.states, None, None, DT)
    assert_same_bits(q1, ball.states[1].particle_q)
    assert_same_bits(qd1, ball.states[1].particle_qd)
    low = nova.tensor([[0.0, 0.0, 0.05]])
    forces = diff.eval_static_particle_shape_contact_forces_generated(ball.model, low, qd, f)
    both = diff.integrate_particles_with_static_contacts_generated(ball.model, low, qd, f, 0.0, DT)
    apart = diff.integrate_particles_generated(ball.model, low, qd, forces, DT)
    assert forces[0][2] > 0
    for one, two in zip(both, apart):
        assert_same_bits(one, two)


def test_operators_check_their_arguments():
    model = ball_model(2)
    good = nova.zeros((2, 3))
    for bad in (nova.zeros((2, 4)), nova.zeros((3, 3)), nova.zeros(6)):
        with pytest.raises(ValueError, match="particle_q"):
            diff.integrate_particles_generated(model, bad, good, good, DT)
    with pytest.raises(TypeError):
        diff.integrate_particles_generated(model, nova.zeros((2, 3), nova.int32), good, good, DT)
    with pytest.raises(TypeError):
        diff.integrate_particles_generated(model, np.zeros((2, 3), np.float32), good, good, DT)
    with pytest.raises(TypeError):
        diff.integrate_particles_generated(None, good, good, good, DT)
    for dt in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="dt"):
            diff.integrate_particles_generated(model, good, good, good, dt)


def test_losses():
    q = nova.tensor([[1.0, 2, 3], [3, 2, 1]], requires_grad=True)
    assert diff.particle_point_loss_generated(q, 1, 0, 0, 0).item() == 14
    assert diff.particle_centroid_generated(q).tolist() == [[2, 2, 2]]
    assert diff.vec3_point_loss_generated(nova.tensor([1.0, 1, 1]), 0, 0, 0).item() == 3
    assert diff.clamp_f32_generated(q, 1.5, 2.5).tolist() == [[1.5, 2, 2.5], [2.5, 2, 1.5]]
    for index in (2, -1):
        with pytest.raises(IndexError, match="particle_index"):
            diff.particle_point_loss_generated(q, index, 0, 0, 0)
    with pytest.raises(ValueError):
        diff.particle_point_loss_generated(q, 0, float("nan"), 0, 0)
    with pytest.raises(ValueError):
        diff.clamp_f32_generated(q, 2, 1)
    with nova.Tape() as tape:
        center = diff.particle_centroid_generated(q)
        tape.backward(diff.vec3_point_loss_generated(center, 0, 0, 0))
    np.testing.assert_allclose(q.grad.numpy(), np.full((2, 3), 2.0))
    novaphy.testing.assert_gradcheck(
        lambda x: diff.particle_point_loss_generated(x, 0, 1, 0, 0), [q]
    )


def test_optimiser_updates():
    p = nova.tensor([[3.0, 0, 0], [0, 4, 0]], requires_grad=True)
    with pytest.raises(ValueError, match="gradient"):
        nova.sgd_update_f32(nova.tensor([1.0]), 0.1)
    with nova.Tape() as tape:
        tape.backward(square_of(p))
    nova.sgd_update_f32(p, 0.25)
    assert p.tolist() == [[1.5, 0, 0], [0, 2, 0]]
    nova.sgd_update_vec3_clipped_f32(p, 1.0, 0.0, 1.0)
    np.testing.assert_allclose(p.numpy(), [[0.5, 0, 0], [0, 1, 0]])
    nova.sgd_update_vec3_clipped_f32(p, 0.0, 0.5, 0.0)
    np.testing.assert_allclose(p.numpy(), [[0.5, 0, 0], [0, 0.5, 0]])
    with pytest.raises(ValueError, match="learning_rate"):
        nova.sgd_update_f32(p, float("nan"))


def test_contacts_made_anew_need_a_new_record():
    ball = Ball(steps=4)
    with nova.Tape() as tape:
        loss = ball.forward()
        ball.contacts.assign(ball_contacts(ball.model, ball.states[0]))
        with pytest.raises(novaphy.Error, match="modified|contacts|overwritten"):
            tape.backward(loss)


def test_jvp_gives_the_derivative_along_a_direction():
    x = nova.tensor([1.0, 2.0, 3.0], requires_grad=True)
    with nova.Tape() as tape:
        y = x * x * x
        (t,) = tape.jvp([y], [x], [nova.tensor([1.0, 0.5, 0.0])])
        tape.backward(y, nova.tensor([1.0, 1.0, 1.0]))
    np.testing.assert_array_equal(t.numpy(), [3.0, 6.0, 0.0])
    np.testing.assert_array_equal(x.grad.numpy(), [3.0, 12.0, 27.0])
    with pytest.raises(ValueError, match="jvp, input 0: expected a leaf"):
        tape.jvp([y], [y], [nova.tensor([1.0, 1.0, 1.0])])
    with pytest.raises(ValueError, match="jvp, input 1: expected each input once"):
        tape.jvp([y], [x, x.reshape(3, 1)], [nova.ones(3), nova.ones(3)])


def test_gradcheck_compares_the_two_directions():
    result = nova.gradcheck(lambda v: nova.sum(v * v), [nova.tensor([1.0, -2.0])])
    assert result.ok and result.has_tangent
    assert result.dot_product_error < 1e-6


def test_a_value_of_another_living_tape_raises():
    x = nova.tensor([1.0, 2.0], requires_grad=True)
    first = nova.Tape()
    with first:
        y = x * 3.0
    message = "was recorded by another tape that is still alive"
    with nova.Tape() as second:
        for use in (
            lambda: y * x,
            lambda: nova.sum(y.reshape(2, 1)),
            lambda: nova.tensor([0.0, 0.0]).copy_(y),
        ):
            with pytest.raises(novaphy.Error, match=message):
                use()
        with pytest.raises(novaphy.Error, match=message):
            second.record_custom("own", [y], [nova.zeros(2)], lambda grads: grads)
        # Without a gradient the values may be used.
        loss = nova.sum(y.detach() * x)
        second.backward(loss)
    np.testing.assert_array_equal(x.grad.numpy(), [3.0, 6.0])
    with nova.no_grad():
        assert (y * x).tolist() == [3.0, 12.0]
    # On its own tape the value carries its gradient. Once overwritten, or once the tape is gone, it
    # is a constant.
    x.zero_grad()
    with first:
        first.backward(nova.sum(y * x))
    np.testing.assert_array_equal(x.grad.numpy(), [6.0, 12.0])
    other = nova.tensor([5.0, 5.0])
    with first:
        z = x * 2.0
    z.assign(other)
    x.zero_grad()
    with nova.Tape() as second:
        second.backward(nova.sum(z * x))
    np.testing.assert_array_equal(x.grad.numpy(), [5.0, 5.0])
    first.reset()
    x.zero_grad()
    with nova.Tape() as second:
        second.backward(nova.sum(y * x))
    np.testing.assert_array_equal(x.grad.numpy(), [3.0, 6.0])


@pytest.mark.parametrize("checkpoint", [None, 2])
def test_a_rollout_that_begins_on_another_living_tape_raises(checkpoint):
    model = ball_model()
    trajectory = diff.Trajectory(model, 8, checkpoint=checkpoint)
    contacts = ball_contacts(model, trajectory[0])
    solver = novaphy.solvers.DiffSemiImplicitSolver(model)
    with nova.Tape() as first:
        solver.rollout(trajectory, None, contacts, DT, stop=4)
        first.backward(nova.sum(diff.state_particle_q_tensor(trajectory[4])))
    with nova.Tape(), pytest.raises(novaphy.Error, match="recorded by another tape"):
        solver.rollout(trajectory, None, contacts, DT, start=4)


def test_backward_tells_where_the_first_gradient_that_is_not_finite_comes_from():
    def warned(run):
        with pytest.warns(RuntimeWarning) as said:
            run()
        assert len(said) == 1
        return str(said[0].message)

    # log at 0: the gradient of x is infinite. The gradient of y, which comes later, is -inf too.
    x = nova.tensor([0.0, 1.0], requires_grad=True)
    y = nova.tensor([2.0, 2.0], requires_grad=True)
    with nova.Tape() as tape:
        loss = nova.sum(nova.log(x) * y * 1.0)
        text = warned(lambda: tape.backward(loss, nova.tensor([1.0])))
    assert "the gradients of 2 of 2 leaves are not finite" in text
    assert "of op 'mul'" in text
    np.testing.assert_array_equal(x.grad.numpy(), [np.inf, 2.0])
    np.testing.assert_array_equal(y.grad.numpy(), [-np.inf, 0.0])
    # Values that were not finite before are known, and additions to them do not warn again.
    with nova.Tape() as tape:
        tape.backward(nova.sum(nova.log(x)))
    # The seed.
    w = nova.tensor([1.0], requires_grad=True)
    with nova.Tape() as tape:
        loss = w * 2.0
        text = warned(lambda: tape.backward(loss, nova.tensor([np.nan])))
    assert "that of the loss, which was given" in text
    # A finite gradient that was there is kept where the warning is an error.
    v = nova.tensor([0.0], requires_grad=True)
    with nova.Tape() as tape:
        tape.backward(nova.sum(v * 3.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with nova.Tape() as tape:
            loss = nova.sum(nova.log(v))
            with pytest.raises(RuntimeWarning, match="not finite"):
                tape.backward(loss)
    assert v.grad.item() == 3.0


@pytest.mark.parametrize("leaves_only", [False, True])
@pytest.mark.parametrize("checkpoint", [None, 5])
def test_the_step_of_a_rollout_is_named_whose_gradient_is_not_finite(checkpoint, leaves_only):
    # At rest with kf dt/m = 20: the gradient by the slip is multiplied by -19 in every step.
    builder = novaphy.ModelBuilder()
    builder.add_particle((0, 0, 0.1 - 0.5 * 9.81 / 1e3), (0, 0, 0), 0.5, radius=0.1)
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(ke=1e3, kd=0.0, kf=2e4, mu=0.5))
    model = builder.finalize(requires_grad=True)
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_kf = 1e3, 0.0, 0.0
    config = novaphy.solvers.DiffSolverConfig(enable_static_contacts=True, particle_kf_bound=np.inf)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the warning about dt
        solver = novaphy.solvers.DiffSemiImplicitSolver(model, config)
        steps = 60
        trajectory = diff.Trajectory(model, steps, checkpoint=checkpoint)
        with nova.Tape(leaf_gradients_only=leaves_only) as tape:
            solver.rollout(trajectory, None, None, 1e-3)
            loss = nova.sum(diff.state_particle_qd_tensor(trajectory[steps]))
    assert np.isfinite(trajectory[steps].particle_qd.numpy()).all()
    with pytest.warns(RuntimeWarning, match="in step [0-9]+ of a rollout") as said:
        tape.backward(loss)
    named = int(str(said[0].message).split("in step ")[1].split()[0])
    # 19^n > 3.4e38 from n = 31 on.
    assert steps - 33 <= named <= steps - 30
