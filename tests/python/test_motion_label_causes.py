"""Labels of gradients of the motion: causes that take the claim away, each with its numbers."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

DT = 1e-3


class Fall:
    """A body falls on the ground or on a ball with 1 m/s, without gravity and friction."""

    def __init__(self, kind: str, restitution: float, *, on_ball: bool = False) -> None:
        of = novaphy.ShapeConfig(mu=0.0, restitution=restitution, gap=0.05, density=0.0)
        builder = novaphy.ModelBuilder(gravity=0.0)
        self.half = {"sphere": 0.1, "box": 0.05, "ellipsoid": 0.06}[kind]
        place = (0.01 * on_ball, 0.0, self.half + 0.0505)
        body = builder.add_body(xform=(place, (0, 0, 0, 1)), mass=1.0, inertia=np.eye(3) * 0.004)
        if kind == "sphere":
            builder.add_shape_sphere(body, radius=0.1, cfg=of)
        elif kind == "box":
            builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.05, cfg=of)
        else:
            builder.add_shape_ellipsoid(body, rx=0.11, ry=0.08, rz=0.06, cfg=of)
        if on_ball:
            ball = builder.add_body(
                xform=((0, 0, -0.1), (0, 0, 0, 1)), mass=1.0, inertia=np.eye(3) * 0.004
            )
            builder.add_shape_sphere(ball, radius=0.1, cfg=of)
        else:
            builder.add_ground_plane(cfg=of)
        self.model = builder.finalize(requires_grad=True)

    def run(
        self, steps: int, row: int, *, tilt: float = 0.0, lift: float = 0.0
    ) -> tuple[float, np.ndarray, novaphy.solvers.GradientInfo]:
        """Coordinate `row` at the end, and its gradient by the coordinates at the start."""
        from novaphy import diff, nova

        solver = novaphy.solvers.DiffFeatherstoneSolver(
            self.model, angular_damping=0.0, pgs_slop=0.0, pgs_erp=1.0, contact_gradient="motion"
        )
        path = diff.Trajectory(self.model, steps)
        q = self.model.joint_q.numpy().copy()
        q[2] += lift
        q[3:7] = [np.sin(tilt / 2), 0.0, 0.0, np.cos(tilt / 2)]
        path[0].joint_q.assign(q)
        speed = np.zeros(self.model.joint_dof_count, np.float32)
        speed[2] = -1.0
        path[0].joint_qd.assign(speed)
        novaphy.eval_fk(self.model, path[0].joint_q, path[0].joint_qd, path[0])
        with nova.Tape() as tape:
            solver.rollout(path, None, None, DT, pipeline=novaphy.CollisionPipeline(self.model))
            end = diff.state_joint_q_tensor(path[steps])[row]
            tape.backward(end)
            info = tape.gradient_info()
        assert info.label == solver.gradient_info().label
        return end.item(), path[0].joint_q.grad.numpy(), info


def test_a_face_that_hits_claims_no_motion() -> None:
    """Which edge is first depends on the tilt, so the spin jumps from one sign to the other."""
    fall = Fall("box", restitution=1.0)
    _, gradient, info = fall.run(90, 3)
    assert info.label == "surrogate" and info.several == 1
    assert "several points of a pair" in info.reason
    tilted = [fall.run(90, 3, tilt=tilt) for tilt in (0.02, -0.02)]
    assert abs(gradient[3] - 1.0) < 1e-3
    for sign, (end, _, _) in zip((1, -1), tilted, strict=True):
        assert sign * end > 5 * np.sin(0.01)  # a jump: five times the slope
    assert tilted[0][2].several > 0  # both corners of an edge
    # Moves that keep the face flat have the derivative of the bounce.
    assert abs(fall.run(120, 2)[1][2] + 1.0) < 1e-3


def test_a_hit_at_the_end_claims_no_motion() -> None:
    """A start that is 5 mm higher hits after the end: slope 1 there, and -1 on this side."""
    fall = Fall("sphere", restitution=1.0)  # hits after 50.5 steps
    _, gradient, info = fall.run(53, 2)
    assert abs(gradient[2] + 1.0) < 1e-4
    assert info.label == "surrogate" and info.one_sided == 1
    assert "within three steps of the end" in info.reason
    later = [fall.run(53, 2, lift=lift)[0] for lift in (0.005, 0.006)]
    assert abs((later[1] - later[0]) / 1e-3 - 1.0) < 1e-3
    _, gradient, info = fall.run(54, 2)
    assert info.label == "exact of the motion" and info.one_sided == 0
    assert abs(gradient[2] + 1.0) < 1e-4


def test_curved_shapes_that_stay_in_touch_claim_no_motion() -> None:
    """Each step of a contact that holds has the error of its own search."""
    _, _, bounce = Fall("ellipsoid", 1.0, on_ball=True).run(90, 2)
    assert bounce.label == "exact of the motion" and bounce.searched == 0
    _, _, lands = Fall("ellipsoid", 0.0, on_ball=True).run(90, 2)
    assert lands.label == "surrogate" and lands.searched >= 2
    assert "normal a search finds" in lands.reason
    _, _, ground = Fall("ellipsoid", 0.0).run(90, 2)
    assert ground.label == "exact of the motion" and ground.searched == 0
