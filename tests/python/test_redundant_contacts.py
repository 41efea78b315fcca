"""Contacts of a face that depend on each other: adjoint and tangent are each other's transpose."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

Array = np.ndarray


def product(a: Array, b: Array) -> Array:
    """Of quaternions (x, y, z, w)."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.array([*vector, a[3] * b[3] - a[:3] @ b[:3]])


def rotated(q: Array, v: Array) -> Array:
    return v + 2 * np.cross(q[:3], np.cross(q[:3], v) + q[3] * v)


class Boxes:
    """A box that slides on the face of another one, turned in its plane and tilted a little."""

    def __init__(self, seed: int, depth: float, tilt: float) -> None:
        self.rng = rng = np.random.default_rng(seed)
        surface = novaphy.ShapeConfig(mu=0.4, restitution=0.0, gap=0.05, density=0.0)
        builder = novaphy.ModelBuilder(gravity=0.0)
        turn = rng.normal(size=4)
        turn /= np.linalg.norm(turn)
        yaw = rng.uniform(0.1, 0.6)
        by = [tilt * rng.normal(), tilt * rng.normal(), np.sin(yaw / 2), np.cos(yaw / 2)]
        by = np.array(by) / np.linalg.norm(by)
        places = (np.zeros(3), rotated(turn, np.array([0.02, 0.01, 0.17 - depth])))
        sizes = ((0.15, 0.14, 0.1), (0.1, 0.08, 0.07))
        for place, at, mass, size in zip(
            places, (turn, product(turn, by)), (1.0, 2.0), sizes, strict=True
        ):
            body = builder.add_body(
                xform=(tuple(map(float, place)), tuple(map(float, at))),
                mass=mass,
                inertia=np.diag([0.004, 0.005, 0.006]),
            )
            builder.add_shape_box(body, hx=size[0], hy=size[1], hz=size[2], cfg=surface)
        self.model = builder.finalize(requires_grad=True)
        slide = rotated(turn, np.array([0.3, 0.1, -0.5]))
        self.qd = np.array([*rng.normal(size=6) * 0.1, *slide, *rng.normal(size=3) * 0.1])
        self.weights = rng.normal(size=14), rng.normal(size=12)

    def step(self, along: tuple[Array, Array], slop: float) -> tuple[float, float, float, int]:
        """Adjoint and tangent along a direction, a bound of both, and how many contacts push."""
        from novaphy import diff, nova

        solver = novaphy.solvers.DiffFeatherstoneSolver(
            self.model, pgs_slop=slop, pgs_erp=1.0 if slop == 0.0 else 0.2, contact_gradient="code"
        )
        path = diff.Trajectory(self.model, 1)
        path[0].joint_qd.assign(self.qd.astype(np.float32))
        novaphy.eval_fk(self.model, path[0].joint_q, path[0].joint_qd, path[0])
        with nova.Tape() as tape:
            solver.rollout(path, None, None, 2e-3, pipeline=novaphy.CollisionPipeline(self.model))
            q, qd = (nova.tensor(w.astype(np.float32)) for w in self.weights)
            loss = nova.sum(diff.state_joint_q_tensor(path[1]) * q)
            loss = loss + nova.sum(diff.state_joint_qd_tensor(path[1]) * qd)
            tape.backward(loss)
            start = [diff.state_joint_q_tensor(path[0]), diff.state_joint_qd_tensor(path[0])]
            tangents = [nova.tensor(x.astype(np.float32)) for x in along]
            tangent = tape.jvp([loss], start, tangents)[0].item()
        found = [path[0].joint_q.grad.numpy(), path[0].joint_qd.grad.numpy()]
        adjoint = sum(float(g.astype(float) @ x) for g, x in zip(found, along, strict=True))
        sizes = [np.linalg.norm(g) * np.linalg.norm(x) for g, x in zip(found, along, strict=True)]
        info = solver.gradient_info()
        return adjoint, tangent, sum(sizes), info.sticking + info.sliding


@pytest.mark.parametrize("slop", [0.0, 0.005])
def test_the_tangent_of_a_box_on_a_box_is_the_transpose_of_its_adjoint(slop: float) -> None:
    """The rows have 12 equations for 6 velocities, and the rounding of single precision."""
    four = 0
    for depth, tilt in ((-0.0005, 0.0), (-0.0005, 1e-3), (0.002, 1e-3), (0.01, 0.0)):
        for seed in range(6):
            boxes = Boxes(seed, depth, tilt)
            along = (boxes.rng.normal(size=14), boxes.rng.normal(size=12))
            adjoint, tangent, size, contacts = boxes.step(along, slop)
            four += contacts == 4
            assert abs(adjoint - tangent) < 1e-4 * size, (depth, tilt, seed, adjoint, tangent)
    assert four >= 20
