"""Contacts as data: bodies, positions, penetrations, forces, and what begins and ends."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import solvers

SIDE, DEPTH = 0.2, 0.003


def boxes(z: list[float], **options) -> novaphy.Model:
    builder = novaphy.ModelBuilder()
    builder.rigid_gap = 0.005
    builder.add_ground_plane()
    for k, height in enumerate(z):
        body = builder.add_body(xform=((0.5 * k, 0, height), (0, 0, 0, 1)))
        builder.add_shape_box(body, hx=SIDE / 2, hy=SIDE / 2, hz=SIDE / 2)
    return builder.finalize(**options)


def found(model, state):
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    return contacts


def test_bodies_positions_and_penetrations_of_boxes_on_the_ground():
    model = boxes([SIDE / 2 - DEPTH, SIDE / 2 + 0.002, 1.0])
    state = model.state()
    contacts = found(model, state)
    rows = contacts.rigid_contacts(model, state)
    assert len(contacts) == len(rows) == 8 and contacts.active_soft_contact_count == 0
    assert set(rows["body0"]) == {-1} and set(rows["body1"]) == {0, 1}
    on_first = rows[rows["body1"] == 0]
    np.testing.assert_allclose(on_first["penetration"], DEPTH, atol=1e-7)
    np.testing.assert_allclose(rows["penetration"][rows["body1"] == 1], -0.002, atol=1e-7)
    assert sorted(map(tuple, np.round(on_first["position"][:, :2], 6))) == [
        (x, y) for x in (-0.1, 0.1) for y in (-0.1, 0.1)
    ]
    np.testing.assert_allclose(on_first["position"][:, 2], -DEPTH / 2, atol=1e-7)
    for name in contacts.rigid_contacts().dtype.names:
        np.testing.assert_array_equal(rows[name], contacts.rigid_contacts()[name])
    assert f"rigid: 8 of {contacts.rigid_contact_max}" in repr(contacts)


def test_the_penetration_of_spheres_is_along_the_normal_with_margins():
    builder = novaphy.ModelBuilder()
    cfg = novaphy.ShapeConfig(margin=0.01)
    for x in (0.0, 0.27):
        body = builder.add_body(xform=((x, 0.0, 0.3), (0, 0, 0.6, 0.8)))
        builder.add_shape_sphere(body, xform=((0.02, 0, 0), (0, 0, 0, 1)), radius=0.15, cfg=cfg)
    model = builder.finalize()
    state = model.state()
    (row,) = found(model, state).rigid_contacts(model, state)
    assert (row["body0"], row["body1"]) == (0, 1)
    assert row["penetration"] == pytest.approx(0.3 + 0.02 - 0.27, abs=1e-6)
    center = 0.27 / 2 + 0.02 * 0.28, 0.02 * 0.96, 0.3
    np.testing.assert_allclose(row["position"], center, atol=1e-6)


def test_the_force_carries_the_weight():
    model = boxes([SIDE / 2])
    solver = solvers.SolverFeatherstone(model) if model.articulation_count else None
    solver = solver or solvers.SolverSemiImplicit(model)
    state, pipeline = model.state(), novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    for _ in range(2000):
        state.clear_forces()
        pipeline.collide(state, contacts)
        solver.step(state, state, None, contacts, 1e-3)
    rows = contacts.rigid_contacts(model, state)
    weight = 9.81 * model.body_mass.numpy()[0]
    assert rows["force"][rows["body1"] == 0].sum(axis=0)[2] == pytest.approx(weight, rel=1e-3)


def test_contacts_begin_and_end():
    model = boxes([SIDE / 2, 0.5])
    state = model.state()
    pipeline = novaphy.CollisionPipeline(model)
    now = pipeline.contacts()

    def at(*heights):
        before = now.clone()
        poses = state.body_q.numpy()
        poses[:, 2] = heights
        state.body_q.assign(poses)
        pipeline.collide(state, now)
        return before

    at(SIDE / 2, 0.5)
    before = at(SIDE / 2 - 0.001, SIDE / 2)  # the second one lands
    begun = now.match(before)
    assert begun.dtype == np.int32 and len(begun) == 8
    rows = now.rigid_contacts(model, state)
    assert set(rows["body1"][begun < 0]) == {1} and (begun < 0).sum() == 4
    for row, earlier in zip(rows[begun >= 0], begun[begun >= 0], strict=True):
        assert row["point_id"] == before.rigid_contacts()[earlier]["point_id"]
    assert (before.match(now) >= 0).all()
    before = at(0.5, SIDE / 2)  # the first one leaves
    assert (before.match(now) < 0).sum() == 4 and (now.match(before) >= 0).all()
    assert now.match(now).tolist() == [0, 1, 2, 3]
    assert now.match(now, pairs=True).tolist() == [0, 0, 0, 0]
    assert len(pipeline.contacts().match(now)) == 0
    at(0.5, 0.6)
    assert len(now) == 0 and not now


def test_a_corner_that_leaves_is_no_end_of_the_pair():
    model = boxes([SIDE / 2])
    state = model.state()
    pipeline = novaphy.CollisionPipeline(model)
    flat, tilted = pipeline.contacts(), pipeline.contacts()
    pipeline.collide(state, flat)
    angle = 0.2
    state.body_q.assign([[0, 0, 0.112, 0, np.sin(angle / 2), 0, np.cos(angle / 2)]])
    pipeline.collide(state, tilted)
    assert 0 < len(tilted) < len(flat)
    assert (flat.match(tilted) < 0).sum() == len(flat) - len(tilted)
    assert (flat.match(tilted, pairs=True) >= 0).all()


def test_what_is_refused():
    model, other = boxes([SIDE / 2]), boxes([SIDE / 2])
    contacts = found(model, model.state())
    with pytest.raises(ValueError, match="expected a model and a state, or none of them"):
        contacts.rigid_contacts(model)
    with pytest.raises(ValueError, match="of the model, got one of another"):
        contacts.rigid_contacts(model, other.state())
    with pytest.raises(ValueError, match="contacts of the same model"):
        contacts.match(found(other, other.state()))
