"""Static contacts follow the arrays that they are made from, or say that they cannot."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

diff = pytest.importorskip("novaphy.diff")
nova = pytest.importorskip("novaphy.nova")
solvers = novaphy.solvers

CONFIG = {"enable_static_contacts": True}
BOX, MESH = int(novaphy.GeoType.BOX), int(novaphy.GeoType.MESH)


def resting_box():
    """A box that touches the ground; the model and a differentiable solver."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    body = builder.add_body(xform=((0, 0, 0.095), (0, 0, 0, 1)))
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    model = builder.finalize(requires_grad=True)
    return model, solvers.DiffSemiImplicitSolver(model, solvers.DiffSolverConfig(**CONFIG))


@pytest.mark.parametrize(
    ("array", "value"),
    [("shape_type", [1, MESH]), ("shape_body", [-1, -1]), ("shape_contact_pairs", None)],
)
def test_a_graph_refuses_to_run_after_its_pairs_of_bodies_changed(array, value):
    model, solver = resting_box()
    trajectory = diff.Trajectory(model, 5)
    with nova.ScopedCapture() as capture:
        solver.rollout(trajectory, None, None, 1e-3)
    capture.graph.launch()
    changed = getattr(model, array)
    changed.assign(changed.numpy() if value is None else np.int32(value))
    with pytest.raises(novaphy.Error, match="modified after the capture"):
        capture.graph.launch()


def test_a_graph_refuses_to_run_after_the_worlds_of_shapes_changed():
    builder = novaphy.ModelBuilder()
    for _ in range(2):
        builder.begin_world()
        builder.add_particle((0, 0, 0.05), (0, 0, -1), 1.0, radius=0.1)
        builder.add_ground_plane()
        builder.end_world()
    model = builder.finalize()
    solver = solvers.DiffSemiImplicitSolver(model, solvers.DiffSolverConfig(**CONFIG))
    trajectory = diff.Trajectory(model, 5)
    with nova.ScopedCapture() as capture:
        solver.rollout(trajectory, None, None, 1e-2)
    capture.graph.launch()
    model.shape_world.assign(np.int32([0, 0]))
    with pytest.raises(novaphy.Error, match="modified after the capture"):
        capture.graph.launch()


def test_a_solver_asks_again_whether_the_shapes_are_covered():
    builder = novaphy.ModelBuilder(gravity=0)
    builder.add_particle((0.35, 0, 0), (0, 0, 0), 1.0, radius=0.1)
    builder.add_shape_box(-1, hx=0.3, hy=0.3, hz=0.3)
    model = builder.finalize()
    solver = solvers.DiffSemiImplicitSolver(model, solvers.DiffSolverConfig(**CONFIG))
    trajectory = diff.Trajectory(model, 1)
    solver.rollout(trajectory, None, None, 1e-2)
    assert trajectory[1].particle_qd.numpy()[0, 0] > 0.1
    model.shape_type.assign(np.int32([MESH]))
    with pytest.raises(NotImplementedError, match="shape 0"):
        solver.rollout(trajectory, None, None, 1e-2)
    model.shape_type.assign(np.int32([BOX]))
    solver.rollout(trajectory, None, None, 1e-2)


@pytest.mark.parametrize("pairs", [[[0, 2_000_000_000], [0, 1]], [[0, 99]], [[0, -1]]])
def test_pairs_of_shapes_that_are_not_there_are_named(pairs):
    model, _ = resting_box()
    model.shape_contact_pairs.assign(np.int32(np.resize(pairs, model.shape_contact_pairs.shape)))
    with pytest.raises(IndexError, match=r"model\.shape_contact_pairs: expected shapes from 0 to"):
        solvers.DiffSemiImplicitSolver(model, solvers.DiffSolverConfig(**CONFIG))


@pytest.mark.parametrize("shape", ["sphere", "capsule", "box"])
def test_attraction_ends_at_the_gap_as_in_the_forward_solver(shape):
    surface = novaphy.ShapeConfig(ke=1e3, kd=10.0, kf=50.0, mu=0.5, ka=0.05, gap=0.0)
    builder = novaphy.ModelBuilder(gravity=0)
    builder.add_ground_plane(cfg=surface)
    body = builder.add_body(xform=((0, 0, 0.12), (0, 0, 0, 1)))
    if shape == "sphere":
        builder.add_shape_sphere(body, radius=0.1, cfg=surface)
    elif shape == "capsule":
        side = (0, np.sqrt(0.5), 0, np.sqrt(0.5))
        builder.add_shape_capsule(
            body, xform=((0, 0, 0), side), radius=0.1, half_height=0.2, cfg=surface
        )
    else:
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=surface)
    model = builder.finalize()
    trajectory = diff.Trajectory(model, 1)
    solver = solvers.DiffSemiImplicitSolver(model, solvers.DiffSolverConfig(**CONFIG))
    solver.rollout(trajectory, None, None, 1e-2)
    assert trajectory[1].body_qd.numpy().tolist() == [[0.0] * 6]


@pytest.mark.parametrize("name", ["mass", "inertia"])
def test_an_inverse_that_is_held_at_zero_passes_no_gradient(name):
    builder = novaphy.ModelBuilder(gravity=0)
    builder.add_body(mass=1.0, inertia=np.eye(3))
    model = builder.finalize()
    inverse = getattr(model, f"body_inv_{name}")
    inverse.assign(np.zeros_like(inverse.numpy()))
    source = getattr(diff, f"model_body_{name}_tensor")(model, requires_grad=True)
    solver, trajectory = solvers.DiffSemiImplicitSolver(model), diff.Trajectory(model, 1)
    diff.state_body_f_tensor(trajectory[0]).assign(np.float32([[1, 0, 0, 1, 0, 0]]))
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, 1.0)
        tape.backward(nova.sum(diff.state_body_qd_tensor(trajectory[1])))
    assert not source.grad.numpy().any()


def test_parts_that_would_not_move_are_refused():
    builder = novaphy.ModelBuilder()
    builder.add_particle((1, 2, 3), (0, 0, 0), 1.0)
    model = builder.finalize()
    config = solvers.DiffSolverConfig(enable_particles=False)
    with pytest.raises(NotImplementedError, match="enable_particles is false"):
        solvers.DiffSemiImplicitSolver(model, config)
