"""Pairs of shapes that a pipeline is given."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy


def heap():
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    for k in range(4):
        body = builder.add_body(xform=((0.1 * k, 0.05 * k, 0.12), (0, 0, 0, 1)))
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
        builder.add_shape_sphere(body, radius=0.12)
    builder.add_shape_collision_filter_pair(1, 3)
    return builder.finalize()


def rows_of(model, **options):
    pipeline = novaphy.CollisionPipeline(model, **options)
    contacts = pipeline.contacts()
    pipeline.collide(model.state(), contacts)
    return contacts.rigid_contacts()


def test_the_rows_are_those_of_the_given_pairs():
    model = heap()
    every = rows_of(model)
    pairs = model.shape_contact_pairs.numpy()
    chosen = pairs[::3]
    given = rows_of(model, shape_pairs_filtered=chosen)
    wanted = {tuple(p) for p in chosen.tolist()}
    inside = [tuple(sorted((int(r["shape0"]), int(r["shape1"])))) in wanted for r in every]
    assert 0 < len(given) < len(every)
    assert given.tobytes() == every[np.array(inside)].tobytes()
    assert rows_of(model, shape_pairs_filtered=pairs).tobytes() == every.tobytes()
    assert len(rows_of(model, shape_pairs_filtered=[])) == 0


def test_order_and_repetition_of_the_pairs_do_not_matter():
    model = heap()
    pipeline = novaphy.CollisionPipeline(model, shape_pairs_filtered=[(5, 1), (0, 1), (1, 5)])
    assert pipeline.shape_pairs_filtered == [(0, 1), (1, 5)]
    assert novaphy.CollisionPipeline(model).shape_pairs_filtered is None
    rows = rows_of(model, shape_pairs_filtered=[(5, 1), (0, 1), (1, 5)])
    assert len(rows) > 0
    assert rows.tobytes() == rows_of(model, shape_pairs_filtered=[(0, 1), (1, 5)]).tobytes()


def test_a_pair_that_is_filtered_out_meets_when_it_is_given():
    rows = rows_of(heap(), shape_pairs_filtered=[(1, 3)])
    assert len(rows) > 0 and {(int(r["shape0"]), int(r["shape1"])) for r in rows} == {(1, 3)}


@pytest.mark.parametrize(
    ("pairs", "options", "error", "message"),
    [
        (
            [(0, 9)],
            {},
            IndexError,
            r"shape_pairs_filtered\[0\]: expected shapes from 0 to 8, got 9",
        ),
        ([(0, 1), (3, 4)], {}, ValueError, r"filtered\[1\]: expected shapes of two bodies.*body 1"),
        ([(2, 2)], {}, ValueError, "expected shapes of two bodies"),
        ([(0, 1, 2)], {}, ValueError, "expected rows of two shapes, got one of 3"),
        ([(0, 1)], {"broad_phase": "sap"}, ValueError, 'none with the broad phase "sap"'),
        ([(0, 1)], {"broad_phase": "nxn"}, ValueError, 'none with the broad phase "nxn"'),
    ],
)
def test_bad_pairs_are_refused(pairs, options, error, message):
    with pytest.raises(error, match=message):
        novaphy.CollisionPipeline(heap(), shape_pairs_filtered=pairs, **options)


def test_steps_of_a_large_world_list_no_pairs():
    count = 24_000  # more than 2^28 pairs
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    for k in range(count):
        at = (0.5 * (k % 200), 0.5 * (k // 200), 0.1)
        builder.add_shape_sphere(builder.add_body(xform=(at, (0, 0, 0, 1))), radius=0.1)
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model, broad_phase="sap", rigid_contact_max=count)
    contacts, ends = pipeline.contacts(), []
    pipeline.collide(model.state(), contacts)
    assert contacts.rigid_contact_count.numpy()[0] == count
    for make in (novaphy.solvers.SolverSemiImplicit, novaphy.solvers.DiffSemiImplicitSolver):
        before, after = model.state(), model.state()
        make(model).step(before, after, None, contacts, 1e-3)
        ends.append(after.body_q.numpy())
    assert ends[0].tobytes() == ends[1].tobytes()
