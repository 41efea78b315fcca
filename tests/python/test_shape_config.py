"""Every field of ShapeConfig either acts in a solver, or is refused by it."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import solvers

DT = 1e-3
# Another value than the default of each.
FIELDS = {
    "density": 500.0,
    "ke": 4000.0,
    "kd": 50.0,
    "kf": 20.0,
    "ka": 0.01,
    "mu": 0.0,
    "restitution": 0.5,
    "mu_torsional": 0.01,
    "mu_rolling": 1e-3,
    "margin": 0.003,
    "gap": 0.0,
    "is_solid": False,
    "collision_group": 0,
    "collision_filter_parent": False,
    "has_shape_collision": False,
    "has_particle_collision": False,
    "is_visible": False,
    "is_site": True,
    "mixing": (1.0, 1.0, 1.0, 0.0),
}
# Fields that builders, viewers or contacts of trees read (test_mjcf_contacts.py).
ELSEWHERE = {"is_visible", "collision_filter_parent", "mixing"}
UNREAD = {"restitution", "mu_torsional", "mu_rolling"}
BASE = {"ke": 2000.0, "kd": 30.0, "kf": 5.0, "mu": 0.9, "margin": 0.002}


def config(friction=True, **settings):
    """A surface, without the friction that VBD has no setting for."""
    base = BASE if friction else {k: v for k, v in BASE.items() if k != "kf"}
    return novaphy.ShapeConfig(**(base | settings))


def bodies(**settings):
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=config(**settings))
    for x, height in ((0.0, 0.099), (1.0, 0.109), (2.0, 0.24)):  # in touch, near, in the gap
        body = builder.add_body(
            xform=(x, 0, height, 0, 0, 0, 1), mass=1.0, inertia=0.01 * np.eye(3)
        )
        builder.body_qd[body] = (0.3, 0.2, -0.4, 0.1, 0.2, 0.3)
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=config(**settings), label="crate")
    return builder.finalize()


def particles(friction, **settings):
    builder = novaphy.ModelBuilder()
    builder.add_shape_box(-1, hx=1, hy=1, hz=0.1, cfg=config(friction, **settings), label="table")
    builder.add_particle((0.1, 0.2, 0.145), (0.3, 0.2, -0.4), 1.0, radius=0.05)
    if not friction:
        builder.color()
    model = builder.finalize()
    if friction:  # below the cone of mu = 0.9, above that of 0
        model.soft_contact_kf, model.soft_contact_mu = 5.0, 0.0
    return model


def semi_implicit(model):
    return solvers.SolverSemiImplicit(model)


def differentiable(model):
    return solvers.DiffSemiImplicitSolver(model)


# For each case: the model, the solver, and the fields that the solver does not read.
CASES = {
    "bodies": (bodies, semi_implicit, UNREAD),
    "bodies, differentiable": (bodies, differentiable, UNREAD),
    "particles": (lambda **s: particles(True, **s), semi_implicit, UNREAD | {"ka"}),
    "particles, differentiable": (
        lambda **s: particles(True, **s),
        differentiable,
        UNREAD | {"ka"},
    ),
    "vbd": (lambda **s: particles(False, **s), solvers.SolverVBD, UNREAD | {"ka", "kf"}),
    "vbd, differentiable": (
        lambda **s: particles(False, **s),
        solvers.DiffSolverVBD,
        UNREAD | {"ka", "kf"},
    ),
}
# Fields that act only between shapes, or only on the mass of a body.
OF_BODIES = {"density", "gap", "is_solid", "collision_group", "has_shape_collision"}


def test_the_table_has_all_fields():
    settable = {n for n, m in vars(novaphy.ShapeConfig).items() if getattr(m, "fset", None)}
    assert set(FIELDS) == settable


def states(model, make):
    pipeline = novaphy.CollisionPipeline(model)
    solver, state, after = make(model), model.state(), model.state()
    for _ in range(20):
        contacts = pipeline.contacts()
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, DT)
        state, after = after, state
    return np.concatenate(
        [
            a.numpy().ravel()
            for a in (
                state.body_q,
                state.body_qd,
                state.particle_q,
                state.particle_qd,
                contacts.rigid_contact_count,
            )
        ]
    )


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("field", FIELDS)
def test_a_field_acts_or_is_refused(name, field):
    make_model, make, unread = CASES[name]
    changed = make_model(**{field: FIELDS[field]})
    if field in unread:
        label = "crate" if "bodies" in name else "table"
        first = "shape 0" if "bodies" in name else rf"shape 0 \({label}\)"
        with pytest.raises(NotImplementedError, match=rf"{first}.*ShapeConfig\.{field} "):
            make(changed)
        return
    if field in ELSEWHERE or ("bodies" not in name and field in OF_BODIES):
        return
    if "bodies" in name and field == "has_particle_collision":
        return  # there are no particles
    if "bodies" not in name and field == "margin":
        return  # widens the search for particles
    assert not np.array_equal(states(changed, make), states(make_model(), make)), field


@pytest.mark.parametrize("name", CASES)
def test_a_value_that_is_written_later_is_refused_too(name):
    make_model, make, unread = CASES[name]
    model = make_model()
    solver, state, after = make(model), model.state(), model.state()
    contacts = novaphy.CollisionPipeline(model).contacts()
    solver.step(state, after, None, contacts, DT)
    for field in sorted(unread):
        array = getattr(model, f"shape_material_{field}")
        before = array.numpy()
        array.assign(np.full_like(before, 0.7))
        with pytest.raises(NotImplementedError, match=rf"shape 0.*ShapeConfig\.{field} "):
            solver.step(state, after, None, contacts, DT)
        array.assign(before)
    solver.step(state, after, None, contacts, DT)


def hanging_sphere(**settings):
    """A sphere on a hinge above the ground, and its state."""
    builder = novaphy.ModelBuilder()
    link = builder.add_link(mass=1.0)
    builder.add_shape_sphere(link, radius=0.1, cfg=novaphy.ShapeConfig(**settings))
    joint = builder.add_joint_revolute(-1, link, axis=(0, 1, 0))
    builder.add_articulation([joint])
    builder.add_ground_plane()
    model = builder.finalize()
    state = model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    return model, state


@pytest.mark.parametrize("contact", ["pgs", "penalty"])
@pytest.mark.parametrize("make", [solvers.SolverFeatherstone, solvers.DiffFeatherstoneSolver])
def test_contacts_of_articulations_refuse_what_no_force_uses(make, contact):
    if make is solvers.DiffFeatherstoneSolver and contact == "penalty":
        pytest.skip("it takes no penalty contacts")
    unread = {"mu_torsional", "mu_rolling", "ka" if contact == "pgs" else "restitution"}
    for field in sorted(unread):
        model, state = hanging_sphere(**{field: FIELDS[field]})
        pipeline = novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        pipeline.collide(state, contacts)
        with pytest.raises(NotImplementedError, match=rf"shape 0.*: ShapeConfig\.{field} "):
            make(model, contact=contact).step(state, model.state(), None, contacts, DT)


@pytest.mark.parametrize("restitution", [-0.1, 1.01, float("nan")])
def test_a_restitution_outside_0_to_1_is_refused(restitution):
    builder = novaphy.ModelBuilder()
    cfg = novaphy.ShapeConfig(restitution=restitution)
    with pytest.raises(ValueError, match=r"add_shape_sphere: cfg\.restitution: expected"):
        builder.add_shape_sphere(-1, radius=0.1, cfg=cfg)
    assert builder.shape_count == 0
    builder.add_shape_sphere(-1, radius=0.1, cfg=novaphy.ShapeConfig(restitution=1.0))
