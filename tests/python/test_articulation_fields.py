"""Every array of a model acts on a step of articulations, or other than its default it raises."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import novaphy

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
STEPS, DT = 40, 1 / 480


def scene(actuators: bool = True) -> novaphy.ModelBuilder:
    """A hinge beyond its limit, a driven hinge, a ball joint, and a box that slides and bounces."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5)
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(mu=0.4))
    box = builder.add_body(xform=((3.0, 0.0, 0.11), UPRIGHT))
    builder.add_shape_box(box, hx=0.1, hy=0.1, hz=0.1, cfg=surface)
    ball = builder.add_body(xform=((5.0, 0.0, 0.11), UPRIGHT))
    builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    links = [
        builder.add_link(mass=1.0, com=(0.02, 0.01, 0.0), inertia=np.diag([0.02, 0.03, 0.04]))
        for _ in range(3)
    ]
    hinge = {
        "axis": (0.0, 1.0, 0.0),
        "limit_ke": 50.0,
        "limit_kd": 0.5,
        "target_ke": 30.0,
        "target_kd": 1.0,
        "target_qd": 0.2,
    }
    at = {"child_xform": ((-0.3, 0.0, 0.0), UPRIGHT)}
    anchor = {"parent_xform": ((0.0, 0.0, 2.0), UPRIGHT)}
    joints = [
        builder.add_joint_revolute(
            -1, links[0], limit_lower=-0.5, limit_upper=0.5, **hinge, **at, **anchor
        ),
        builder.add_joint_revolute(links[0], links[1], effort_limit=5.0, **hinge, **at),
        builder.add_joint_ball(links[1], links[2], **at),
    ]
    builder.add_articulation(joints)
    if actuators:
        lag = {"dynamics": novaphy.ActuatorDynamics.FILTER, "time": 0.05, "act": 0.2, "ctrl": 0.4}
        builder.add_actuator(joints[0], ctrl_range=(-0.3, 0.3), bias=(0.3, 0.0, 0.0), **lag)
        builder.add_actuator(joints[1], act_range=(-1.0, 0.22), force_range=(-1.0, 0.1), **lag)
        builder.add_actuator(joints[1], act_range=(-1.0, 0.21), **lag)
        builder.add_actuator(joints[1], ctrl=0.4)
        builder.add_body_actuator(
            links[2], frame=((0.1, 0.0, 0.2), UPRIGHT), reference_body=links[0], ctrl=0.4,
            reference=((0.0, 0.1, 0.0), UPRIGHT), wrench=(1.0, 0.5, 2.0, 0.1, 0.2, 0.3),
            bias=(0.0, -3.0, 0.0),
        )  # fmt: skip
    hinges = builder.joint_count - 3
    assert hinges == 2
    builder.joint_q[14:16] = [0.7, 0.1]
    builder.joint_target_q[14:16] = [0.1, 0.9]
    builder.joint_qd[12:14] = [0.3, -0.2]
    builder.body_qd[box] = (1.0, 0.0, -2.0, 0.0, 0.0, 0.0)
    builder.body_qd[ball] = (0.5, 0.0, -2.0, 0.0, 0.0, 0.0)
    return builder


def run(
    edit: Callable[[novaphy.Model], None], kind: str = "SolverFeatherstone", **options: object
) -> np.ndarray:
    """All joint coordinates and velocities of a run, after an edit of the model."""
    model = scene().finalize()
    edit(model)
    solver = getattr(novaphy.solvers, kind)(model, **options)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    numbers = []
    for _ in range(STEPS):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, DT)
        state, after = after, state
        numbers += [state.joint_q.numpy(), state.joint_qd.numpy()]
    return np.concatenate(numbers)


def scaled(name: str, rows: slice = slice(None)) -> Callable[[novaphy.Model], None]:
    """Multiply rows by 1.3 and add a little."""

    def edit(model: novaphy.Model) -> None:
        array = getattr(model, name)
        values = array.numpy()
        values[rows] = values[rows] * 1.3 + 0.05
        array.assign(values)

    return edit


def of(name: str, rows: slice, value: object) -> Callable[[novaphy.Model], None]:
    """Set rows of an array."""

    def edit(model: novaphy.Model) -> None:
        array = getattr(model, name)
        values = array.numpy()
        values[rows] = value
        array.assign(values)

    return edit


def in_water(edit: Callable[[novaphy.Model], None]) -> Callable[[novaphy.Model], None]:
    """Fill the world with a fluid before an edit."""

    def both(model: novaphy.Model) -> None:
        model.fluid_density.fill_(50.0)
        edit(model)

    return both


HINGES, SHAPES = slice(12, 14), slice(0, 3)
ACT = {
    **{
        name: scaled(name, HINGES)
        for name in (
            "joint_armature",
            "joint_damping",
            "joint_f",
            "joint_friction",
            "joint_qd",
            "joint_target_kd",
            "joint_target_ke",
            "joint_target_qd",
        )
    },
    **{name: scaled(name, slice(12, 13)) for name in ("joint_limit_ke", "joint_limit_kd")},
    "joint_limit_lower": of("joint_limit_lower", slice(13, 14), 0.3),
    "joint_limit_upper": of("joint_limit_upper", slice(12, 13), 0.4),
    "joint_effort_limit": of("joint_effort_limit", slice(13, 14), 1.0),
    "joint_velocity_limit": of("joint_velocity_limit", HINGES, 0.2),
    "joint_q": scaled("joint_q", slice(14, 16)),
    "joint_target_q": scaled("joint_target_q", slice(14, 16)),
    "joint_target_mode": of("joint_target_mode", HINGES, 0),
    "joint_axis": of("joint_axis", HINGES, (1.0, 0.0, 0.0)),
    "joint_X_p": scaled("joint_X_p", (slice(3, 5), slice(0, 3))),
    "joint_X_c": scaled("joint_X_c", (slice(3, 5), slice(0, 3))),
    "body_mass": scaled("body_mass"),
    "body_com": scaled("body_com"),
    "body_inertia": of("body_inertia", slice(None), np.eye(3) * 0.07),
    **{
        f"actuator_{name}": scaled(f"actuator_{name}")
        for name in ("gear", "time", "ctrl_range", "act_range", "force_range")
    },
    "actuator_wrench": scaled("actuator_wrench"),
    **{
        f"actuator_{name}": scaled(f"actuator_{name}", (slice(4, 5), slice(0, 3)))
        for name in ("frame", "reference")
    },
    "actuator_gain": of("actuator_gain", slice(0, 1), (1.3, 0.0, 0.0)),
    "actuator_bias": of("actuator_bias", slice(0, 1), (0.4, -0.2, -0.1)),
    "actuator_dynamics": of("actuator_dynamics", slice(0, 2), 1),
    "body_gravcomp": of("body_gravcomp", slice(None), 0.2),
    "fluid_density": of("fluid_density", slice(None), 90.0),
    "fluid_viscosity": of("fluid_viscosity", slice(None), 0.5),
    **{
        name: in_water(of(name, slice(None), value))
        for name, value in (
            ("fluid_wind", (1.0, 0.0, 0.5)),
            ("body_fluid_box", (0.2, 0.3, 0.1)),
            ("body_fluid_frame", (0.6, 0.0, 0.0, 0.8)),
        )
    },
    "ctrl": scaled("ctrl"),
    "act": scaled("act"),
    "gravity": of("gravity", slice(None), (0.0, 1.0, -5.0)),
    "shape_material_mu": of("shape_material_mu", SHAPES, 0.1),
    "shape_material_restitution": of("shape_material_restitution", SHAPES, 0.6),
    "shape_mixing": of("shape_mixing", SHAPES, (0.0, 1.0, 1.0, 0.0)),
    "shape_margin": of("shape_margin", SHAPES, 0.01),
    "shape_gap": of("shape_gap", SHAPES, 0.0),
    "shape_scale": of("shape_scale", slice(1, 3), 0.08),
    "shape_transform": of("shape_transform", slice(1, 2), (0.0, 0.0, 0.02, *UPRIGHT)),
}
RAISE = {
    "joint_act": of("joint_act", HINGES, 0.5),
    "joint_enabled": of("joint_enabled", slice(3, 4), 0),
    "shape_material_ka": of("shape_material_ka", SHAPES, 0.01),
    "shape_material_mu_torsional": of("shape_material_mu_torsional", SHAPES, 0.1),
    "shape_material_mu_rolling": of("shape_material_mu_rolling", SHAPES, 0.1),
    "body_flags": of("body_flags", slice(2, 3), 2),
}
# Numbers that the builder would have refused.
NOT_NEGATIVE = (
    *(f"joint_{name}" for name in ("armature", "damping", "friction", "target_ke", "target_kd")),
    *(f"joint_{name}" for name in ("limit_ke", "limit_kd", "effort_limit", "velocity_limit")),
    *(f"shape_material_{name}" for name in ("mu", "restitution", "ke", "kd", "kf", "ka")),
    "body_mass",
)
FINITE = ("body_com", "joint_limit_lower", "joint_limit_upper", "joint_axis", "joint_X_p")
WRONG = {
    **{
        f"{name} < 0": (of(name, slice(1, 2), -0.5), rf"{name}\[1\].*>= 0") for name in NOT_NEGATIVE
    },
    **{
        f"{name} nan": (of(name, slice(1, 2), np.nan), rf"{name}\[1\]: expected .*finite number")
        for name in (*NOT_NEGATIVE, *FINITE)
    },
    "limits reversed": (
        of("joint_limit_lower", slice(12, 13), 0.9),
        r"joint_limit_lower\[12\]: expected at most joint_limit_upper, 0.5, got 0.9",
    ),
    "restitution > 1": (of("shape_material_restitution", SHAPES, 1.5), "at most 1, got 1.5"),
    "inertia": (of("body_inertia", slice(2, 3), -np.eye(3)), r"body_inertia\[2\].*>= 0, got -1"),
    "axis": (of("joint_axis", HINGES, (0.0, 2.0, 0.0)), r"joint_axis\[12\]: .* length 1, got 2"),
    "frame": (of("joint_X_c", slice(3, 4), (0, 0, 0, 0, 0, 0, 2.0)), r"joint_X_c\[3\]: .*got 2"),
    "actuator": (of("actuator_gain", slice(0, 1), np.nan), r"actuator_gain\[0\]: .*finite"),
    "dynamics": (
        of("actuator_dynamics", slice(1, 2), 0),
        r"actuator_dynamics\[1\]: expected 1 to 3",
    ),
    "range": (of("actuator_ctrl_range", slice(1, 2), (1, 0)), r"actuator_ctrl_range\[1\]: .*first"),
    "mode": (of("joint_target_mode", HINGES, 9), r"joint_target_mode\[12\]: .*TargetMode, got 9"),
}
# Fields of the other contact laws.
PENALTY = ("shape_material_ke", "shape_material_kd", "shape_material_kf")
# The structure of the model, which is read when solver and pipeline are made.
STRUCTURE = (
    "joint_type",
    "joint_parent",
    "joint_child",
    "joint_dof_dim",
    "joint_q_start",
    "joint_qd_start",
    "joint_articulation",
    "joint_ancestor",
    "joint_world",
    "joint_mimic",
    "joint_mimic_coef",
    "actuator_dof",
    "actuator_body",
    "actuator_axes",
    "actuator_state",
    "body_world",
    "shape_body",
    "shape_type",
    "shape_flags",
    "shape_world",
    "shape_collision_group",
    "shape_contact_pairs",
    "shape_mesh_range",
)
# Follow from others, are of masses and bounds when a model is built, or for viewers.
DERIVED = (
    "body_q",
    "body_qd",
    "body_inv_mass",
    "body_inv_inertia",
    "shape_is_solid",
    "shape_collision_radius",
    "shape_color",
)


def test_the_table_has_every_array_of_a_model() -> None:
    model = scene().finalize()
    arrays = {name for name in dir(model) if isinstance(getattr(model, name), novaphy.DeviceArray)}
    for name in arrays:
        if name.startswith(("particle_", "spring_", "edge_", "tri_", "tet_")):
            continue  # none of them: models with particles are refused
        kinds = [
            name in ACT,
            name in RAISE,
            name in PENALTY,
            name in DERIVED or "_aabb_" in name,
            name in STRUCTURE or name.startswith(("articulation_", "mesh_")),
        ]
        assert sum(kinds) == 1, name
    assert set(ACT) | set(RAISE) | set(PENALTY) <= arrays


@pytest.fixture(scope="module")
def base() -> np.ndarray:
    return run(lambda model: None)


@pytest.mark.parametrize("name", sorted(ACT))
def test_an_edited_array_acts(name: str, base: np.ndarray) -> None:
    in_fluid = name.startswith(("body_fluid_", "fluid_wind"))
    before = run(in_water(lambda model: None)) if in_fluid else base
    assert not np.array_equal(run(ACT[name]), before)


@pytest.mark.parametrize("name", sorted(RAISE))
def test_a_value_without_effect_raises(name: str) -> None:
    with pytest.raises(NotImplementedError, match=name if name != "body_flags" else "kinematic"):
        run(RAISE[name])


@pytest.mark.parametrize("solver", ["SolverFeatherstone", "DiffFeatherstoneSolver"])
@pytest.mark.parametrize("name", sorted(WRONG))
def test_a_number_that_the_builder_refuses_is_named(name: str, solver: str) -> None:
    """At every step, and before anything is written."""
    if solver.startswith("Diff") and not novaphy.has_diff():
        pytest.skip("needs NOVAPHY_WITH_DIFF")
    edit, message = WRONG[name]
    model = scene().finalize()
    made = getattr(novaphy.solvers, solver)(model)
    state, after = model.state(), model.state()
    made.step(state, after, None, None, DT)
    before = after.joint_qd.numpy().copy()
    edit(model)
    for _ in range(2):
        with pytest.raises(ValueError, match=message):
            made.step(state, after, None, None, DT)
    np.testing.assert_array_equal(after.joint_qd.numpy(), before)


@pytest.mark.parametrize("name", ["joint_act", "joint_enabled", "body_flags"])
def test_a_value_without_effect_raises_behind_the_first_step(name: str) -> None:
    model = scene().finalize()
    solver = novaphy.solvers.SolverFeatherstone(model)
    state, after = model.state(), model.state()
    solver.step(state, after, None, None, DT)
    RAISE[name](model)
    with pytest.raises(NotImplementedError, match=name if name != "body_flags" else "kinematic"):
        solver.step(state, after, None, None, DT)


@pytest.mark.parametrize("name", PENALTY)
def test_springs_of_shapes_act_where_contacts_are_springs(name: str) -> None:
    edit = scaled(name, SHAPES)
    options = {"contact": "penalty"}
    assert not np.array_equal(run(edit, **options), run(lambda model: None, **options))
    if name != "shape_material_kf":
        options = {"compliant_contacts": True}
        assert not np.array_equal(run(edit, **options), run(lambda model: None, **options))


def test_restitution_raises_under_penalty() -> None:
    with pytest.raises(NotImplementedError, match="shape_material_restitution"):
        run(ACT["shape_material_restitution"], contact="penalty")


def refused(kind: str) -> novaphy.ModelBuilder:
    """A model with something that a step of articulations does not have."""
    builder = scene()
    link = builder.add_link(mass=1.0, inertia=np.eye(3))
    if kind == "distance":
        builder.add_articulation([builder.add_joint_distance(-1, link, max_distance=1.0)])
    elif kind == "loose":
        builder.add_joint_revolute(-1, link, axis=(0.0, 1.0, 0.0))
    elif kind == "disabled":
        builder.add_articulation([builder.add_joint_free(link, enabled=False, label="off")])
    elif kind == "loop":
        builder.add_articulation([builder.add_joint_free(link)])
        builder.add_joint_ball(0, link, label="closing")
    else:
        builder.add_articulation([builder.add_joint_free(link)])
    if kind == "particles":
        builder.add_particle((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), 1.0)
    return builder


REFUSED = {
    "distance": "DISTANCE joints are not supported",
    "loose": "belongs to no articulation: name it in add_articulation",
    "loop": r"joint 6 \('closing'\) belongs to no articulation: its child has another joint",
    "disabled": r"joint 5 \('off'\): joints that are not enabled are not supported: give the child",
    "particles": "expected particle_count 0",
}


@pytest.mark.parametrize("solver", ["SolverFeatherstone", "DiffFeatherstoneSolver"])
@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_not_covered_is_refused_by_name(kind: str, solver: str) -> None:
    if solver.startswith("Diff") and not novaphy.has_diff():
        pytest.skip("needs NOVAPHY_WITH_DIFF")
    model = refused(kind).finalize()
    with pytest.raises(NotImplementedError, match=f"{solver}: model.*{REFUSED[kind]}"):
        getattr(novaphy.solvers, solver)(model)


def test_a_body_without_a_joint_is_refused_by_name() -> None:
    builder = scene()
    builder.add_link(mass=1.0, inertia=np.eye(3), label="lost")
    model = builder.finalize(skip_validation=True)
    with pytest.raises(
        NotImplementedError, match=r"body 5 \('lost'\) has no joint: add_body gives"
    ):
        novaphy.solvers.SolverFeatherstone(model)


diff = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")


@pytest.fixture(scope="module")
def diff_base() -> np.ndarray:
    return run(lambda model: None, "DiffFeatherstoneSolver")


@diff
@pytest.mark.parametrize("name", sorted(ACT))
def test_an_edited_array_acts_in_the_differentiable_solver(
    name: str, diff_base: np.ndarray
) -> None:
    assert not np.array_equal(run(ACT[name], "DiffFeatherstoneSolver"), diff_base)


@diff
@pytest.mark.parametrize("name", sorted(RAISE))
def test_the_differentiable_solver_refuses_what_it_does_not_have(name: str) -> None:
    with pytest.raises(NotImplementedError, match=name if name != "body_flags" else "kinematic"):
        run(RAISE[name], "DiffFeatherstoneSolver")
