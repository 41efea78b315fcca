"""Meshes and convex hulls as shapes, from Python: building, copies, errors."""

import pickle

import numpy as np
import pytest

import novaphy
from novaphy import ModelBuilder
from novaphy.io import Mesh

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
