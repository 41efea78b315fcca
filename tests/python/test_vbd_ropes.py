"""Ropes of SolverVBD: springs that pull and never push."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_vbd(), reason="built with NOVAPHY_BUILD_VBD=OFF")
G = 9.81
DT = 1 / 120


def finished(builder):
    builder.color()
    return builder.finalize()


def hanging(mass, ke, kd, start, length, tension_only=True):
    """A mass below a fixed particle, on a rope of a length; it begins at a distance `start`."""
    builder = novaphy.ModelBuilder()
    builder.add_particle((0, 0, 0), (0, 0, 0), 0.0)
    builder.add_particle((0, 0, -length), (0, 0, 0), mass)
    builder.add_spring(0, 1, ke, kd, tension_only=tension_only)
    model = finished(builder)
    model.particle_q.assign(np.float32([(0, 0, 0), (0, 0, -start)]))
    return model


def heights(model, steps, **options):
    solver = novaphy.solvers.SolverVBD(model, **options)
    states = [model.state(), model.state()]
    found = []
    for _ in range(steps):
        solver.step(states[0], states[1], None, None, DT)
        states.reverse()
        found.append(float(states[0].particle_q.numpy()[1, 2]))
    return np.array(found)


def test_a_weight_stretches_its_rope_by_its_weight_over_the_stiffness():
    mass, ke, length = 0.5, 200.0, 1.0
    model = hanging(mass, ke, 4.0, 1.01, length)
    assert model.particle_spring_tension_only.numpy().tolist() == [1]
    z = heights(model, 800, iterations=10)
    # One rounding of the position, 1.2e-7 m, is a force of m/dt^2 times that.
    rounding = 1.2e-7 * mass / DT**2 / ke
    assert -z[-1] == pytest.approx(length + mass * G / ke, abs=rounding)


def test_a_slack_rope_falls_freely_and_then_catches():
    """Until it is taut, the path is that of implicit Euler without a force; then it turns."""
    length, start = 1.0, 0.2
    z = heights(hanging(0.5, 1e4, 5.0, start, length), 80, iterations=20)
    steps = np.arange(1, 81)
    free = -start - 0.5 * G * DT * DT * steps * (steps + 1)
    slack = free > -length
    assert 40 < slack.sum() < 80
    np.testing.assert_allclose(z[slack], free[slack], atol=1e-5)
    # Taut: the energy of the fall stretches the rope by about v sqrt(m/ke), 3 cm, and never more.
    deepest = 4.0 * np.sqrt(0.5 / 1e4)
    assert z.min() > -length - deepest
    assert (z[~slack] > free[~slack]).all()
    pushed = heights(hanging(0.5, 1e4, 5.0, start, length, tension_only=False), 1, iterations=20)
    assert pushed[0] < z[0] - 1e-3  # a spring pushes from the beginning


def chain(kd=3.0):
    """A fixed particle and five others, on ropes that are taut, and one that is slack."""
    builder = novaphy.ModelBuilder()
    for k in range(6):
        builder.add_particle((0.1 * k, 0.02 * (k % 2), 0), (0, 0.3, 0.1 * k), 0.05 if k else 0.0)
    for k in range(5):
        builder.add_spring(k, k + 1, 400.0 + 20 * k, kd, tension_only=True)
    builder.add_spring(0, 5, 300.0, kd, tension_only=True)
    model = finished(builder)
    rest = model.particle_spring_rest_length.numpy()
    model.particle_spring_rest_length.assign(rest * np.float32([0.95, 0.96, 0.94, 0.97, 0.95, 1.4]))
    return model


INPUTS = ("stiffness", "damping", "rest_length", "q", "qd")


def leaves_of(diff, model, state):
    return {
        "stiffness": diff.model_spring_stiffness_tensor(model, requires_grad=True),
        "damping": diff.model_spring_damping_tensor(model, requires_grad=True),
        "rest_length": diff.model_spring_rest_length_tensor(model, requires_grad=True),
        "q": diff.state_particle_q_tensor(state, requires_grad=True),
        "qd": diff.state_particle_qd_tensor(state, requires_grad=True),
    }


def rolled(kd, weights, **options):
    """A rollout of a chain on a tape: its leaves, result, loss and tape."""
    nova = pytest.importorskip("novaphy.nova")
    diff = pytest.importorskip("novaphy.diff")
    model = chain(kd)
    solver = novaphy.solvers.DiffSolverVBD(model, iterations=30, **options)
    trajectory = diff.Trajectory(model, 4)
    leaves = leaves_of(diff, model, trajectory[0])
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, DT)
        last = diff.state_particle_q_tensor(trajectory[4])
        loss = nova.sum(last * nova.tensor(weights))
    return leaves, last, loss, tape, model, solver, trajectory


@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
def test_gradients_of_ropes_are_those_of_differences_and_of_jvp(gradient):
    nova = pytest.importorskip("novaphy.nova")
    rng = np.random.default_rng(3)
    weights = rng.normal(size=(6, 3)).astype(np.float32)
    options = {} if gradient == "unrolled" else {"gradient_tolerance": 1e-6}
    leaves, last, loss, tape, model, solver, trajectory = rolled(
        3.0, weights, gradient=gradient, **options
    )
    ways = {
        name: (rng.normal(size=leaf.shape) * np.abs(leaf.numpy()).max()).astype(np.float32)
        for name, leaf in leaves.items()
    }
    tape.backward(loss)
    arrays = {
        "stiffness": model.particle_spring_stiffness,
        "damping": model.particle_spring_damping,
        "rest_length": model.particle_spring_rest_length,
        "q": trajectory[0].particle_q,
        "qd": trajectory[0].particle_qd,
    }
    slopes, scales = {}, {}
    for name in INPUTS:
        (slope,) = tape.jvp([last], [leaves[name]], [nova.tensor(ways[name])])
        forwards = float((slope.numpy().astype(np.float64) * weights).sum())
        backwards = float((leaves[name].grad.numpy().astype(np.float64) * ways[name]).sum())
        scales[name] = float(np.linalg.norm(slope.numpy()) * np.linalg.norm(weights))
        slopes[name] = forwards
        assert scales[name] > 0 and abs(forwards - backwards) < 2e-5 * scales[name], name
    for name in INPUTS:
        before, ends, step = arrays[name].numpy(), [], 2e-3
        for sign in (1, -1):
            arrays[name].assign(before + np.float32(sign * step) * ways[name])
            with nova.no_grad():
                solver.rollout(trajectory, None, None, DT)
            end = trajectory[4].particle_q.numpy().astype(np.float64)
            ends.append(float((end * weights).sum()))
        arrays[name].assign(before)
        found = (ends[0] - ends[1]) / (2 * step)
        assert found == pytest.approx(slopes[name], abs=2e-3 * scales[name] + 5e-8 / step), name
    stiffness = leaves["stiffness"].grad.numpy()
    assert (stiffness[:5] != 0).all() and stiffness[5] == 0  # the last one is slack


def test_a_rope_at_its_kink_has_the_derivative_of_the_slack_one():
    nova = pytest.importorskip("novaphy.nova")
    diff = pytest.importorskip("novaphy.diff")
    builder = novaphy.ModelBuilder()
    builder.add_particle((0, 0, 0), (0, 0, 0), 0.0)
    builder.add_particle((1, 0, 0), (0, 0, 0), 1.0)
    builder.add_spring(0, 1, 100.0, 0.0, tension_only=True)
    model = finished(builder)
    model.gravity.assign(np.zeros((1, 3), np.float32))
    solver = novaphy.solvers.DiffSolverVBD(model, iterations=1)
    state, after = model.state(), model.state()
    q = diff.state_particle_q_tensor(state, requires_grad=True)
    stiffness = diff.model_spring_stiffness_tensor(model, requires_grad=True)
    with nova.Tape() as tape:
        solver.step(state, after, None, None, DT)
        loss = nova.sum(diff.state_particle_q_tensor(after))
    tape.backward(loss)
    assert (after.particle_q.numpy() == state.particle_q.numpy()).all()
    np.testing.assert_array_equal(q.grad.numpy()[1], [1, 1, 1])
    assert stiffness.grad.numpy()[0] == 0


def test_threads_change_no_bit():
    threads, found = novaphy.num_threads(), []
    try:
        for count in (1, 2):
            novaphy.set_num_threads(count)
            leaves, last, loss, tape, *_ = rolled(3.0, np.ones((6, 3), np.float32))
            tape.backward(loss)
            found.append([last.numpy(), *(leaves[name].grad.numpy() for name in INPUTS)])
    finally:
        novaphy.set_num_threads(threads)
    for one, other in zip(*found, strict=True):
        assert one.tobytes() == other.tobytes()


def test_other_solvers_refuse_ropes_by_name():
    model = hanging(1.0, 100.0, 0.0, 1.0, 1.0)
    message = r"particle_spring_tension_only\[0\]: expected 0"
    with pytest.raises(NotImplementedError, match="SolverSemiImplicit: model." + message):
        novaphy.solvers.SolverSemiImplicit(model)
    if novaphy.has_diff():
        with pytest.raises(NotImplementedError, match="DiffSemiImplicitSolver: model." + message):
            novaphy.solvers.DiffSemiImplicitSolver(model)
    model.particle_spring_tension_only.assign(np.zeros(1, np.uint8))
    solver = novaphy.solvers.SolverSemiImplicit(model)
    model.particle_spring_tension_only.assign(np.ones(1, np.uint8))
    with pytest.raises(NotImplementedError, match=message):
        solver.step(model.state(), model.state(), None, None, 1e-4)


def test_what_is_a_rope_does_not_change_after_the_solver_was_made():
    model = hanging(1.0, 100.0, 0.0, 1.0, 1.0)
    solver = novaphy.solvers.SolverVBD(model)
    model.particle_spring_tension_only.assign(np.zeros(1, np.uint8))
    with pytest.raises(ValueError, match="particle_spring_tension_only: it was edited after"):
        solver.step(model.state(), model.state(), None, None, DT)


def test_worlds_keep_their_ropes():
    one = novaphy.ModelBuilder()
    for x in (0.0, 1.0, 2.0):
        one.add_particle((x, 0, 0), (0, 0, 0), 1.0)
    one.add_spring(0, 1, 1.0, 0.0)
    one.add_spring(1, 2, 1.0, 0.0, tension_only=True)
    worlds = novaphy.ModelBuilder()
    worlds.replicate(one, 3)
    found = worlds.finalize().particle_spring_tension_only.numpy()
    assert found.tolist() == [0, 1] * 3
