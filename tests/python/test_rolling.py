"""What rolls on an infinite plane keeps its speed, in both solvers, without damping."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import solvers

HALF = np.sqrt(0.5)
SOLVERS = {"SolverSemiImplicit": 1 / 960, "SolverFeatherstone": 1 / 240}


def rolls(name, body_of, q, twist, seconds=2.0):
    """The trajectory of body_q and body_qd of one body on a plane."""
    builder = novaphy.ModelBuilder()
    builder.default_shape_cfg = novaphy.ShapeConfig(kf=100.0)  # kf=1000 makes light bodies shake
    builder.add_ground_plane()
    body = builder.add_body(xform=q)
    body_of(builder, body)
    builder.body_qd[body] = twist
    builder.joint_qd = list(twist)
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model)
    contacts, state, after = pipeline.contacts(), model.state(), model.state()
    solver, dt = getattr(solvers, name)(model, angular_damping=0.0), SOLVERS[name]
    q, qd = [], []
    for _ in range(int(seconds / dt)):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, dt)
        state, after = after, state
        q.append(state.body_q.numpy()[0])
        qd.append(state.body_qd.numpy()[0])
    return np.array(q), np.array(qd), model


@pytest.mark.filterwarnings("ignore:SolverSemiImplicit")
@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize(("radius", "half"), [(0.1, 0.1), (0.1, 0.02), (0.3, 0.05), (0.05, 0.3)])
def test_a_cylinder_keeps_its_speed(name, radius, half):
    v = 1.3
    q, qd, _ = rolls(
        name,
        lambda b, k: b.add_shape_cylinder(k, radius=radius, half_height=half),
        ((0, 0, radius), (HALF, 0, 0, HALF)),
        (v, 0, 0, 0, v / radius, 0),
    )
    assert qd[-1, 0] == pytest.approx(v, rel=5e-3)
    assert np.abs(qd[:, 1]).max() < 2e-3 and np.abs(q[:, 1]).max() < 1e-3


@pytest.mark.filterwarnings("ignore:SolverSemiImplicit")
@pytest.mark.parametrize("name", SOLVERS)
def test_a_cone_rolls_about_its_apex_with_its_energy(name):
    """On its side: the apex stays, and the kinetic energy too."""
    radius, half = 0.1, 0.15
    side = np.arctan2(radius, 2 * half)  # angle between the generator and the axis
    # The axis points along -x, the apex is at the origin, the generator on the ground.
    axis = np.array([-np.cos(side), 0, -np.sin(side)])
    up = np.cross([0, 1, 0], axis)
    frame = np.column_stack([up, [0, 1, 0], axis])
    w = np.sqrt(1 + np.trace(frame)) / 2
    turn = np.array(
        [
            frame[2, 1] - frame[1, 2],
            frame[0, 2] - frame[2, 0],
            frame[1, 0] - frame[0, 1],
        ]
    ) / (4 * w)
    origin = -axis * half
    spin = np.array([2.0, 0, 0])  # about the generator, which is at rest
    com = origin - axis * half / 2
    q, qd, model = rolls(
        name,
        lambda b, k: b.add_shape_cone(k, radius=radius, half_height=half),
        (tuple(origin), (*turn, w)),
        (*np.cross(spin, com), *spin),
        seconds=1.5,
    )
    mass, inertia = model.body_mass.numpy()[0], model.body_inertia.numpy()[0].astype(float)

    def energy(pose, twist):
        x, y, z, s = pose[3:]
        turned = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * s), 2 * (x * z + y * s)],
                [2 * (x * y + z * s), 1 - 2 * (x * x + z * z), 2 * (y * z - x * s)],
                [2 * (x * z - y * s), 2 * (y * z + x * s), 1 - 2 * (x * x + y * y)],
            ]
        )
        w_body = turned.T @ twist[3:]
        return 0.5 * mass * twist[:3] @ twist[:3] + 0.5 * w_body @ inertia @ w_body

    start = energy(q[0], qd[0])
    assert energy(q[-1], qd[-1]) == pytest.approx(start, rel=0.03)
    assert np.abs(q[:, 2] - origin[2]).max() < 1e-2, "it stays on its side"
