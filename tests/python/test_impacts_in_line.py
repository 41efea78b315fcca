"""Gradients of the motion through impacts in line, of all pairs of shapes, against closed forms.

Two bodies without forces between them but the impact, or one body and a plane. The derivatives are
those along the line, for any restitution, phase and step.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
OCTAHEDRON = np.float32(np.concatenate([np.eye(3), -np.eye(3)]) * 0.1)
# Each shape is 20 cm high.
SHAPES = {
    "sphere": {"radius": 0.1},
    "capsule": {"radius": 0.06, "half_height": 0.04},
    "cylinder": {"radius": 0.08, "half_height": 0.1},
    "ellipsoid": {"rx": 0.15, "ry": 0.12, "rz": 0.1},
    "box": {"hx": 0.08, "hy": 0.09, "hz": 0.1},
    "convex_hull": {"vertices": OCTAHEDRON},
}
SPEED, TIME = 1.0, 0.4


def add(builder: novaphy.ModelBuilder, shape: str, z: float, of: novaphy.ShapeConfig) -> None:
    body = builder.add_body(xform=((0, 0, z), UPRIGHT), mass=1.0, inertia=np.eye(3) * 0.01)
    getattr(builder, f"add_shape_{shape}")(body, cfg=of, **SHAPES[shape])


def slopes(model: novaphy.Model, read: int, rates: list[float], dt: float) -> np.ndarray:
    """The derivative of the height of the body `read` at the end by all heights at the start."""
    from novaphy import diff, nova

    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, angular_damping=0.0, pgs_slop=0.0, pgs_erp=1.0, contact_gradient="motion"
    )
    steps = round(TIME / dt)
    path = diff.Trajectory(model, steps)
    qd = np.zeros((len(rates), 6), np.float32)
    qd[:, 2] = rates
    path[0].joint_qd.assign(qd.ravel())
    with nova.Tape() as tape:
        solver.rollout(path, None, None, dt, pipeline=novaphy.CollisionPipeline(model))
        tape.backward(diff.state_joint_q_tensor(path[steps])[7 * read + 2])
    return path[0].joint_q.grad.numpy().reshape(-1, 7)[:, 2]


@pytest.mark.parametrize(("rate", "restitution"), [(120, 0.7), (1000, 1.0)])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_body_comes_back_from_a_plane(shape: str, rate: int, restitution: float) -> None:
    of = novaphy.ShapeConfig(mu=0.0, restitution=restitution, density=0, gap=0.05)
    for height in (0.3, 0.3031):
        builder = novaphy.ModelBuilder(gravity=0.0)
        add(builder, shape, height, of)
        builder.add_ground_plane(cfg=of)
        found = slopes(builder.finalize(requires_grad=True), 0, [-SPEED], 1 / rate)
        assert abs(found[0] + restitution) < 0.01


@pytest.mark.parametrize(("rate", "restitution"), [(120, 0.7), (1000, 0.3)])
@pytest.mark.parametrize("pair", itertools.combinations_with_replacement(SHAPES, 2))
def test_a_body_passes_its_start_on(pair: tuple[str, str], rate: int, restitution: float) -> None:
    """Of equal masses: dz_B/dz_A = (1 + e) / 2, dz_B/dz_B = (1 - e) / 2."""
    of = novaphy.ShapeConfig(mu=0.0, restitution=restitution, density=0, gap=0.05)
    builder = novaphy.ModelBuilder(gravity=0.0)
    add(builder, pair[0], 0.0, of)
    add(builder, pair[1], 0.4021, of)
    found = slopes(builder.finalize(requires_grad=True), 1, [SPEED, 0.0], 1 / rate)
    wanted = np.array([1 + restitution, 1 - restitution]) / 2
    assert np.abs(found - wanted).max() < 0.01
