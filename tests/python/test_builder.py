"""ModelBuilder: what it takes, what it refuses, and that a refused call changes nothing."""

from __future__ import annotations

import copy

import numpy as np
import pytest

import novaphy
from novaphy import Axis, GeoType, ModelBuilder, ShapeConfig

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    "convert",
    [tuple, list, np.array, np.float32, np.float16, lambda v: [np.float32(x) for x in v]],
    ids=["tuple", "list", "float64", "float32", "float16", "scalars"],
)
def test_positions_may_be_any_sequence_of_numbers(convert):
    builder = ModelBuilder()
    assert builder.add_particle(convert([1, 2, 3]), convert([4, 5, 6]), np.float64(2)) == 0
    assert builder.particle_q == [(1.0, 2.0, 3.0)] and builder.particle_qd[0] == (4.0, 5.0, 6.0)


def test_numbers_are_rounded_to_float32():
    builder = ModelBuilder()
    builder.add_particle((0.1, 0.2, 0.3), (0, 0, 0), 1 / 3)
    builder.add_particles(np.full((2, 3), 0.1), np.zeros((2, 3)), np.full(2, 0.1), [0.7, 0.8])
    model = builder.finalize()
    np.testing.assert_array_equal(model.particle_q.numpy()[0], np.float32([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(model.particle_mass.numpy(), np.float32([1 / 3, 0.1, 0.1]))
    np.testing.assert_array_equal(model.particle_radius.numpy(), np.float32([0.1, 0.7, 0.8]))


def test_an_axis_is_a_name_a_number_or_a_unit_vector():
    for axis in (Axis.Y, 1, "y", "Y", (0, 1, 0), np.array([0.0, 1.0, 0.0])):
        builder = ModelBuilder(up_axis=axis)
        assert builder.up_axis == Axis.Y and builder.up_vector == (0, 1, 0)
        assert builder.gravity == pytest.approx((0, -9.81, 0))
    for bad in (3, -1, "w", "", (0, 1, 1), (0, -1, 0)):
        with pytest.raises(ValueError, match="axis"):
            ModelBuilder(up_axis=bad)
    for bad in (None, 1.5, object()):
        with pytest.raises(TypeError, match="axis"):
            ModelBuilder(up_axis=bad)


def test_gravity_is_a_number_along_up_or_a_vector():
    assert ModelBuilder("x", -2).gravity == (-2, 0, 0)
    assert ModelBuilder(gravity=(1, 2, 3)).gravity == (1, 2, 3)
    builder = ModelBuilder()
    builder.gravity = -1.5
    assert builder.gravity == (0, 0, -1.5)
    builder.gravity = np.array([1.0, 0.0, 0.0])
    np.testing.assert_array_equal(builder.finalize().gravity.numpy(), [[1, 0, 0]])
    with pytest.raises(ValueError, match="gravity"):
        ModelBuilder(gravity=(0, NAN, 0))
    with pytest.raises(ValueError, match="gravity: expected 3 numbers, got 2"):
        builder.gravity = (1, 2)
    with pytest.raises(TypeError):
        ModelBuilder(gravity="down")


def test_enumerations_are_integers_with_newtons_values():
    assert [a.value for a in Axis] == [0, 1, 2] and Axis.Z == 2
    assert GeoType.BOX == 7 and GeoType.CAPSULE == 4 and GeoType.CONVEX_MESH == 10
    assert novaphy.ShapeFlags.COLLIDE_SHAPES | novaphy.ShapeFlags.VISIBLE == 3
    assert novaphy.ModelFlags.ALL == 63 and novaphy.ParticleFlags.ACTIVE == 1
    assert novaphy.BodyFlags.KINEMATIC == 2 and repr(Axis.X) == "<Axis.X: 0>"


BAD_PARTICLES = [
    ({"pos": (NAN, 0, 0)}, ValueError, "pos"),
    ({"pos": (0, INF, 0)}, ValueError, "pos"),
    ({"pos": (1e39, 0, 0)}, ValueError, "pos"),
    ({"pos": (0, 0)}, ValueError, "pos: expected 3 numbers, got 2"),
    ({"pos": np.zeros(4)}, ValueError, "pos: expected 3 numbers, got 4"),
    ({"pos": "xyz"}, TypeError, "pos"),
    ({"pos": 1.0}, TypeError, "pos"),
    ({"pos": None}, TypeError, "pos"),
    ({"pos": (0, "a", 0)}, TypeError, "pos: expected a number, got str"),
    ({"vel": (0, 0, NAN)}, ValueError, "vel"),
    ({"vel": [-INF, 0, 0]}, ValueError, "vel"),
    ({"mass": -1.0}, ValueError, "mass"),
    ({"mass": NAN}, ValueError, "mass"),
    ({"mass": INF}, ValueError, "mass"),
    ({"mass": None}, TypeError, "mass"),
    ({"radius": -0.1}, ValueError, "radius"),
    ({"radius": NAN}, ValueError, "radius"),
    ({"flags": 8}, ValueError, "flags"),
    ({"colour": 1}, TypeError, "colour"),
]


@pytest.mark.parametrize(("change", "error", "message"), BAD_PARTICLES)
def test_a_bad_particle_is_refused_and_leaves_the_builder_as_it_was(change, error, message):
    builder = ModelBuilder()
    builder.add_particle((0, 0, 0), (0, 0, 0), 1.0)
    arguments = {"pos": (0, 0, 0), "vel": (0, 0, 0), "mass": 1.0, **change}
    with pytest.raises(error, match=message):
        builder.add_particle(**arguments)
    assert builder.particle_count == 1 and len(builder.particle_mass) == 1
    many = {name: [(1, 1, 1)] if name in ("pos", "vel") else [1.0] for name in ("pos", "vel")}
    many["mass"] = [1.0]
    many |= {name: [value] for name, value in change.items()}
    with pytest.raises((ValueError, TypeError)):
        builder.add_particles(**many)
    assert builder.particle_count == 1 and builder.finalize().particle_count == 1


def test_lists_of_particles_have_one_length():
    builder = ModelBuilder()
    q = np.zeros((3, 3))
    for arguments in (
        (q, q[:2], [1.0] * 3),
        (q, q, [1.0] * 2),
        (q, q, [1.0] * 3, [0.1]),
        (q, q, [1.0] * 3, None, [1, 1]),
        (np.zeros((3, 4)), q, [1.0] * 3),
        (np.zeros(9), q, [1.0] * 3),
    ):
        with pytest.raises(ValueError, match="add_particles|shape"):
            builder.add_particles(*arguments)
    with pytest.raises(TypeError):
        builder.add_particles(np.array([["a", "b", "c"]]), q[:1], [1.0])
    assert builder.particle_count == 0
    builder.add_particles(q, q, [1.0, 0.0, 2.0])
    assert builder.particle_count == 3
    builder.add_particles([], [], [])
    np.testing.assert_array_equal(builder.finalize().particle_inv_mass.numpy(), [1, 0, 0.5])


BAD_SHAPES = [
    ("add_shape_box", {"hx": 0.0}, ValueError, "hx"),
    ("add_shape_box", {"hy": -1.0}, ValueError, "hy"),
    ("add_shape_box", {"hz": NAN}, ValueError, "scale"),
    ("add_shape_sphere", {"radius": 0.0}, ValueError, "radius"),
    ("add_shape_sphere", {"radius": INF}, ValueError, "scale"),
    ("add_shape_capsule", {"half_height": 0.0}, ValueError, "half_height"),
    ("add_shape_capsule", {"radius": -1.0}, ValueError, "radius"),
    ("add_shape_box", {"xform": (0, 0, 0, 0, 0, 0, 2)}, ValueError, "quaternion"),
    ("add_shape_box", {"xform": (0, 0, 0, 0, 0, 0, 0)}, ValueError, "quaternion"),
    ("add_shape_box", {"xform": ((0, 0, 0), (0, 0, 0, NAN))}, ValueError, "quaternion"),
    ("add_shape_box", {"xform": (NAN, 0, 0, 0, 0, 0, 1)}, ValueError, "xform"),
    ("add_shape_box", {"xform": (0, 0, 0)}, ValueError, "xform: expected 7 numbers"),
    ("add_shape_box", {"xform": ((0, 0, 0), (0, 0, 1))}, ValueError, "xform: expected 4 numbers"),
    ("add_shape_box", {"xform": 3}, TypeError, "xform"),
    ("add_shape_box", {"radius": 1.0}, TypeError, "radius"),
    ("add_shape_box", {"cfg": {"ke": 1}}, TypeError, "add_shape_box"),
    ("add_shape_box", {"cfg": ShapeConfig(ke=-1)}, ValueError, "cfg.ke"),
    ("add_shape_box", {"cfg": ShapeConfig(mu=NAN)}, ValueError, "cfg.mu"),
    ("add_shape_box", {"cfg": ShapeConfig(margin=INF)}, ValueError, "cfg.margin"),
    ("add_shape_box", {"cfg": ShapeConfig(gap=-1)}, ValueError, "cfg.gap"),
]


@pytest.mark.parametrize(("method", "change", "error", "message"), BAD_SHAPES)
def test_a_bad_shape_is_refused_and_leaves_the_builder_as_it_was(method, change, error, message):
    builder = ModelBuilder()
    builder.add_ground_plane()
    with pytest.raises(error, match=message):
        getattr(builder, method)(-1, **change)
    assert builder.shape_count == 1 and builder.finalize().shape_count == 1


def test_indices_are_checked():
    builder = ModelBuilder()
    builder.add_ground_plane()
    builder.add_shape_sphere(-1)
    for body in (0, 1, -2):
        with pytest.raises(IndexError, match="body"):
            builder.add_shape_sphere(body)
    for pair in ((0, 2), (-1, 0)):
        with pytest.raises(IndexError, match="filter_pair"):
            builder.add_shape_collision_filter_pair(*pair)
    with pytest.raises(ValueError, match="two different shapes"):
        builder.add_shape_collision_filter_pair(1, 1)
    builder.add_shape_collision_filter_pair(1, 0)
    assert builder.finalize().shape_collision_filter_pairs == {(0, 1)}


def test_options_after_the_star_are_keyword_only():
    builder = ModelBuilder()
    for call in (
        lambda: builder.add_shape_box(-1, None, 1.0),
        lambda: builder.add_ground_plane(1.0),
        lambda: builder.add_shape_plane((0, 0, 1, 0), None),
        lambda: builder.finalize("cpu", True),
    ):
        with pytest.raises(TypeError):
            call()


def test_shapes_get_their_values():
    builder = ModelBuilder()
    half = 0.5**0.5
    cfg = ShapeConfig(ke=5.0, has_shape_collision=False, margin=0.25, is_solid=False)
    builder.add_shape_box(-1, xform=(1, 2, 3, 0, 0, half, half), hx=1, hy=2, hz=3, cfg=cfg)
    builder.add_shape_plane((0, 0, 2, -1.0), width=0, length=0, label="floor")
    builder.add_shape_capsule(-1, radius=0.5, half_height=2.0)
    builder.add_ground_plane(height=-1.0)
    builder.add_shape(body=-1, type=GeoType.SPHERE, scale=(0.25, 0, 0))
    model = builder.finalize()
    assert model.shape_label == ["shape_0", "floor", "shape_2", "ground_plane", "shape_4"]
    assert list(model.shape_type.numpy()) == [
        GeoType.BOX,
        GeoType.PLANE,
        GeoType.CAPSULE,
        GeoType.PLANE,
        GeoType.SPHERE,
    ]
    np.testing.assert_allclose(
        model.shape_scale.numpy(), [[1, 2, 3], [0, 0, 0], [0.5, 2, 0], [0, 0, 0], [0.25, 0, 0]]
    )
    np.testing.assert_allclose(model.shape_transform[0], [1, 2, 3, 0, 0, half, half])
    np.testing.assert_allclose(model.shape_transform[1], [0, 0, 0.5, 0, 0, 0, 1])
    np.testing.assert_allclose(model.shape_transform[3][:3], [0, 0, -1])
    assert model.shape_material_ke[0] == 5 and model.shape_margin[0] == 0.25
    assert model.shape_flags[0] == cfg.flags == 5 and list(model.shape_is_solid.numpy()[:2]) == [
        0,
        1,
    ]
    assert model.shape_collision_aabb_upper.ptr == model.shape_aabb_upper.ptr
    with pytest.raises(NotImplementedError, match="HFIELD"):
        builder.add_shape(body=-1, type=GeoType.HFIELD)
    for bad in (GeoType.MESH, GeoType.CONVEX_MESH):
        with pytest.raises(ValueError, match=f"{bad.name} needs vertices; use add_shape_mesh"):
            builder.add_shape(body=-1, type=bad, scale=(1, 1, 1))
    with pytest.raises(ValueError):
        builder.add_shape(body=-1, type=99)
    with pytest.raises(ValueError, match="plane"):
        builder.add_shape_plane((0, 0, 0, 1))


def test_a_nearly_unit_quaternion_is_normalised():
    builder = ModelBuilder()
    builder.add_shape_sphere(-1, xform=((0, 0, 0), (0, 0, 0, 1.0005)))
    np.testing.assert_array_equal(builder.finalize().shape_transform[0][3:], [0, 0, 0, 1])


def test_shape_config_copies_and_defaults():
    cfg = ShapeConfig()
    assert (cfg.density, cfg.ke, cfg.kd, cfg.kf, cfg.mu) == (1000, 2500, 100, 1000, 1)
    assert cfg.gap is None and cfg.flags == 7 and ModelBuilder.ShapeConfig is ShapeConfig
    for made in (cfg.copy(), copy.copy(cfg), copy.deepcopy(cfg)):
        made.ke = 7
        assert cfg.ke == 2500
    with pytest.raises(TypeError):
        ShapeConfig(stiffness=1)
    builder = ModelBuilder()
    builder.default_shape_cfg.ke = 9.0
    builder.default_particle_radius = 0.5
    builder.rigid_gap = 0.75
    builder.add_shape_sphere(-1)
    builder.add_particle((0, 0, 0), (0, 0, 0), 1)
    model = builder.finalize()
    assert model.shape_material_ke[0] == 9 and model.particle_radius[0] == 0.5
    assert model.shape_gap[0] == 0.75


def test_the_lists_of_a_builder_are_writable_and_keep_their_length():
    builder = ModelBuilder()
    builder.add_particles(np.zeros((3, 3)), np.zeros((3, 3)), [1.0] * 3)
    builder.particle_q[1] = np.array([1.0, 2.0, 3.0])
    builder.particle_q[-1] = (4, 5, 6)
    builder.particle_qd = np.ones((3, 3))
    builder.particle_mass[0:2] = [2.0, 3.0]
    builder.particle_flags[0] = 0
    assert builder.particle_q == [(0, 0, 0), (1, 2, 3), (4, 5, 6)]
    assert builder.particle_q[1:] == [(1, 2, 3), (4, 5, 6)] and len(builder.particle_q) == 3
    assert list(builder.particle_mass) == [2, 3, 1] and repr(builder.particle_flags) == "[0, 1, 1]"
    model = builder.finalize()
    np.testing.assert_array_equal(model.particle_q.numpy(), [[0, 0, 0], [1, 2, 3], [4, 5, 6]])
    for error, change in (
        (IndexError, lambda: builder.particle_q.__setitem__(3, (0, 0, 0))),
        (IndexError, lambda: builder.particle_q[-4]),
        (ValueError, lambda: builder.particle_q.__setitem__(0, (0, 0))),
        (ValueError, lambda: builder.particle_mass.__setitem__(slice(0, 2), [1.0])),
        (ValueError, lambda: setattr(builder, "particle_mass", [1.0])),
        (TypeError, lambda: builder.particle_q[0].__setitem__(0, 1.0)),
        (TypeError, lambda: builder.particle_flags.__setitem__(0, 1.5)),
    ):
        with pytest.raises((error, AttributeError) if error is TypeError else error):
            change()
    kept = builder.particle_q
    builder = None  # the list keeps what it shows alive
    assert kept[1] == (1, 2, 3)


def test_finalize_checks_edited_values_again_and_may_be_repeated():
    builder = ModelBuilder()
    builder.add_particle((0, 0, 0), (0, 0, 0), 1.0)
    first = builder.finalize(requires_grad=True)
    assert first.requires_grad and first.state().requires_grad
    assert not first.state(requires_grad=False).requires_grad
    builder.particle_mass[0] = -1.0
    with pytest.raises(ValueError, match="particle_mass"):
        builder.finalize()
    builder.finalize(skip_validation=True)
    builder.particle_mass[0] = 2.0
    assert builder.finalize().particle_mass[0] == 2 and first.particle_mass[0] == 1
    with pytest.raises(ValueError, match="device"):
        builder.finalize("abacus")
    with pytest.raises(TypeError):
        builder.finalize(needs_grad=True)
