"""solver.step(state, state, ...): the bits of two states, and the refusal on a tape."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import solvers
from novaphy.testing import assert_same_bits

DT = 1e-3
FIELDS = ("particle_q", "particle_qd", "body_q", "body_qd", "joint_q", "joint_qd")


def cloth() -> novaphy.Model:
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    builder.add_cloth_grid(
        pos=(0, 0, 0.05), rot=(0, 0, 0, 1), vel=(0.1, 0, -1.0), dim_x=4, dim_y=4, cell_x=0.05,
        cell_y=0.05, mass=0.01, particle_radius=0.01,
    )  # fmt: skip
    builder.color()
    return builder.finalize()


def boxes() -> novaphy.Model:
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    for k in range(2):
        body = builder.add_body(xform=((0, 0, 0.1 + 0.199 * k), (0, 0, 0, 1)))
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    builder.body_qd[1] = (0.2, 0, 0, 0, 0, 0.5)
    return builder.finalize()


def arm() -> novaphy.Model:
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    joints, previous = [], -1
    for _ in range(2):
        body = builder.add_link()
        builder.add_shape_capsule(
            body, xform=((0, 0, -0.2), (0, 0, 0, 1)), radius=0.04, half_height=0.15
        )
        xform = ((0, 0, 0.5 if previous < 0 else -0.4), (0, 0, 0, 1))
        joints.append(
            builder.add_joint_revolute(previous, body, axis=(0, 1, 0), parent_xform=xform)
        )
        previous = body
    builder.add_articulation(joints)
    builder.joint_q[:] = [0.7, 0.9]
    return builder.finalize()


ELEMENTS = {"enable_triangles": True, "enable_bending": True}
CASES = [
    ("SolverSemiImplicit", cloth, {}),
    ("SolverSemiImplicit", boxes, {}),
    ("SolverSemiImplicit", boxes, {"stick_ke": 1e4}),
    ("SolverFeatherstone", arm, {}),
    ("SolverFeatherstone", arm, {"contact": "penalty"}),
    ("SolverVBD", cloth, {}),
    ("DiffSemiImplicitSolver", cloth, ELEMENTS),
    ("DiffSemiImplicitSolver", boxes, {}),
    ("DiffFeatherstoneSolver", arm, {}),
    ("DiffSolverVBD", cloth, {}),
]


def solver_of(name, model, options):
    if not hasattr(solvers, name):
        pytest.skip(f"this build has no {name}")
    if name == "DiffSemiImplicitSolver":
        options = {"config": solvers.DiffSolverConfig(**options)}
    return getattr(solvers, name)(model, **options)


@pytest.mark.parametrize(("name", "scene", "options"), CASES)
def test_one_state_has_the_bits_of_two(name, scene, options):
    model = scene()
    two, one = (solver_of(name, model, options) for _ in range(2))
    pipeline = novaphy.CollisionPipeline(model)
    found, again = pipeline.contacts(), pipeline.contacts()
    now, after, state = model.state(), model.state(), model.state()
    views = {field: getattr(state, field) for field in FIELDS}
    for step in range(40):
        for each in (now, state):
            each.clear_forces()
            if each.body_f.shape[0]:
                each.body_f.fill_((0.1, 0, 0.2, 0, 0, 0.01))
        pipeline.collide(now, found)
        two.step(now, after, None, found, DT)
        pipeline.collide(state, again)
        one.step(state, state, None, again, DT)
        for field in FIELDS:
            assert_same_bits(
                getattr(state, field), getattr(after, field).numpy(), f"{step} {field}"
            )
        for field in ("particle_f", "body_f"):
            assert_same_bits(getattr(state, field), getattr(now, field).numpy(), f"{step} {field}")
        now, after = after, now
    assert_same_bits(again.rigid_contact_force, found.rigid_contact_force.numpy())
    assert all(views[field].ptr == getattr(state, field).ptr for field in FIELDS)
    start = model.state()
    assert any(not np.array_equal(getattr(start, f).numpy(), views[f].numpy()) for f in FIELDS)


def test_what_a_step_does_not_write_stays():
    model = arm()
    state = model.state()
    state.joint_q.assign([0.25, -0.5])
    solver = solvers.SolverSemiImplicit(model)
    for _ in range(2):
        solver.step(state, state, None, None, DT / 2)
    assert state.joint_q.numpy().tolist() == [0.25, -0.5]


@pytest.mark.parametrize(
    ("name", "scene"),
    [("DiffSemiImplicitSolver", cloth), ("DiffFeatherstoneSolver", arm), ("DiffSolverVBD", cloth),
     ("SolverFeatherstone", arm), ("SolverSemiImplicit", cloth)],
)  # fmt: skip
def test_on_a_tape_it_says_why_not_and_what_to_do(name, scene):
    nova = pytest.importorskip("novaphy.nova")
    model = scene()
    options = ELEMENTS if name == "DiffSemiImplicitSolver" else {}
    solver, state = solver_of(name, model, options), model.state()
    contacts = novaphy.CollisionPipeline(model).contacts()
    before = [getattr(state, field).numpy() for field in FIELDS]
    with (
        nova.Tape(),
        pytest.raises(novaphy.Error, match=r"whose values the gradient needs; take two"),
    ):
        solver.step(state, state, None, contacts, DT)
    for field, values in zip(FIELDS, before, strict=True):
        assert_same_bits(getattr(state, field), values)
    with nova.Tape(), nova.no_grad():
        solver.step(state, state, None, contacts, DT)


def test_two_states_of_one_memory_and_another_model_are_refused_as_before():
    model, other = boxes(), boxes()
    solver, foreign = solvers.SolverSemiImplicit(model), other.state()
    with pytest.raises(ValueError, match="expected one of the solver's model"):
        solver.step(foreign, foreign, None, None, DT)
    with pytest.raises(ValueError, match="dt: expected a finite number"):
        solver.step(model.state(), foreign, None, None, 0.0)


def test_a_capture_of_it_has_the_bits_of_steps():
    nova = pytest.importorskip("novaphy.nova")
    model = cloth()
    captured, eager = (solver_of("SolverVBD", model, {}) for _ in range(2))
    state, other = model.state(), model.state()
    with nova.ScopedCapture() as capture:
        for _ in range(2):
            captured.step(state, state, None, None, DT)
    for _ in range(3):
        capture.graph.launch()
        eager.step(other, other, None, None, DT)
        eager.step(other, other, None, None, DT)
        for field in ("particle_q", "particle_qd"):
            assert_same_bits(getattr(state, field), getattr(other, field).numpy(), field)
