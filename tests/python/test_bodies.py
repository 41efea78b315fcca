"""Rigid bodies from Python: building, lists, copies, errors."""

import copy
import pickle

import numpy as np
import pytest

import novaphy
from novaphy import ModelBuilder
from novaphy.io import Mesh


def die() -> ModelBuilder:
    builder = ModelBuilder()
    builder.add_ground_plane()
    body = builder.add_body(xform=((0, 0, 0.6), (0, 0, 0, 1)), mass=4.0, label="die")
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    builder.body_qd[body] = (1, 0, 0, 1, 5, 2)
    return builder


def test_pickles_carry_the_pairs_of_shapes_or_how_to_list_them() -> None:
    model = die().finalize()
    again = pickle.loads(pickle.dumps(model))
    assert again.shape_contact_pairs.numpy().tolist() == [[0, 1]]
    again.shape_contact_pairs = np.int32([[1, 0]])
    edited = pickle.loads(pickle.dumps(again))
    assert edited.shape_contact_pairs.numpy().tolist() == [[1, 0]]
    assert edited.shape_contact_pair_count == 1


def test_the_model_and_the_state_hold_the_body() -> None:
    model = die().finalize()
    assert model.body_count == 1
    assert model.body_label == ["die"]
    assert model.body_shapes == {-1: [0], 0: [1]}
    np.testing.assert_allclose(model.body_mass.numpy(), [12.0], rtol=1e-6)
    np.testing.assert_allclose(model.body_inertia.numpy()[0], np.eye(3) * 0.16 / 3, rtol=1e-6)
    np.testing.assert_allclose(model.body_inv_inertia.numpy()[0], np.eye(3) * 18.75, rtol=1e-6)
    assert model.shape_contact_pairs.numpy().tolist() == [[0, 1]]
    state = model.state()
    np.testing.assert_array_equal(state.body_q.numpy(), np.float32([[0, 0, 0.6, 0, 0, 0, 1]]))
    np.testing.assert_array_equal(state.body_qd.numpy(), np.float32([[1, 0, 0, 1, 5, 2]]))


def test_lists_of_the_builder_are_written_before_finalize() -> None:
    builder = die()
    assert builder.body_q[0] == pytest.approx((0, 0, 0.6, 0, 0, 0, 1))
    builder.body_q = [(1, 2, 3, 0, 0, 0, 1)]
    builder.body_qd[0:1] = [np.arange(6)]
    model = builder.finalize()
    assert model.body_q.numpy()[0].tolist() == [1, 2, 3, 0, 0, 0, 1]
    assert model.body_qd.numpy()[0].tolist() == [0, 1, 2, 3, 4, 5]
    with pytest.raises(ValueError, match="body_qd"):
        builder.body_qd[0] = (1, 2, 3)


@pytest.mark.parametrize("copied", [lambda m: pickle.loads(pickle.dumps(m)), copy.deepcopy])
def test_copies_hold_the_bodies(copied) -> None:
    model = die().finalize()
    model.body_inv_inertia = np.zeros((1, 3, 3), np.float32)  # as assigned, also in the copy
    other = copied(model)
    assert other.body_label == ["die"]
    for name in ("body_q", "body_qd", "body_mass", "body_inertia", "body_inv_inertia"):
        np.testing.assert_array_equal(getattr(other, name).numpy(), getattr(model, name).numpy())
    state = copied(model.state())
    np.testing.assert_array_equal(state.body_qd.numpy(), model.body_qd.numpy())


def test_the_inverse_inertia_follows_the_inertia() -> None:
    model = die().finalize()
    model.body_inertia = (np.eye(3) * 0.5)[None].astype(np.float32)
    np.testing.assert_array_equal(model.body_inv_inertia.numpy()[0], np.eye(3) * 2)


def test_bad_bodies_raise_and_name_the_argument() -> None:
    builder = ModelBuilder()
    builder.balance_inertia = False
    with pytest.raises(ValueError, match="inertia: expected 3"):
        builder.add_body(mass=1.0, inertia=np.eye(2))
    with pytest.raises(ValueError, match="positive definite"):
        builder.add_body(mass=1.0, inertia=-np.eye(3))
    with pytest.raises(ValueError, match="sum of the other two"):
        builder.add_body(mass=1.0, inertia=np.diag([1.0, 0.1, 0.1]))
    with pytest.raises(ValueError, match="xform.q"):
        builder.add_body(xform=((0, 0, 0), (0, 0, 0, 2)))
    with pytest.raises(IndexError, match="body"):
        builder.add_shape_box(0)
    builder.add_body()
    with pytest.raises(ValueError, match=r"body_mass\[0\]"):
        builder.finalize()
    assert builder.body_count == 1


def test_worlds_carry_bodies() -> None:
    scene = ModelBuilder()
    scene.replicate(die(), 3, spacing=(2, 0, 0))
    model = scene.finalize()
    assert model.body_world.numpy().tolist() == [0, 1, 2]
    assert model.shape_contact_pairs.numpy().tolist() == [[0, 1], [2, 3], [4, 5]]
    assert model.body_q.numpy()[:, 0].tolist() == [-2, 0, 2]


def test_a_captured_search_follows_the_state() -> None:
    nova = pytest.importorskip("novaphy.nova")
    builder = die()
    other = builder.add_body(xform=((0.05, 0, 0.79), (0, 0, 0, 1)))
    builder.add_shape_sphere(other, radius=0.1)
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model)
    swept = novaphy.CollisionPipeline(model, broad_phase="sap")
    contacts, expected, same = pipeline.contacts(), pipeline.contacts(), pipeline.contacts()
    state = model.state()
    with nova.ScopedCapture() as capture:
        pipeline.collide(state, contacts)
        swept.collide(state, same)
    for height in (0.1, 0.6, 5.0):
        poses = model.body_q.numpy()
        poses[:, 2] += height - 0.6
        state.body_q = poses
        capture.graph.launch()
        pipeline.collide(state, expected)
        np.testing.assert_array_equal(contacts.rigid_contacts(), expected.rigid_contacts())
        np.testing.assert_array_equal(same.rigid_contacts(), expected.rigid_contacts())
        assert (height > 0.5) == (contacts.rigid_contact_count[0] == 1)
    model.shape_flags = np.zeros(3, np.int32)
    with pytest.raises(novaphy.Error):
        capture.graph.launch()


def test_a_recorded_sweep_refuses_meshes_by_name() -> None:
    nova = pytest.importorskip("novaphy.nova")
    builder = die()
    corners = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    builder.add_shape_mesh(-1, mesh=Mesh(corners, np.int32([[0, 1, 2]])))
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model, broad_phase="sap")
    contacts, state = pipeline.contacts(), model.state()
    pipeline.collide(state, contacts)
    with pytest.raises(NotImplementedError, match='shapes 1 and 2 .*"sap" finds pairs of meshes'):
        with nova.ScopedCapture():
            pipeline.collide(state, contacts)


def test_every_broad_phase_gives_the_same_motion() -> None:
    ends = []
    for broad_phase in ("explicit", "nxn", "sap"):
        scene = novaphy.ModelBuilder()
        scene.replicate(die(), 3, spacing=(1, 0, 0))
        model = scene.finalize()
        pipeline = novaphy.CollisionPipeline(model, broad_phase=broad_phase)
        contacts = pipeline.contacts()
        solver = novaphy.solvers.SolverSemiImplicit(model)
        state, after = model.state(), model.state()
        for _ in range(480):
            pipeline.collide(state, contacts)
            solver.step(state, after, None, contacts, 1 / 960)
            state, after = after, state
        ends.append(state.body_q.numpy())
    np.testing.assert_array_equal(ends[0], ends[1])
    np.testing.assert_array_equal(ends[0], ends[2])
