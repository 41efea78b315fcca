"""Tape.gradient_info(): what the gradients of a tape are, over all solvers with steps on it."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")


def ball(z: float, restitution: float = 0.0) -> novaphy.Model:
    """A ball of 10 cm that falls on the ground with 1 m/s, without gravity."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    of = novaphy.ShapeConfig(ke=1e5, kd=0, kf=0, mu=0, restitution=restitution, density=0)
    body = builder.add_body(
        xform=((0.0, 0.0, z), (0.0, 0.0, 0.0, 1.0)), mass=1.0, inertia=np.eye(3) * 0.004
    )
    builder.add_shape_sphere(body, radius=0.1, cfg=of)
    builder.add_ground_plane(cfg=of)
    return builder.finalize(requires_grad=True)


def penalty(model: novaphy.Model, mode: str) -> novaphy.solvers.DiffSemiImplicitSolver:
    config = novaphy.solvers.DiffSolverConfig(angular_damping=0.0, contact_gradient=mode)
    return novaphy.solvers.DiffSemiImplicitSolver(model, config)


def tree(model: novaphy.Model, mode: str) -> novaphy.solvers.DiffFeatherstoneSolver:
    return novaphy.solvers.DiffFeatherstoneSolver(
        model, angular_damping=0.0, pgs_slop=0.0, pgs_erp=1.0, contact_gradient=mode
    )


def roll(
    solver: novaphy.solvers.SolverBase, model: novaphy.Model, steps: int, **how: object
) -> novaphy.nova.Tensor:
    """The height at the end."""
    from novaphy import diff

    path = diff.Trajectory(model, steps)
    down = np.float32([0, 0, -1, 0, 0, 0])
    if isinstance(solver, novaphy.solvers.DiffFeatherstoneSolver):
        path[0].joint_qd.assign(down)
    else:
        path[0].body_qd.assign(down[None])
    if not how:
        how = {"pipeline": novaphy.CollisionPipeline(model)}
    solver.rollout(path, None, how.pop("contacts", None), 1 / 1000, **how)
    if isinstance(solver, novaphy.solvers.DiffFeatherstoneSolver):
        return diff.state_joint_q_tensor(path[steps])[2]
    return diff.state_body_q_tensor(path[steps])[0, 2]


def test_it_raises_by_name_without_steps_and_without_a_backward() -> None:
    from novaphy import nova

    with nova.Tape() as tape:
        with pytest.raises(novaphy.Error, match=r"Tape\.gradient_info: expected steps of a diff"):
            tape.gradient_info()
        model = ball(0.2)
        loss = roll(penalty(model, "code"), model, 5)
        with pytest.raises(novaphy.Error, match=r"Tape\.gradient_info: expected a backward of"):
            tape.gradient_info()
        tape.backward(loss)
    assert tape.gradient_info().steps == 5
    tape.reset()
    with pytest.raises(novaphy.Error, match="expected steps of a differentiable solver"):
        tape.gradient_info()


def test_the_worst_label_counts_and_numbers_are_sums() -> None:
    from novaphy import nova

    model, other = ball(0.15), ball(0.12, restitution=1.0)
    good, code = penalty(model, "motion"), tree(other, "code")
    with nova.Tape() as tape:
        loss = roll(good, model, 150) + roll(code, other, 80)
        tape.backward(loss)
    info, a, b = tape.gradient_info(), good.gradient_info(), code.gradient_info()
    assert (a.label, b.label) == ("exact of the motion", "exact of the code")
    assert info.label == b.label and info.reason == b.reason
    assert info.steps == a.steps + b.steps == 230
    assert info.events == a.events + b.events and a.events == b.events == 2
    assert info.ramp_steps == a.ramp_steps == 2 and info["began"] == 2 and info["ended"] == 2
    assert set(a) <= set(info)


@pytest.mark.parametrize("make", [penalty, tree])
def test_it_is_of_the_tape_and_not_of_the_solver(make: object) -> None:
    """A solver remembers its last rollout, or all; a tape its own steps, of all rollouts."""
    from novaphy import nova

    model = ball(0.15, restitution=float(make is tree))
    solver = make(model, "motion")
    with nova.Tape() as first:
        first.backward(roll(solver, model, 100) + roll(solver, model, 20))
    with nova.Tape() as second:
        second.backward(roll(solver, model, 20))
    assert first.gradient_info().steps == 120 and first.gradient_info().events == 2
    assert second.gradient_info().steps == 20 and second.gradient_info().events == 0
    assert second.gradient_info().label == "exact of the motion"
    with nova.Tape() as third:  # cut within the touch, and then a clean rollout
        third.backward(roll(solver, model, 53) + roll(solver, model, 20))
    assert third.gradient_info().began == 1
    if make is penalty:
        assert third.gradient_info().one_sided == 1 and solver.gradient_info().one_sided == 0
        assert third.gradient_info().label == "surrogate"


def test_a_frozen_rollout_is_not_hidden_by_the_next_one() -> None:
    """Contacts that are held for all steps push; then a rollout that touches nothing."""
    from novaphy import nova

    model = ball(0.0999)
    solver = penalty(model, "code")
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(model.state(), contacts)
    with nova.Tape() as tape:
        held = roll(solver, model, 5, contacts=contacts)
        empty = pipeline.contacts()
        free = roll(solver, model, 5, contacts=empty)
        tape.backward(held + free)
    info = tape.gradient_info()
    assert info.label == "frozen" and info.frozen_steps == 5 and info.exact_steps == 5


def pressed(builder: novaphy.ModelBuilder) -> str:
    """The label of a rollout of a particle that a shape of the world holds up all the time."""
    from novaphy import diff, nova

    model = builder.finalize(requires_grad=True)
    model.soft_contact_ke, model.soft_contact_kd = 5e3, 0.0
    model.soft_contact_kf = model.soft_contact_mu = 0.0
    solver = novaphy.solvers.DiffSemiImplicitSolver(model)
    trajectory = diff.Trajectory(model, 5)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, 1e-3, pipeline=novaphy.CollisionPipeline(model))
        tape.backward(nova.sum(diff.state_particle_qd_tensor(trajectory[5])))
    return tape.gradient_info().label


def test_contacts_of_particles_follow_curved_shapes_and_not_meshes():
    labels = {}
    for shape in ("sphere", "plane", "mesh", "finite plane"):
        builder = novaphy.ModelBuilder()
        builder.add_particle((0.1, 0.0, 0.08), (0.0, 0.0, -1.0), 1.0, radius=0.1)
        if shape == "sphere":
            builder.add_shape_sphere(-1, xform=((0, 0, -0.5), (0, 0, 0, 1)), radius=0.5)
        elif shape == "mesh":
            builder.add_shape_mesh(-1, mesh=novaphy.io.height_field(np.zeros((3, 3)), 1.0))
        elif shape == "finite plane":
            builder.add_shape_plane(width=2.0, length=2.0)
        else:
            builder.add_ground_plane()
        labels[shape] = pressed(builder)
    exact, frozen = "exact of the code", "frozen"
    assert labels == {"sphere": exact, "plane": exact, "mesh": frozen, "finite plane": frozen}


def test_values_of_a_new_state_are_leaves_before_a_solver_sees_them():
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=np.eye(3))
    builder.add_articulation([builder.add_joint_revolute(-1, link, axis=(0, 1, 0))])
    model = builder.finalize()
    state, copied = model.state(requires_grad=True), model.state()
    with nova.Tape() as tape:
        copied.joint_q.assign(state.joint_q)
        loss = nova.sum(diff.state_joint_q_tensor(copied) * 3.0)
        _ = diff.state_joint_q_tensor(state)
        tape.backward(loss)
    assert state.joint_q.grad.numpy().tolist() == [3.0]
    with nova.Tape(), pytest.raises(novaphy.Error, match="joint_q: it carries a gradient"):
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
