"""Worlds that are hard for a search: no contact is lost against the search over all pairs."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import nova
from novaphy.testing import assert_same_bits

COUNT = 640  # enough for shapes that stand apart from the tree of boxes
NAMES = ("shape0", "shape1", "point0", "point1", "offset0", "offset1", "normal", "point_id")


def place(builder, kind, at, size, turn):
    turn = turn / np.linalg.norm(turn)
    body = builder.add_body(xform=(*map(float, at), *map(float, turn)))
    if kind == 0:
        builder.add_shape_box(body, hx=size, hy=0.7 * size, hz=1.3 * size)
    elif kind == 1:
        builder.add_shape_sphere(body, radius=size)
    elif kind == 2:
        builder.add_shape_capsule(body, radius=0.5 * size, half_height=size)
    else:
        builder.add_shape_cylinder(body, radius=size, half_height=0.6 * size)


def heap(places, sizes, ground=True):
    """Shapes of four kinds at these places, with the gap of a hundredth of their size."""
    random = np.random.default_rng(3)
    builder = novaphy.ModelBuilder()
    if ground:
        builder.add_ground_plane(cfg=novaphy.ShapeConfig(gap=0.0))
    for k, (at, size) in enumerate(zip(places, sizes, strict=True)):
        builder.rigid_gap = 0.01 * float(size)
        place(builder, k % 4, at, float(size), random.standard_normal(4))
    return builder


def scattered(random, scale=1.0):
    return random.uniform(-4.0, 4.0, (COUNT, 3)) * scale


def one_cell(random):
    """120 shapes in one place, the others far around: all but one cell of a grid are empty."""
    places = scattered(random, 1e3)
    places[:120] = random.uniform(-1e-3, 1e-3, (120, 3))
    return heap(places, np.full(COUNT, 0.1))


def as_large_as_the_world(random):
    """A sphere and a box around everything else."""
    sizes = np.full(COUNT, 0.2)
    sizes[[1, 400]] = 20.0
    return heap(scattered(random), sizes)


def a_million_to_one(random):
    """Sizes of 10 micrometers to 10 m."""
    sizes = 10.0 ** random.uniform(-5.0, 0.0, COUNT)
    sizes[:3] = 10.0
    return heap(scattered(random), sizes)


def far_away(random):
    """A hundred kilometers from the origin, where a float has 8 mm."""
    return heap(scattered(random) + np.array([1e5, -1e5, 1e5]), np.full(COUNT, 0.3), ground=False)


def in_a_line(random):
    places = scattered(random) * [1.0, 0.0, 0.0] + [0.0, 0.0, 0.2]
    return heap(places, random.uniform(0.001, 0.01, COUNT))


def without_numbers(random):
    """Where `spoil` makes some poses NaN or infinite."""
    return heap(scattered(random), np.full(COUNT, 0.4))


def spoil(state):
    poses = state.body_q.numpy()
    for k, value in enumerate((np.nan, np.inf, -np.inf, 3e38)):
        for number in range(7):
            poses[50 * k + number, number] = value
    state.body_q.assign(poses)


SCENES = (one_cell, as_large_as_the_world, a_million_to_one, far_away, in_a_line, without_numbers)


def rows_of(model, state, broad_phase, recorded=False):
    """Every array of the rows."""
    pipeline = novaphy.CollisionPipeline(model, broad_phase=broad_phase, rigid_contact_max=200_000)
    contacts = pipeline.contacts()
    if recorded:
        with nova.ScopedCapture() as capture:
            pipeline.collide(state, contacts, dt=10.0)
        capture.graph.launch()
    else:
        pipeline.collide(state, contacts, dt=10.0)
    assert not contacts.overflowed
    count = int(contacts.rigid_contact_count.numpy()[0])
    return [getattr(contacts, f"rigid_contact_{name}").numpy()[:count] for name in NAMES]


@pytest.mark.parametrize("scene", SCENES, ids=[scene.__name__ for scene in SCENES])
@pytest.mark.parametrize("seed", [1, 2])
def test_no_search_loses_a_contact(scene, seed):
    model = scene(np.random.default_rng(seed)).finalize()
    state = model.state()
    if scene is without_numbers:
        spoil(state)
    every = rows_of(model, state, "nxn")
    assert len(every[0]) > 100
    for found in (rows_of(model, state, "sap"), rows_of(model, state, "sap", recorded=True)):
        for name, mine, theirs in zip(NAMES, found, every, strict=True):
            assert mine.shape == theirs.shape, name
            assert_same_bits(mine, theirs)


def crowd():
    """A hundred spheres in one place, whose 4,950 pairs are more than a recording has room for."""
    builder = novaphy.ModelBuilder()
    for k in range(100):
        body = builder.add_body(xform=(0.001 * k, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        builder.add_shape_sphere(body, radius=0.1)
    return builder.finalize()


def rows_in_recording(model, state, contacts, pipeline):
    with nova.ScopedCapture() as capture:
        pipeline.collide(state, contacts)
    capture.graph.launch()


@pytest.mark.parametrize(
    "make",
    [
        novaphy.solvers.SolverSemiImplicit,
        novaphy.solvers.SolverFeatherstone,
        lambda model: novaphy.solvers.SolverFeatherstone(model, contact="penalty"),
    ],
    ids=["semi-implicit", "pgs", "penalty"],
)
def test_a_recorded_search_without_room_for_pairs_overflows_and_steps(make):
    model = crowd()
    state, after, expected = model.state(), model.state(), model.state()
    pipeline = novaphy.CollisionPipeline(model, broad_phase="sap", rigid_contact_max=5000)
    contacts = pipeline.contacts()
    rows_in_recording(model, state, contacts, pipeline)
    assert contacts.overflowed and contacts.rigid_contact_count.numpy()[0] == 5000 + (4950 - 1600)
    assert contacts.active_rigid_contact_count == 1600
    pairs = list(
        zip(
            *(c.numpy() for c in (contacts.rigid_contact_shape0, contacts.rigid_contact_shape1)),
            strict=True,
        )
    )
    assert pairs[:1600] == sorted((i, j) for i in range(100) for j in range(i + 1, 100))[:1600]
    assert set(pairs[1600:]) == {(-1, -1)}
    with pytest.warns(RuntimeWarning, match="8350 rigid contacts were found for 5000 slots"):
        make(model).step(state, after, None, contacts, 1e-5)
    fewer = novaphy.CollisionPipeline(model, shape_pairs_filtered=pairs[:1600]).contacts()
    novaphy.CollisionPipeline(model, shape_pairs_filtered=pairs[:1600]).collide(state, fewer)
    make(model).step(state, expected, None, fewer, 1e-5)
    assert_same_bits(after.body_qd.numpy(), expected.body_qd.numpy())


def test_an_overflow_of_pairs_leaves_no_rows_of_the_search_before():
    model = crowd()
    state = model.state()
    pipeline = novaphy.CollisionPipeline(model, broad_phase="sap", rigid_contact_max=5000)
    recorded = novaphy.CollisionPipeline(model, broad_phase="sap", rigid_contact_max=5000)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    assert contacts.active_rigid_contact_count == 4950
    rows_in_recording(model, state, contacts, recorded)
    assert contacts.active_rigid_contact_count == 1600
    assert (contacts.rigid_contact_shape0.numpy()[1600:] == -1).all()
