"""Shapes: colors, meshes, and which add mass."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy.io import Mesh
from novaphy.viewer._model_scene import ModelScene, model_arrays
from novaphy.viewer._scene import Scene

RED, NONE = (0.75, 0.25, 0.125), (-1.0, -1.0, -1.0)
TETRAHEDRON = Mesh(
    np.float32([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]),
    np.int32([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]),
)
ADD = {
    "add_shape_plane": {},
    "add_ground_plane": {},
    "add_shape_sphere": {"body": 0},
    "add_shape_box": {"body": 0},
    "add_shape_capsule": {"body": 0},
    "add_shape_cylinder": {"body": 0},
    "add_shape_cone": {"body": 0},
    "add_shape_ellipsoid": {"body": 0},
    "add_shape_mesh": {"body": 0, "mesh": TETRAHEDRON},
    "add_shape_convex_hull": {"body": 0, "mesh": TETRAHEDRON},
    "add_shape": {"type": novaphy.GeoType.SPHERE, "scale": (1, 0, 0)},
}


@pytest.mark.parametrize("function", ADD)
def test_every_shape_takes_a_color(function):
    builder = novaphy.ModelBuilder()
    builder.add_body()
    getattr(builder, function)(**ADD[function], color=RED)
    getattr(builder, function)(**ADD[function])
    with pytest.raises(ValueError, match="color: expected three numbers from 0 to 1"):
        getattr(builder, function)(**ADD[function], color=(0, 2, 0))
    assert builder.shape_count == 2
    two = novaphy.ModelBuilder()
    two.add_builder(builder)
    model = two.finalize(skip_validation=True)
    np.testing.assert_array_equal(model.shape_color.numpy(), np.float32([RED, NONE]))


def test_viewers_show_the_colors_of_a_model():
    builder = novaphy.ModelBuilder()
    body = builder.add_body()
    for color in (RED, None):
        builder.add_shape_sphere(body, color=color)
    model = builder.finalize()
    scene = Scene()
    shown = ModelScene(scene, model_arrays(model))
    colors = scene.instances["model/sphere"].colors.values
    np.testing.assert_array_equal(colors[0, :3], np.float32(RED))
    without = {k: v for k, v in model_arrays(model).items() if k != "shape_color"}
    other = Scene()
    ModelScene(other, without)
    np.testing.assert_array_equal(colors[1], other.instances["model/sphere"].colors.values[1])
    shown.color_shapes(np.array([0]), np.float32([(0, 0, 1, 0)]))
    np.testing.assert_array_equal(
        scene.instances["model/sphere"].colors.values[0], np.float32((0, 0, 1, 0))
    )


def test_a_static_shape_adds_no_mass():
    builder = novaphy.ModelBuilder()
    builder.add_body()
    builder.add_shape(body=0, type=novaphy.GeoType.BOX, scale=(0.5, 0.5, 0.5))
    builder.add_shape(
        body=0,
        type=novaphy.GeoType.BOX,
        scale=(1, 1, 1),
        xform=((3, 0, 0), (0, 0, 0, 1)),
        is_static=True,
    )
    open_mesh = Mesh(TETRAHEDRON.vertices, TETRAHEDRON.indices[:2])
    builder.add_shape(body=0, type=novaphy.GeoType.MESH, src=open_mesh, is_static=True)
    model = builder.finalize()
    assert model.body_mass.numpy()[0] == 1000.0
    np.testing.assert_array_equal(model.body_com.numpy()[0], 0.0)
    assert model.shape_contact_pair_count == 0


def test_add_shape_takes_the_mesh_of_a_type_and_the_model_gives_it_back():
    builder = novaphy.ModelBuilder()
    builder.add_body()
    kinds = novaphy.GeoType
    builder.add_shape(body=0, type=kinds.MESH, src=TETRAHEDRON, scale=(2, 2, 2), color=RED)
    builder.add_shape(body=-1, type=kinds.MESH, src=TETRAHEDRON, label="second")
    builder.add_shape_sphere(0)
    builder.add_shape(body=0, type=kinds.CONVEX_MESH, src=TETRAHEDRON)
    model = builder.finalize()
    first, second, sphere, hull = model.shape_source
    assert first is second and sphere is None
    np.testing.assert_array_equal(first.vertices, TETRAHEDRON.vertices)
    np.testing.assert_array_equal(first.indices, TETRAHEDRON.indices)
    assert sorted(map(tuple, hull.vertices)) == sorted(map(tuple, TETRAHEDRON.vertices))
    np.testing.assert_array_equal(model.shape_color.numpy()[0], np.float32(RED))
    assert model.shape_label[1] == "second"
    assert model.body_mass.numpy()[0] == pytest.approx(1000 * (8 / 6 + 4 * np.pi / 3 + 1 / 6))
    again = novaphy.ModelBuilder()
    again.add_shape(type=kinds.MESH, src=first)
    np.testing.assert_array_equal(again.finalize().mesh_vertices.numpy(), first.vertices)


def test_a_source_of_a_type_without_one_is_refused():
    with pytest.raises(ValueError, match="add_shape: src: expected None"):
        novaphy.ModelBuilder().add_shape(type=novaphy.GeoType.BOX, scale=(1, 1, 1), src=TETRAHEDRON)
