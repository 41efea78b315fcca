"""Meshes and convex hulls as shapes, from Python: building, copies, errors."""

import pickle

import numpy as np
import pytest

import novaphy
from novaphy import ModelBuilder
from novaphy.io import Mesh
from novaphy.viewer._model_scene import ModelScene, model_arrays
from novaphy.viewer._scene import Scene

CUBE = Mesh(
    np.array([[x, y, z] for z in (-0.1, 0.1) for y in (-0.1, 0.1) for x in (-0.1, 0.1)], "f4"),
    np.array(
        [
            [0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4],
            [2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5],
        ],
        "i4",
    ).reshape(-1, 3),
)


def scene() -> ModelBuilder:
    builder = ModelBuilder()
    builder.add_shape_mesh(-1, mesh=CUBE, scale=(20, 20, 1))
    body = builder.add_body(xform=(0, 0, 0.195, 0, 0, 0, 1))
    builder.add_shape_convex_hull(body, vertices=CUBE.vertices, label="die")
    return builder


def test_the_model_holds_each_mesh_once() -> None:
    builder = scene()
    builder.add_shape_mesh(0, vertices=CUBE.vertices, indices=CUBE.indices.ravel(), scale=0.5)
    model = builder.finalize()
    assert (model.mesh_vertex_count, model.mesh_triangle_count) == (16, 24)
    assert model.shape_mesh_range.numpy().tolist() == [[0, 8, 0, 12], [8, 8, 12, 12], [0, 8, 0, 12]]
    assert model.shape_type.numpy().tolist() == [
        novaphy.GeoType.MESH,
        novaphy.GeoType.CONVEX_MESH,
        novaphy.GeoType.MESH,
    ]
    np.testing.assert_array_equal(model.mesh_vertices.numpy()[:8], CUBE.vertices)
    np.testing.assert_array_equal(model.mesh_indices.numpy()[:12], CUBE.indices)
    np.testing.assert_array_equal(model.shape_scale.numpy()[2], [0.5, 0.5, 0.5])
    np.testing.assert_allclose(model.body_mass.numpy(), [8.0 + 1.0], rtol=1e-6)


def test_a_copy_from_a_pickle_finds_the_same_contacts() -> None:
    model = scene().finalize()
    other = pickle.loads(pickle.dumps(model))
    rows = [
        novaphy.Model.collide(m, m.state()).rigid_contacts() for m in (model, other, model.clone())
    ]
    assert len(rows[0]) == 4
    np.testing.assert_allclose(rows[0]["normal"], [[0, 0, 1]] * 4)
    for copied in rows[1:]:
        np.testing.assert_array_equal(copied, rows[0])


@pytest.mark.parametrize(
    ("add", "error", "text"),
    [
        (lambda b: b.add_shape_mesh(0), ValueError, "`mesh`, or `vertices` and `indices`"),
        (lambda b: b.add_shape_convex_hull(0), ValueError, "`mesh` or `vertices`"),
        (
            lambda b: b.add_shape_mesh(0, vertices=CUBE.vertices, indices=CUBE.indices[1:]),
            ValueError,
            "closed mesh",
        ),
        (
            lambda b: b.add_shape_mesh(0, vertices=CUBE.vertices, indices=[[0, 1, 8]]),
            IndexError,
            r"indices\[2\]: expected 0 to 7, got 8",
        ),
        (lambda b: b.add_shape_mesh(0, mesh=CUBE, scale=0.0), ValueError, "scale.x"),
        (
            lambda b: b.add_shape_convex_hull(0, vertices=CUBE.vertices[:4]),
            ValueError,
            "add_shape_convex_hull: vertices",
        ),
    ],
)
def test_bad_meshes_are_refused(add, error, text) -> None:
    builder = ModelBuilder()
    builder.add_body(mass=1.0)
    with pytest.raises(error, match=text):
        add(builder)
    assert builder.shape_count == 0


def test_a_loaded_mesh_is_a_shape(tmp_path) -> None:
    if not novaphy.has_io():
        pytest.skip("this build has no mesh reader")
    path = tmp_path / "cube.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE.vertices]
    lines += ["f " + " ".join(str(i + 1) for i in t) for t in CUBE.indices]
    path.write_text("\n".join(lines) + "\n")
    builder = ModelBuilder()
    body = builder.add_body()
    builder.add_shape_mesh(body, mesh=novaphy.io.load_mesh(path))
    np.testing.assert_allclose(builder.finalize().body_mass.numpy(), [8.0], rtol=1e-6)


def test_a_viewer_draws_each_mesh_once_and_its_copies() -> None:
    builder = scene()
    builder.add_shape_convex_hull(-1, vertices=CUBE.vertices, scale=2.0)
    shown = Scene()
    ModelScene(shown, model_arrays(builder.finalize()))
    assert set(shown.meshes) == {"model/mesh_0", "model/convex_mesh_8"}
    assert shown.instances["model/convex_mesh_8"].count == 2
    points = shown.meshes["model/mesh_0"].points.values
    assert points.shape == (36, 3) and np.abs(points).max() == np.float32(0.1)
    np.testing.assert_allclose(shown.instances["model/mesh_0"].scales.values[0, :3], (20, 20, 1))


def test_fcl_is_asked_for_by_name() -> None:
    model = scene().finalize()
    assert novaphy.CollisionPipeline(model).narrow_phase == "auto"
    with pytest.raises(ValueError, match='narrow_phase: expected "auto" or "fcl"'):
        novaphy.CollisionPipeline(model, narrow_phase="mpr")
    try:
        pipeline = novaphy.CollisionPipeline(model, narrow_phase="fcl")
    except NotImplementedError as error:
        assert "NOVAPHY_WITH_FCL=ON" in str(error)
    else:
        assert pipeline.fcl_pair_count == pipeline.fcl_fallback_count == 0


def test_the_gradient_of_a_bounce_off_a_mesh_is_that_of_frozen_contacts() -> None:
    """On a flat mesh, where freezing loses nothing, it is the central difference."""
    diff = pytest.importorskip("novaphy.diff")
    builder = ModelBuilder()
    builder.add_shape_mesh(-1, mesh=CUBE, scale=(20, 20, 1))
    builder.add_particle((0.3, 0.2, 0.16), (0.5, 0.2, -2.0), 1.0, 0.05)
    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffSemiImplicitSolver(
        model, novaphy.solvers.DiffSolverConfig(contact_gradient="code")
    )
    pipeline = novaphy.CollisionPipeline(model, soft_contact_margin=0.1)
    contacts = pipeline.contacts()
    pipeline.collide(model.state(), contacts)
    assert contacts.active_soft_contact_count == 1

    def height(velocity: float) -> tuple[float, np.ndarray]:
        trajectory = diff.Trajectory(model, 200)
        trajectory[0].particle_qd = np.float32([[0.5, 0.2, velocity]])
        with novaphy.nova.Tape() as tape:
            solver.rollout(trajectory, None, contacts, 1 / 1000)
            loss = diff.particle_point_loss_generated(
                diff.state_particle_q_tensor(trajectory[200]), 0, 0.4, 0.24, 0.0
            )
            tape.backward(loss)
        return loss.item(), trajectory[0].particle_qd.grad.numpy()[0, 2]

    gradient = height(-2.0)[1]
    eps = 1e-2
    difference = (height(-2.0 + eps)[0] - height(-2.0 - eps)[0]) / (2 * eps)
    assert difference != 0.0
    assert abs(gradient - difference) < 2e-2 * abs(difference)


def test_contacts_of_meshes_are_always_reduced() -> None:
    model = novaphy.ModelBuilder().finalize()
    novaphy.CollisionPipeline(model, reduce_contacts=True)
    with pytest.raises(NotImplementedError, match="reduce_contacts: expected True"):
        novaphy.CollisionPipeline(model, reduce_contacts=False)


def test_a_height_field_is_a_terrain_that_carries_what_lies_on_it() -> None:
    """A slope of heights carries a ball as the plane does, and triangles look up."""
    slope = 0.3
    columns = np.arange(9)
    mesh = novaphy.io.height_field(np.tile(slope * 0.5 * columns, (5, 1)), 0.5, 0.25)
    assert mesh.vertices.shape == (45, 3) and mesh.indices.shape == (64, 3)
    np.testing.assert_allclose(mesh.vertices[[0, -1]], [(-2, -0.5, 0), (2, 0.5, 1.2)], atol=1e-6)
    a, b, c = (mesh.vertices[mesh.indices[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    np.testing.assert_allclose(
        np.linalg.norm(normal, axis=1) / 2, 0.0625 * np.sqrt(1.09), rtol=1e-5
    )
    up = np.array([-slope, 0, 1]) / np.sqrt(1.09)
    np.testing.assert_allclose(normal / np.linalg.norm(normal, axis=1)[:, None] @ up, 1, rtol=1e-6)

    builder = novaphy.ModelBuilder()
    builder.add_shape_mesh(-1, mesh=mesh)
    place = np.array([0.1, 0.05, 0.6 + slope * 0.1]) + 0.095 * up
    ball = builder.add_body(xform=(tuple(place), (0, 0, 0, 1)))
    builder.add_shape_sphere(ball, radius=0.1)
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(model.state(), contacts)
    (row,) = contacts.rigid_contacts()
    normal = row["normal"] * (1 if row["shape1"] == 1 else -1)
    np.testing.assert_allclose(normal, up, atol=1e-5)


@pytest.mark.parametrize(
    ("heights", "cell", "text"),
    [
        ([1.0, 2.0], 1.0, r"heights: expected at least 2 rows and 2 columns, got \(2,\)"),
        ([[1.0, 2.0]], 1.0, "got \\(1, 2\\)"),
        ([[0, 0], [0, np.nan]], 1.0, r"heights\[1, 1\]: expected a finite number, got nan"),
        ([[0, 0], [0, 0]], 0.0, "cell_x: expected a finite number > 0, got 0.0"),
    ],
)
def test_bad_heights_are_refused(heights, cell, text) -> None:
    with pytest.raises(ValueError, match=text):
        novaphy.io.height_field(heights, cell)
