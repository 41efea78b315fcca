"""Particles against cylinders, cones and ellipsoids: distances, forces and exact gradients."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import diff, nova, solvers
from novaphy.testing import assert_same_bits

DT = 1 / 960
TURNED = tuple(np.float32([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9]))
SURFACE = {"ke": 1e3, "kd": 5.0, "kf": 20.0, "mu": 0.5}
SHAPES = {
    "cylinder": {"radius": 0.3, "half_height": 0.4},
    "cone": {"radius": 0.4, "half_height": 0.3},
    "ellipsoid": {"rx": 0.5, "ry": 0.3, "rz": 0.4},
}


def scene(shape, points, radius=0.02, worlds=1):
    """A turned shape of the world and particles that approach it."""
    builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
    for _ in range(worlds):
        if worlds > 1:
            builder.begin_world()
        getattr(builder, f"add_shape_{shape}")(
            -1,
            xform=(0.1, 0.2, 0.3, *TURNED),
            cfg=novaphy.ShapeConfig(**SURFACE),
            **SHAPES[shape],
        )
        for point in points:
            # Across the normal too, so that friction acts.
            builder.add_particle(point, (-0.3, 0.2, -0.4), 0.5, radius=radius)
        if worlds > 1:
            builder.end_world()
    model = builder.finalize(requires_grad=True)
    for name, value in SURFACE.items():
        setattr(model, f"soft_contact_{name}", value)
    return model


# Distances along and above the axis, a little outside and inside of each part of the surface.
NEAR = {
    "cylinder": [(0.312, 0.1), (0.292, -0.15), (0.15, 0.412), (0.11, -0.392), (0.309, 0.408)],
    "cone": [
        (0.21, 0.0067),
        (0.17, 0.03),
        (0.15, -0.312),
        (0.13, -0.29),
        (0.41, -0.31),
        (0.004, 0.311),
    ],
}


def surface_points(shape):
    """Points near the surface, which no part of the surface shares with another."""
    if shape == "ellipsoid":
        far = np.random.default_rng(3).normal(size=(12, 3))
        model = scene(shape, far / np.linalg.norm(far, axis=1, keepdims=True) * 0.8)
        pipeline = novaphy.CollisionPipeline(model, soft_contact_margin=2.0)
        contacts = pipeline.contacts()
        pipeline.collide(model.state(), contacts)
        rows = contacts.soft_contacts()
        side = np.where(np.arange(12) % 3 == 0, -0.012, 0.012)[:, None]
        return rows["body_pos"] + rows["normal"] * np.float32(side)
    x, y, z, w = (float(c) for c in TURNED)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    angles = 0.4 + 1.1 * np.arange(len(NEAR[shape]))
    local = [
        (r * np.cos(a), r * np.sin(a), h) for (r, h), a in zip(NEAR[shape], angles, strict=True)
    ]
    return np.array(local) @ turn.T + (0.1, 0.2, 0.3)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("worlds", [1, 2])
def test_static_contacts_have_the_bits_of_recorded_ones_and_exact_derivatives(shape, worlds):
    model = scene(shape, surface_points(shape), worlds=worlds)
    pipeline = novaphy.CollisionPipeline(model, soft_contact_margin=0.0)
    forward, same = diff.Trajectory(model, 60), diff.Trajectory(model, 60)
    solvers.SolverSemiImplicit(model).rollout(forward, None, None, DT, pipeline=pipeline)
    config = solvers.DiffSolverConfig(enable_static_contacts=True)
    solvers.DiffSemiImplicitSolver(model, config).rollout(same, None, None, DT)
    assert_same_bits(same.particle_q.numpy(), forward.particle_q.numpy())
    assert (np.abs(same[60].particle_qd.numpy() - same[0].particle_qd.numpy()) > 1e-2).any(1).all()

    weights = nova.tensor(
        np.cos(np.arange(3 * model.particle_count, dtype=np.float32)).reshape(-1, 3)
    )
    q, qd = (
        nova.tensor(getattr(model, f"particle_{n}").numpy(), requires_grad=True)
        for n in ("q", "qd")
    )
    f = nova.zeros(q.shape)

    def force(q, qd):
        out = diff.eval_static_particle_shape_contact_forces_generated(model, q, qd, f)
        return nova.sum(out * weights)

    found = nova.gradcheck(force, [q, qd], epsilon=3e-4, rtol=2e-2, atol=2e-1)
    assert found.ok, found.worst
    assert found.dot_product_error < 1e-4


@pytest.mark.parametrize("point", [(0, 0, 0.11), (0.1, 0, 0.11), (0, 0, 0.095), (0, -0.21, 0)])
def test_on_planes_of_symmetry_of_an_ellipsoid_the_gradient_is_that_of_the_differences(point):
    builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
    surface = novaphy.ShapeConfig(ke=500.0, kd=0.0, kf=0.0, mu=0.0)
    builder.add_shape_ellipsoid(-1, rx=0.3, ry=0.2, rz=0.1, cfg=surface)
    builder.add_particle(point, (0, 0, 0), 0.5, radius=0.03)
    model = builder.finalize()
    model.soft_contact_ke, model.soft_contact_kd = 500.0, 0.0
    model.soft_contact_kf, model.soft_contact_mu = 0.0, 0.0
    still = nova.zeros((1, 3))

    def force(at, axis, grad=False):
        q = nova.tensor(np.float32([at]), requires_grad=grad)
        weights = nova.tensor(np.eye(3, dtype=np.float32)[axis][None])
        with nova.Tape() as tape:
            out = diff.eval_static_particle_shape_contact_forces_generated(model, q, still, still)
            total = nova.sum(out * weights)
            if grad:
                tape.backward(total)
        return q.grad.numpy()[0] if grad else total.item()

    got = np.array([force(point, i, True) for i in range(3)])
    size = 1e-3
    differences = [
        [(force(point + d, i) - force(point - d, i)) / (2 * size) for d in np.eye(3) * size]
        for i in range(3)
    ]
    assert np.abs(np.diag(got)).min() > 1
    np.testing.assert_allclose(got, differences, rtol=1e-2, atol=0.2)


@pytest.mark.parametrize("shape", SHAPES)
def test_points_far_and_near_and_inside_are_where_the_shape_says(shape):
    """Of random points: the named point is on the surface, and none nearer is."""
    random = np.random.default_rng(5)
    points = np.float32(random.uniform(-0.6, 0.6, (60, 3)))
    builder = novaphy.ModelBuilder()
    getattr(builder, f"add_shape_{shape}")(-1, **SHAPES[shape])
    for point in points:
        builder.add_particle(tuple(point), (0, 0, 0), 1.0, radius=0.0)
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model, soft_contact_margin=2.0)
    contacts = pipeline.contacts()
    pipeline.collide(model.state(), contacts)
    rows = contacts.soft_contacts()
    distance = np.einsum("ij,ij->i", points - rows["body_pos"], rows["normal"])
    inside, samples = reference(shape, points)
    nearest = np.linalg.norm(points[:, None] - samples[None], axis=2).min(1)
    np.testing.assert_allclose(np.abs(distance), nearest, atol=2e-3)
    assert (np.abs(distance) <= nearest + 2e-6).all()
    assert ((distance < 0) == inside).all()


def reference(shape, x):
    """Which points are inside, and many points of the surface."""
    size = SHAPES[shape]
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, 240), np.linspace(0, 2 * np.pi, 240)))
    circle = np.stack([np.cos(v), np.sin(v)], 1)
    if shape == "ellipsoid":
        h = np.array([size["rx"], size["ry"], size["rz"]])
        sphere = np.column_stack([circle * np.sin(np.pi * u)[:, None], np.cos(np.pi * u)])
        return ((x / h) ** 2).sum(1) < 1, sphere * h
    r, half = size["radius"], size["half_height"]
    rho = np.hypot(x[:, 0], x[:, 1])
    disc = circle * (r * u)[:, None]
    base = np.column_stack([disc, np.full(len(u), -half)])
    if shape == "cylinder":
        top = np.column_stack([disc, np.full(len(u), half)])
        side = np.column_stack([r * circle, half * (2 * u - 1)])
        return (rho < r) & (np.abs(x[:, 2]) < half), np.concatenate([base, top, side])
    side = np.column_stack([disc, half - 2 * half * u])
    inside = (np.abs(x[:, 2]) < half) & (rho < r * (half - x[:, 2]) / (2 * half))
    return inside, np.concatenate([base, side])
