"""Numbers that are written to the arrays of a model after it was made, and what captures hold."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import novaphy
from novaphy import diff, nova, solvers

DT = 1e-4
NAN = np.nan


def model():
    """A cloth of springs, triangles and hinges, and a block of tetrahedra, above the ground."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    size = {"cell_x": 0.1, "cell_y": 0.1}
    builder.add_cloth_grid(
        pos=(0, 0, 0.02), dim_x=2, dim_y=2, mass=0.01, add_springs=True, edge_ke=1.0, **size
    )
    builder.add_soft_grid(
        pos=(1, 0, 0.02), dim_x=1, dim_y=1, dim_z=1, cell_z=0.1, density=100.0, **size
    )
    builder.color()
    return builder.finalize()


def make(solver, of):
    if solver != "DiffSemiImplicitSolver":
        return getattr(solvers, solver)(of)
    elements = ("tetrahedra", "triangles", "springs", "bending")
    config = solvers.DiffSolverConfig(**{f"enable_{name}": True for name in elements})
    return solvers.DiffSemiImplicitSolver(of, config)


VBD = ["SolverVBD", "DiffSolverVBD"] if novaphy.has_vbd() else []
SOLVERS = ["SolverSemiImplicit", "DiffSemiImplicitSolver", *VBD]
NUMBER, NUMBERS = "expected a finite number", "expected finite numbers"
BAD = [
    ("gravity", NAN, f"{NUMBERS}, got nan"),
    ("particle_mass", NAN, f"{NUMBER} >= 0, got nan"),
    ("particle_mass", -1.0, f"{NUMBER} >= 0, got -1"),
    ("particle_mass", 1e-39, "expected 0 or a mass whose inverse is finite"),
    ("particle_inv_mass", NAN, NUMBER),
    ("particle_radius", NAN, NUMBER),
    ("particle_radius", -0.1, f"{NUMBER} >= 0, got -0.1"),
    ("particle_spring_stiffness", NAN, NUMBER),
    ("particle_spring_stiffness", -1.0, NUMBER),
    ("particle_spring_damping", -1.0, NUMBER),
    ("particle_spring_rest_length", NAN, NUMBER),
    ("particle_tri_material", NAN, f"{NUMBERS} >= 0, got nan"),
    ("particle_tri_material", -1.0, NUMBERS),
    ("particle_tri_activation", NAN, NUMBER),
    ("particle_tri_pose", NAN, NUMBERS),
    ("particle_tri_pose", 0.0, "expected a determinant > 0, got 0"),
    ("particle_tri_area", -1.0, NUMBER),
    ("particle_edge_material", -1.0, NUMBERS),
    ("particle_edge_rest_angle", NAN, NUMBER),
    ("particle_tet_material", NAN, NUMBERS),
    ("particle_tet_pose", 0.0, "expected a determinant > 0, got 0"),
    ("particle_tet_activation", np.inf, f"{NUMBER}, got inf"),
    ("shape_transform", NAN, NUMBERS),
    ("shape_transform", 1.0, r"expected a quaternion of length 1 \(to 1e-5\), got 2"),
    ("shape_scale", NAN, NUMBERS),
    ("shape_margin", NAN, NUMBER),
    ("shape_material_ke", -1.0, NUMBER),
    ("shape_material_mu", NAN, NUMBER),
]


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("array", "value", "message"), BAD)
def test_a_bad_number_of_particles_elements_or_shapes_is_named(solver, array, value, message):
    """Before anything is written, and the model works again when it is mended."""
    m = model()
    pipeline, step = novaphy.CollisionPipeline(m), make(solver, m).step
    contacts, state, after = pipeline.contacts(), m.state(), m.state()
    pipeline.collide(state, contacts)
    good = getattr(m, array).numpy()
    row = len(good) - 1
    bad = good.copy()
    bad.reshape(len(bad), -1)[row] = value
    getattr(m, array).assign(bad)
    with pytest.raises(ValueError, match=rf"{solver[-9:]}.*: model.{array}\[{row}\]: {message}"):
        step(state, after, None, contacts, DT)
    np.testing.assert_array_equal(after.particle_q.numpy(), m.particle_q.numpy())
    getattr(m, array).assign(good)
    state.clear_forces()
    step(state, after, None, contacts, DT)
    assert np.isfinite(after.particle_q.numpy()).all()
    assert (after.particle_q.numpy() != m.particle_q.numpy()).any()


JOINTS = [
    ("joint_X_p", NAN, NUMBERS),
    ("joint_axis", NAN, NUMBERS),
    ("joint_target_ke", -1.0, f"{NUMBER} >= 0, got -1"),
    ("joint_target_q", np.inf, f"{NUMBER}, got inf"),
    ("joint_damping", NAN, NUMBER),
    ("joint_limit_lower", NAN, NUMBER),
    ("joint_limit_kd", -0.5, NUMBER),
    ("joint_effort_limit", NAN, NUMBER),
    ("joint_axis", 0.0, "expected a vector that is not zero, got 0"),
    ("joint_X_c", 0.0, "expected a quaternion that is not zero, got 0"),
    ("joint_limit_lower", 2e10, r"expected at most joint_limit_upper, 1e\+10, got 2e\+10"),
]


def hinge():
    builder = novaphy.ModelBuilder()
    links = [builder.add_link(mass=1.0, inertia=np.eye(3)) for _ in range(2)]
    fixed = builder.add_joint_fixed(-1, links[0])
    builder.add_articulation([fixed, builder.add_joint_revolute(*links, axis=(0, 1, 0))])
    return builder.finalize()


@pytest.mark.parametrize("solver", SOLVERS[:2])
@pytest.mark.parametrize(("array", "value", "message"), JOINTS)
def test_a_bad_number_of_a_penalty_joint_is_named(solver, array, value, message):
    """In every step behind a first one, too."""
    m = hinge()
    step, state, after = make(solver, m).step, m.state(), m.state()
    step(state, after, None, None, DT)
    good = getattr(m, array).numpy()
    values = good.copy()
    values.reshape(len(values), -1)[-1] = value
    getattr(m, array).assign(values)
    for _ in range(2):
        with pytest.raises(ValueError, match=rf"model.{array}\[{len(values) - 1}\]: {message}"):
            step(state, after, None, None, DT)
    getattr(m, array).assign(good)
    step(state, after, None, None, DT)


@pytest.mark.parametrize("solver", SOLVERS[:2])
@pytest.mark.parametrize(
    "inertia",
    [
        [[1, 2, 0], [2, 1, 0], [0, 0, 1]],
        [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]],
        [[1, 0.9, 0.9], [0.9, 1, -0.9], [0.9, -0.9, 1]],
    ],
    ids=["indefinite", "not symmetric", "indefinite by its determinant"],
)
def test_an_inertia_that_no_body_has_is_named(solver, inertia):
    m = hinge()
    step, state, after = make(solver, m).step, m.state(), m.state()
    step(state, after, None, None, DT)
    values = m.body_inertia.numpy()
    values[1] = inertia
    m.body_inertia.assign(values)
    for _ in range(2):
        with pytest.raises(ValueError, match=r"body_inertia\[1\]: expected a symmetric, positive"):
            step(state, after, None, None, DT)


@pytest.mark.parametrize("solver", SOLVERS[:2])
@pytest.mark.parametrize("array", ["joint_armature", "joint_friction", "joint_velocity_limit"])
def test_what_penalty_joints_do_not_have_is_refused_behind_the_first_step(solver, array):
    m = hinge()
    step, state, after = make(solver, m).step, m.state(), m.state()
    step(state, after, None, None, DT)
    getattr(m, array).fill_(0.5)
    for _ in range(2):
        with pytest.raises(NotImplementedError, match=rf"model.{array}\[0\]: expected .* got 0.5"):
            step(state, after, None, None, DT)


def test_a_launch_refuses_what_penalty_joints_do_not_have():
    m = hinge()
    solver, trajectory = make("DiffSemiImplicitSolver", m), diff.Trajectory(m, 2)
    with nova.ScopedCapture() as capture:
        solver.rollout(trajectory, None, None, DT)
    capture.graph.launch()
    m.joint_armature.fill_(0.5)
    with pytest.raises(novaphy.Error, match="graph.launch"):
        capture.graph.launch()


LEGAL_ZEROS = [
    *("particle_mass", "particle_radius", "particle_spring_stiffness", "particle_spring_damping"),
    *("particle_spring_rest_length", "particle_tri_material", "particle_edge_material"),
    *("particle_tet_material", "shape_material_ke", "shape_material_mu", "shape_margin"),
]


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("array", LEGAL_ZEROS)
def test_zeros_that_the_laws_allow_pass(solver, array):
    m = model()
    pipeline, step = novaphy.CollisionPipeline(m), make(solver, m).step
    contacts, state, after = pipeline.contacts(), m.state(), m.state()
    pipeline.collide(state, contacts)
    getattr(m, array).assign(np.zeros_like(getattr(m, array).numpy()))
    step(state, after, None, contacts, DT)
    assert np.isfinite(after.particle_q.numpy()).all()


def captured(solver, m):
    """A graph of three steps, and the positions that a launch writes last."""
    pipeline, states = novaphy.CollisionPipeline(m), [m.state() for _ in range(4)]
    contacts, of = pipeline.contacts(), make(solver, m)
    pipeline.collide(states[0], contacts)
    if solver != "SolverVBD":
        states = diff.Trajectory(m, 3)
    with nova.ScopedCapture() as capture:
        if solver == "SolverVBD":
            for before, after in itertools.pairwise(states):
                of.step(before, after, None, contacts, DT)
        else:
            of.rollout(states, None, contacts, DT)
    return capture.graph, states[3].particle_q, of


CAPTURED = ["DiffSemiImplicitSolver", *VBD]


@pytest.mark.parametrize("solver", CAPTURED)
@pytest.mark.parametrize(
    ("array", "value"), [("shape_margin", NAN), ("shape_material_mu", -1.0), ("gravity", NAN)]
)
def test_a_launch_refuses_a_bad_number_before_it_writes(solver, array, value):
    m = model()
    graph, q, _ = captured(solver, m)
    graph.launch()
    good, before = getattr(m, array).numpy(), q.numpy()
    assert np.isfinite(before).all()
    getattr(m, array).assign(np.full_like(good, value))
    with pytest.raises(ValueError, match=rf"{solver}: model.{array}\[0\]: .*got {value:g}"):
        graph.launch()
    np.testing.assert_array_equal(q.numpy(), before)
    getattr(m, array).assign(good)
    graph.launch()
    np.testing.assert_array_equal(q.numpy(), before)


@pytest.mark.parametrize("solver", CAPTURED)
@pytest.mark.parametrize("number", ["soft_contact_ke", "soft_contact_mu"])
def test_a_launch_refuses_another_number_of_the_model_than_that_recorded(solver, number):
    m = model()
    graph, q, of = captured(solver, m)
    graph.launch()
    good, before = getattr(m, number), q.numpy()
    setattr(m, number, 2.0 * good)
    with pytest.raises(novaphy.Error, match=f"model.{number}: recorded as {good:g}, and now"):
        graph.launch()
    np.testing.assert_array_equal(q.numpy(), before)
    setattr(m, number, good)
    graph.launch()
    np.testing.assert_array_equal(q.numpy(), before)
    if solver == "DiffSolverVBD":  # a step raises after a failed replay
        of.step(m.state(), m.state(), None, None, DT)


def test_a_graph_that_trains_a_stiffness_below_zero_is_refused_at_its_next_launch():
    m = model()
    stiffness = diff.model_spring_stiffness_tensor(m)
    stiffness.requires_grad = True
    stiffness.grad.fill_(1.0)
    solver, trajectory = make("DiffSemiImplicitSolver", m), diff.Trajectory(m, 2)
    pipeline = novaphy.CollisionPipeline(m)
    with nova.ScopedCapture() as capture:
        solver.rollout(trajectory, None, None, DT, pipeline=pipeline)
        nova.sgd_update_f32(stiffness, 60.0)
    capture.graph.launch()
    assert (stiffness.numpy() == 40.0).all()
    capture.graph.launch()
    assert (stiffness.numpy() == -20.0).all()
    with pytest.raises(ValueError, match=r"particle_spring_stiffness\[0\]: .* >= 0, got -20"):
        capture.graph.launch()
