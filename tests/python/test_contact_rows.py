"""Rows of contacts: more than there is room for, those of a step, and bad ones."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import novaphy
from novaphy import solvers

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def block(side, edge=0.02):
    """Cubes in layers, 5 % of an edge apart, everything at its defaults."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    for k in range(side**3):
        x, y, z = k % side, k // side % side, k // side**2
        place = (1.05 * edge * x, 1.05 * edge * y, edge * (z + 0.5))
        body = builder.add_body(xform=(place, UPRIGHT))
        builder.add_shape_box(body, hx=edge / 2, hy=edge / 2, hz=edge / 2)
    return builder.finalize()


def go(model, solver, steps, dt, **pipeline):
    pipeline = novaphy.CollisionPipeline(model, **pipeline)
    contacts, state, after = pipeline.contacts(), model.state(), model.state()
    for _ in range(steps):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, dt)
        state, after = after, state
    return state, contacts


def said_of(run):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        result = run()
    return result, [str(w.message) for w in said]


def test_a_block_of_small_cubes_stands_and_one_word_tells_of_rows_without_a_slot():
    """Each cube is within the gap of all others: 11,700 rows for 8,064 slots."""
    model = block(5)
    solver = solvers.SolverFeatherstone(model)
    (state, contacts), said = said_of(lambda: go(model, solver, 60, 1 / 240))
    wanted, slots = int(contacts.rigid_contact_count.numpy()[0]), contacts.rigid_contact_max
    assert wanted > slots
    assert len([text for text in said if f"for {slots} slots" in text]) == 1
    assert any("SolverFeatherstone.step: contacts: " in text for text in said)
    q, start = state.body_q.numpy(), model.body_q.numpy()
    np.testing.assert_allclose(q[:, :3], start[:, :3], atol=1e-3)


def test_a_rollout_that_searches_itself_finds_only_what_may_touch():
    """So the block needs fewer slots than there are, and nobody has to say anything."""
    model = block(5)
    pipeline = novaphy.CollisionPipeline(model)
    trajectory = novaphy.diff.Trajectory(model, 30)
    solver = solvers.SolverFeatherstone(model)
    _, said = said_of(lambda: solver.rollout(trajectory, None, None, 1 / 240, pipeline=pipeline))
    assert not [text for text in said if "slots" in text]
    q, start = trajectory[30].body_q.numpy(), model.body_q.numpy()
    np.testing.assert_allclose(q[:, :3], start[:, :3], atol=1e-3)


@pytest.mark.parametrize("name", ["SolverSemiImplicit", "SolverFeatherstone"])
def test_a_rollout_that_searches_itself_has_the_bits_of_steps_on_all_rows(name):
    """Rows that cannot touch do nothing, whether they are left out of the search or the solve."""
    builder = novaphy.ModelBuilder()
    cfg = novaphy.ShapeConfig(ke=2e4, kd=100.0, kf=50.0, mu=0.5)
    builder.add_ground_plane(cfg=cfg)
    random = np.random.default_rng(5)
    for k in range(24):
        place = (0.25 * (k % 4), 0.25 * (k // 4 % 3), 0.12 + 0.24 * (k // 12))
        q = random.normal(size=4)
        body = builder.add_body(xform=(place, tuple(q / np.linalg.norm(q))))
        if k % 3 == 0:
            builder.add_shape_box(body, hx=0.1, hy=0.08, hz=0.06, cfg=cfg)
        elif k % 3 == 1:
            builder.add_shape_sphere(body, radius=0.1, cfg=cfg)
        else:
            builder.add_shape_capsule(body, radius=0.05, half_height=0.05, cfg=cfg)
        twist = tuple(random.normal(size=6) * (2, 2, 2, 10, 10, 10))
        builder.body_qd[body] = twist
        builder.joint_qd[6 * k : 6 * k + 6] = twist
    model = builder.finalize()
    make = lambda: getattr(solvers, name)(model)  # noqa: E731
    state, contacts = go(model, make(), 200, 1 / 480, rigid_contact_max=20000)
    assert not contacts.overflowed
    trajectory = novaphy.diff.Trajectory(model, 200)
    pipeline = novaphy.CollisionPipeline(model, rigid_contact_max=20000)
    make().rollout(trajectory, None, None, 1 / 480, pipeline=pipeline)
    for array in ("body_q", "body_qd"):
        np.testing.assert_array_equal(
            getattr(trajectory[200], array).numpy(), getattr(state, array).numpy()
        )


def one_box():
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    body = builder.add_body(xform=((0, 0, 0.1), UPRIGHT))
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    builder.add_particle((0, 0, 0.01), (0, 0, 0), 0.1, radius=0.05)
    return builder.finalize()


@pytest.mark.parametrize(
    "kind", [{"rigid_contact_max": 2}, {"soft_contact_max": 0}], ids=["rigid", "soft"]
)
def test_every_solver_warns_once_of_contacts_without_a_slot(kind):
    model = one_box()
    made = solvers.SolverSemiImplicit(model)
    _, said = said_of(lambda: go(model, made, 5, 1 / 960, **kind))
    name = next(iter(kind))
    assert [text for text in said if name in text] == said[:1]
    assert (
        "SolverSemiImplicit.step: contacts: " in said[0] and " contacts were found for " in said[0]
    )
    config = solvers.DiffSolverConfig(strict=False)
    made = solvers.DiffSemiImplicitSolver(model, config)
    _, said = said_of(lambda: go(model, made, 5, 1 / 960, **kind))
    assert len([text for text in said if name in text]) == 1


def test_bad_rows_and_poses_are_named():
    model = one_box()
    pipeline = novaphy.CollisionPipeline(model)
    contacts, state, after = pipeline.contacts(), model.state(), model.state()
    pipeline.collide(state, contacts)
    solver = solvers.SolverSemiImplicit(model)
    step = lambda dt=1e-3: solver.step(state, after, None, contacts, dt)  # noqa: E731
    normals = contacts.rigid_contact_normal.numpy()
    for bad in (0.0, 2.0):
        edited = normals.copy()
        edited[2] *= bad
        contacts.rigid_contact_normal = edited
        with pytest.raises(ValueError, match=r"rigid_contact_normal\[2\]: expected a vector of le"):
            step()
    contacts.rigid_contact_normal = normals
    step()
    poses = state.body_q.numpy()
    state.body_q = poses * np.float32([1, 1, 1, 2, 2, 2, 2])
    message = r"state.body_q\[0\]: expected a quaternion of length 1, got \(0, 0, 0, 2\)"
    with pytest.raises(ValueError, match=message):
        step()
    with pytest.raises(ValueError, match=message):
        pipeline.collide(state, contacts)
    state.body_q = poses
    with pytest.raises(ValueError, match="dt: expected a finite number > 0 and at most 1000 s"):
        step(1e9)
    scale = model.shape_scale.numpy()
    model.shape_scale = scale * np.float32([1, 0, 1])
    with pytest.raises(ValueError, match=r"model.shape_scale\[1\].*hy.*> 0"):
        step()
    model.shape_scale = scale
    step()


def test_collide_for_a_step_leaves_out_what_cannot_touch_in_it():
    model = block(3)
    pipeline = novaphy.CollisionPipeline(model)
    contacts, state = pipeline.contacts(), model.state()
    counts = []
    for dt in (None, 1 / 240, 1 / 4800):
        pipeline.collide(state, contacts, dt=dt)
        counts.append(int(contacts.rigid_contact_count.numpy()[0]))
    assert counts[0] > counts[1] > counts[2] >= 9 * 4 + 2 * 9 * 4  # rows of touching shapes alone
    with pytest.raises(ValueError, match="dt: expected a finite number > 0"):
        pipeline.collide(state, contacts, dt=0.0)
