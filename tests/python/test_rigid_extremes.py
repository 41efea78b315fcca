"""Large inputs, places far away, and worlds in one place."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import solvers
from novaphy.testing import assert_same_bits

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
SURFACE = novaphy.ShapeConfig(ke=1e4, kd=100.0, kf=100.0, mu=0.5)


def rows_of(model, **options):
    pipeline = novaphy.CollisionPipeline(model, **options)
    contacts = pipeline.contacts()
    pipeline.collide(model.state(), contacts)
    assert not contacts.overflowed
    return contacts.rigid_contacts()


@pytest.mark.slow
def test_a_mesh_of_a_million_triangles_has_the_contacts_of_its_plane():
    slope = np.tile(0.1 * 0.5 * np.arange(708, dtype=np.float32), (708, 1))
    builder = novaphy.ModelBuilder()
    mesh = novaphy.io.height_field(slope, 0.5)
    assert len(mesh.indices) == 2 * 707**2
    builder.add_shape_mesh(-1, mesh=mesh)
    up = np.array([-0.1, 0, 1]) / np.sqrt(1.01)
    for x in np.linspace(-150, 150, 10):
        height = 0.1 * (x + 0.25 * 707)
        place = np.array([x, 0.13, height]) + 0.29 * up
        builder.add_shape_sphere(builder.add_body(xform=(*place, *UPRIGHT)), radius=0.3)
    rows = rows_of(builder.finalize())
    assert len(rows) == 10
    towards = np.where(rows["shape1"] > 0, 1, -1)[:, None]
    np.testing.assert_allclose(rows["normal"] * towards, np.tile(up, (10, 1)), atol=2e-4)


def test_a_hull_of_many_points_keeps_64_of_them():
    points = np.random.default_rng(0).standard_normal((100_000, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    builder = novaphy.ModelBuilder()
    builder.add_shape_convex_hull(builder.add_body(), vertices=points.astype(np.float32))
    model = builder.finalize()
    assert model.mesh_vertex_count == 64
    assert model.body_mass.numpy()[0] == pytest.approx(1000 * 4 / 3 * np.pi, rel=0.15)


def test_of_a_hundred_thousand_candidates_all_three_searches_find_the_same():
    builder = novaphy.ModelBuilder()
    random = np.random.default_rng(1)
    for k in range(450):
        place = np.array([k % 21, k // 21, 0.0]) + random.uniform(-0.2, 0.2, 3)
        builder.add_shape_sphere(builder.add_body(xform=(*place, *UPRIGHT)), radius=0.5)
    model = builder.finalize()
    assert model.shape_contact_pair_count == 450 * 449 / 2
    explicit, nxn, sap = (rows_of(model, broad_phase=b) for b in ("explicit", "nxn", "sap"))
    assert len(explicit) > 500
    assert (explicit == nxn).all() and (explicit == sap).all()


@pytest.mark.parametrize("distance", [1e4, 1e5])
def test_ten_kilometres_away_two_boxes_touch_as_at_the_origin(distance):
    """To the digits that poses have there, 0.5 mm at 10 km: the same points, normals and depth."""

    def rows(x):
        builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
        for k in range(2):
            body = builder.add_body(xform=(x, -x, 0.19 * k, *UPRIGHT))
            builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
        return rows_of(builder.finalize())

    here, there = rows(0.0), rows(distance)
    for name in ("shape0", "shape1", "point_id", "normal"):
        assert (here[name] == there[name]).all()
    for name in ("point0", "point1"):
        assert (here[name][:, 2] == there[name][:, 2]).all(), "which is the depth"
        np.testing.assert_allclose(there[name], here[name], atol=np.spacing(np.float32(distance)))


def arm(gravity):
    """Two boxes that a fixed joint holds, and an arm that overlaps its parent, over the ground."""
    builder = novaphy.ModelBuilder(gravity=gravity)
    builder.add_ground_plane(cfg=SURFACE)
    base = builder.add_link(xform=(0, 0, 0.14, *UPRIGHT))
    builder.add_shape_box(base, hx=0.1, hy=0.1, hz=0.1, cfg=SURFACE)
    tool = builder.add_link(xform=(0.3, 0, 0.14, *UPRIGHT))
    builder.add_shape_sphere(tool, radius=0.1, cfg=SURFACE)
    link = builder.add_link(xform=(0, 0.15, 0.16, *UPRIGHT))
    builder.add_shape_box(link, hx=0.1, hy=0.1, hz=0.1, cfg=SURFACE)
    joints = [
        builder.add_joint_free(base),
        builder.add_joint_fixed(base, tool, parent_xform=(0.3, 0, 0, *UPRIGHT)),
        builder.add_joint_revolute(
            base,
            link,
            axis=(1, 0, 0),
            parent_xform=(0, 0.05, 0.02, *UPRIGHT),
            child_xform=(0, -0.1, 0, *UPRIGHT),
        ),
    ]
    builder.add_articulation(joints)
    builder.collapse_fixed_joints()
    builder.body_qd[0] = (0.4, 0.1, -0.3, 0.2, 0.1, 0.3)
    return builder


def moved(model, steps=200):
    pipeline, solver = novaphy.CollisionPipeline(model), solvers.SolverSemiImplicit(model)
    contacts, state, after = pipeline.contacts(), model.state(), model.state()
    pairs = set()
    for _ in range(steps):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, 1 / 960)
        rows = contacts.rigid_contacts()
        pairs |= {(int(r["shape0"]), int(r["shape1"])) for r in rows if r["force"].any()}
        state, after = after, state
    return np.concatenate([state.body_q.numpy(), state.body_qd.numpy()], axis=1), pairs


def test_worlds_in_one_place_with_joints_filters_and_gravity_of_their_own_equal_each_alone():
    """The arm never touches its parent, nor what lies in another world where it is."""
    gravities = ((0, 0, -9.81), (0, 0, -3.0), (1.0, 0, -20.0))
    builder = novaphy.ModelBuilder()
    for gravity in gravities:
        builder.add_world(arm(gravity))
    together, pairs = moved(builder.finalize())
    alone = [moved(arm(gravity).finalize()) for gravity in gravities]
    assert len(together) == 6, "two bodies a world: the tool is part of its base"
    assert_same_bits(together, np.concatenate([state for state, _ in alone]))
    shapes = 4  # in each world
    assert pairs == {(a + shapes * w, b + shapes * w) for w in range(3) for a, b in alone[w][1]}
    assert all({a for a, _ in one} == {0} and len(one) == 3 for _, one in alone), "the ground only"
    assert np.abs(alone[0][0] - alone[1][0]).max() > 1e-2
