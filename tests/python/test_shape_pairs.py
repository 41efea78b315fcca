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


def balls(gaps, fixed=()):
    """Balls of radius 0.1 m in a row; `fixed` ones hang on the world."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    x = 0.0
    for k, gap in enumerate([*gaps, 0.0]):
        pose = ((x, 0, 0), (0, 0, 0, 1))
        if k in fixed:
            body = builder.add_link(xform=pose)
            builder.add_articulation([builder.add_joint_fixed(-1, body, parent_xform=pose)])
        else:
            body = builder.add_body(xform=pose)
        builder.add_shape_sphere(body, radius=0.1)
        x += 0.2 + gap
    return builder.finalize()


@pytest.mark.parametrize("broad_phase", ["explicit", "nxn", "sap"])
def test_pairs_that_overlap_at_the_start_are_named_once_or_left_out(broad_phase):
    model = balls([-0.01, 1e-5, -0.05, -1e-5, -0.02], fixed=(4, 5))
    with pytest.warns(RuntimeWarning) as found:
        pipeline = novaphy.CollisionPipeline(model, broad_phase=broad_phase)
        contacts = pipeline.contacts()
        for _ in range(3):
            pipeline.collide(model.state(), contacts)
    (warning,) = [str(w.message) for w in found]
    assert warning == (
        "CollisionPipeline: 2 pairs of shapes overlap at the start: "
        '"shape_2" and "shape_3" by 0.05 m, "shape_0" and "shape_1" by 0.01 m; '
        "filter_overlaps leaves them out"
    )
    assert [(i, j) for i, j, _ in pipeline.overlaps] == [(2, 3), (0, 1)]
    np.testing.assert_allclose([d for *_, d in pipeline.overlaps], [0.05, 0.01], rtol=1e-5)
    every = contacts.rigid_contacts()
    apart = novaphy.CollisionPipeline(model, broad_phase=broad_phase, filter_overlaps=True)
    contacts = apart.contacts()
    for _ in range(2):
        apart.collide(model.state(), contacts)
        rows = contacts.rigid_contacts()
        met = [tuple(sorted((r["shape0"], r["shape1"]))) for r in every]
        kept = np.array([pair not in ((0, 1), (2, 3)) for pair in met])
        assert rows.tobytes() == every[kept].tobytes() and 0 < len(rows) < len(every)


def test_the_search_for_overlaps_stands_on_no_tape():
    nova = pytest.importorskip("novaphy.nova")
    model = balls([-0.01])
    model.body_q.requires_grad = model.shape_transform.requires_grad = True
    with nova.Tape() as tape:
        pipeline = novaphy.CollisionPipeline(model, filter_overlaps=True)
    assert len(pipeline.overlaps) == 1 and len(tape) == 0


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
