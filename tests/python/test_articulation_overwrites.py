"""Steps of articulations with contacts or dry friction: what they write and refuse is noticed."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

diff = pytest.importorskip("novaphy.diff")
nova = pytest.importorskip("novaphy.nova")

DT = 1.0 / 240.0
RATES = np.array([0.3, 0.0, -1.0, 0.0, 0.2, 0.0, 1.0], np.float32)


def ball_with_an_arm(friction: float = 0.0) -> novaphy.Model:
    """A ball in the ground, and a link that turns on it."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.4)
    builder.add_ground_plane(cfg=surface)
    upright = (0.0, 0.0, 0.0, 1.0)
    ball = builder.add_link(xform=((0.0, 0.0, 0.099), upright), mass=1.0, inertia=0.01 * np.eye(3))
    builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    arm = builder.add_link(mass=1.0, inertia=0.01 * np.eye(3))
    free = builder.add_joint_free(ball)
    hinge = builder.add_joint_revolute(ball, arm, axis=(0.0, 1.0, 0.0), friction=friction)
    builder.add_articulation([free, hinge])
    return builder.finalize(requires_grad=True)


def start(model: novaphy.Model) -> novaphy.SimState:
    """The ball moves into the ground."""
    state = model.state()
    state.joint_qd.assign(RATES)
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    return state


@pytest.mark.parametrize(("friction", "touching"), [(0.0, True), (0.1, False), (0.1, True)])
def test_a_tape_notices_that_a_step_has_overwritten_a_state(friction, touching):
    model = ball_with_an_arm(friction)
    solver, pipeline = (
        novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code"),
        novaphy.CollisionPipeline(model),
    )
    before, after = start(model), model.state()
    contacts = pipeline.contacts() if touching else None
    if touching:
        pipeline.collide(before, contacts)
    read = diff.state_joint_qd_tensor(after)
    with nova.Tape() as tape:
        loss = nova.sum(read * read)
    solver.step(before, after, None, contacts, DT)
    with pytest.raises(novaphy.Error, match="modified after recording"):
        tape.backward(loss)


def test_contacts_of_a_state_that_moved_are_frozen():
    model = ball_with_an_arm()
    solver, pipeline = (
        novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code"),
        novaphy.CollisionPipeline(model),
    )
    state, contacts = start(model), pipeline.contacts()

    def label() -> str:
        solver.clear_gradient_info()
        with nova.Tape() as tape:
            after = model.state()
            solver.step(state, after, None, contacts, DT)
            tape.backward(nova.sum(diff.state_joint_qd_tensor(after)))
        return solver.gradient_info()["label"]

    pipeline.collide(state, contacts)
    assert label() == "exact of the code"
    q = state.joint_q.numpy()
    q[2] -= 1e-3
    state.joint_q.assign(q)  # body_q, from which the contacts were found, stays
    assert label() == "frozen"
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    assert label() == "frozen"  # found from another body_q
    pipeline.collide(state, contacts)
    assert label() == "exact of the code"


@pytest.mark.parametrize("kind", ["given", "found", "friction"])
def test_a_replay_that_fails_gives_nan_and_the_next_call_says_why(kind):
    model = ball_with_an_arm(0.1 if kind == "friction" else 0.0)
    solver, pipeline = (
        novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code"),
        novaphy.CollisionPipeline(model),
    )
    trajectory = diff.Trajectory(model, 3)
    trajectory[0].joint_qd.assign(RATES)
    contacts = pipeline.contacts()
    pipeline.collide(start(model), contacts)
    ways = {"given": (contacts, None), "found": (None, pipeline), "friction": (None, None)}
    given, found = ways[kind]
    with nova.ScopedCapture() as capture:
        solver.rollout(trajectory, None, given, DT, pipeline=found)
    capture.graph.launch()
    assert np.isfinite(trajectory[3].joint_qd.numpy()).all()
    trajectory[0].joint_qd.assign(RATES * np.nan)
    capture.graph.launch()
    assert np.isnan(trajectory[3].joint_qd.numpy()).all()
    with pytest.raises(novaphy.Error, match="a replay of a captured step failed.*dof 0"):
        solver.rollout(trajectory, None, given, DT, pipeline=found)


@pytest.mark.parametrize(
    ("name", "value"),
    [("shape_material_mu", -1.0), ("joint_target_ke", np.nan), ("body_mass", np.nan),
     ("shape_margin", np.nan), ("shape_scale", -1.0), ("gravity", np.nan)],
)  # fmt: skip
def test_numbers_that_were_edited_are_named_by_steps_and_by_replays(name, value):
    model = ball_with_an_arm()
    solver, pipeline = (
        novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code"),
        novaphy.CollisionPipeline(model),
    )
    trajectory, array = diff.Trajectory(model, 2), getattr(model, name)
    with nova.ScopedCapture() as capture:
        solver.rollout(trajectory, None, None, DT, pipeline=pipeline)
    capture.graph.launch()
    good = array.numpy()
    bad = good.copy()
    bad.flat[0] = value
    array.assign(bad)
    match = rf"model\.{name}\[0\]"
    # Tables depend on the scale, so a graph freezes the scale.
    error, words = (novaphy.Error, "modified") if name == "shape_scale" else (ValueError, match)
    with pytest.raises(error, match=words):
        capture.graph.launch()
    state, contacts = start(model), pipeline.contacts()
    for solver_of in (novaphy.solvers.SolverFeatherstone, novaphy.solvers.DiffFeatherstoneSolver):
        with pytest.raises(ValueError, match=match):
            solver_of(model).step(state, model.state(), None, contacts, DT)
    array.assign(good)
    if name != "shape_scale":
        capture.graph.launch()
