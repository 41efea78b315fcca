"""Labels of gradients of the motion: random bounces that claim the motion agree with it.

The motion: flights in closed form and touches by Runge-Kutta, in float64, without a step of the
engine.
"""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

TIME = 0.6


class Bounce:
    """A particle or a ball that falls on a tilted plane through the origin, with friction."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.is_ball = bool(seed % 2)
        self.mu, self.kd = rng.choice([0.0, 0.4, 0.8]), rng.choice([0.0, 0.0, 5.0, 40.0])
        self.ke, angle = 10 ** rng.uniform(3, 5), rng.choice([0.04, 0.1, 0.2, 0.4])
        self.radius, self.mass = 0.1, 1.0
        self.inertia = 0.004 if self.is_ball else np.inf
        self.steps = int(TIME * np.sqrt(self.ke) / angle)
        self.dt = TIME / self.steps
        self.kf = rng.choice([0.05, 0.2, 1.5]) / self.dt * (0.285 if self.is_ball else 1.0)
        if not self.is_ball:
            self.kf = min(self.kf, self.mass / self.dt)
        normal = np.array([*rng.normal(size=2) * 0.2, 1.0])
        self.normal = normal / np.linalg.norm(normal)
        self.gravity = np.array([0.0, 0.0, -9.81])
        place = self.normal * (self.radius + rng.uniform(0.02, 0.15))
        speed = rng.normal(size=3) * (0.8, 0.8, 0.2) - self.normal * rng.uniform(0.8, 2.0)
        spin = rng.normal(size=3) * 2 * self.is_ball
        self.start = np.array([place, speed, spin])
        self.weights = rng.normal(size=3)

    def rates(self, x: np.ndarray, touches: bool) -> np.ndarray:
        if not touches:
            return np.array([x[1], self.gravity, 0 * x[2]])
        n, arm = self.normal, -self.radius * self.normal * self.is_ball
        gap, u = n @ x[0] - self.radius, x[1] + np.cross(x[2], arm)
        closing, slip = min(n @ u, 0.0), u - n * (n @ u)
        cone = -self.mu * (self.ke * gap + (self.kd * closing if self.is_ball else 0.0))
        friction = min(self.kf, max(cone, 0.0) / max(np.linalg.norm(slip), 1e-12))
        force = -(n * (self.ke * gap + self.kd * closing) + slip * friction)
        return np.array(
            [x[1], force / self.mass + self.gravity, np.cross(arm, force) / self.inertia]
        )

    def moved(self, x: np.ndarray, time: float, touches: bool) -> np.ndarray:
        a = self.rates(x, touches)
        b = self.rates(x + time / 2 * a, touches)
        c = self.rates(x + time / 2 * b, touches)
        d = self.rates(x + time * c, touches)
        return x + time / 6 * (a + 2 * b + 2 * c + d)

    def loss_of_motion(self, x: np.ndarray) -> float:
        left, touches, longest = TIME, False, 0.08 / np.sqrt(self.ke)
        while left > 1e-12:
            time = left
            if not touches:
                fall, speed = self.normal @ self.gravity, self.normal @ x[1]
                gap = max(self.normal @ x[0] - self.radius, 0.0)
                hit = (-speed - np.sqrt(speed**2 - 2 * fall * gap)) / fall
                time, begins = min(left, hit), hit < left
                x, touches = self.moved(x, time, False), begins
            else:
                time = min(longest, left)
                then = self.moved(x, time, True)
                if self.normal @ then[0] > self.radius:
                    low, high = 0.0, time
                    for _ in range(40):
                        middle = 0.5 * (low + high)
                        out = self.normal @ self.moved(x, middle, True)[0] > self.radius
                        low, high = (low, middle) if out else (middle, high)
                    time, touches = high, False
                    then = self.moved(x, time, True)
                x = then
            left -= time
        return float(self.weights @ x[0])

    def difference(self, along: np.ndarray) -> float:
        values = [self.loss_of_motion(self.start + by * along) for by in (1e-6, -1e-6)]
        return (values[0] - values[1]) / 2e-6

    def gradient(self) -> tuple[np.ndarray, novaphy.solvers.GradientInfo]:
        from novaphy import diff, nova

        builder = novaphy.ModelBuilder()
        of = novaphy.ShapeConfig(ke=self.ke, kd=self.kd, kf=self.kf, mu=self.mu, density=0)
        if self.is_ball:
            place = (tuple(self.start[0]), (0.0, 0.0, 0.0, 1.0))
            body = builder.add_body(xform=place, mass=self.mass, inertia=np.eye(3) * self.inertia)
            builder.add_shape_sphere(body, radius=self.radius, cfg=of)
        else:
            builder.add_particle(*map(tuple, self.start[:2]), self.mass, radius=self.radius)
        builder.add_shape_plane(plane=(*self.normal, 0.0), width=0, length=0, cfg=of)
        model = builder.finalize(requires_grad=True)
        model.soft_contact_ke, model.soft_contact_kd = self.ke, self.kd
        model.soft_contact_kf, model.soft_contact_mu = self.kf, self.mu
        config = novaphy.solvers.DiffSolverConfig(angular_damping=0.0, contact_gradient="motion")
        solver = novaphy.solvers.DiffSemiImplicitSolver(model, config)
        path, pipeline = diff.Trajectory(model, self.steps), novaphy.CollisionPipeline(model)
        if self.is_ball:
            path[0].body_qd.assign(np.float32([[*self.start[1], *self.start[2]]]))
        with nova.Tape() as tape:
            solver.rollout(path, None, None, self.dt, pipeline=pipeline)
            end = path[self.steps]
            if self.is_ball:
                weights = np.float32([[*self.weights, 0, 0, 0, 0]])
                tape.backward(nova.sum(diff.state_body_q_tensor(end) * nova.tensor(weights)))
            else:
                weights = np.float32([self.weights])
                tape.backward(nova.sum(diff.state_particle_q_tensor(end) * nova.tensor(weights)))
        if self.is_ball:
            of_q, of_qd = path[0].body_q.grad.numpy(), path[0].body_qd.grad.numpy()
            found = [of_q[0, :3], of_qd[0, :3], of_qd[0, 3:]]
        else:
            of_q, of_qd = path[0].particle_q.grad.numpy(), path[0].particle_qd.grad.numpy()
            found = [of_q[0], of_qd[0], np.zeros(3)]
        return np.float64(found), solver.gradient_info()


CLAIMED = {0, 1, 8, 11, 12, 15}  # 12 of the 16 are within 5 %


@pytest.mark.parametrize("seed", range(16))
def test_a_bounce_that_claims_the_motion_has_its_gradient(seed: int) -> None:
    bounce = Bounce(seed)
    gradient, info = bounce.gradient()
    assert info.events > 0
    assert info.label == ("exact of the motion" if seed in CLAIMED else "surrogate")
    if seed not in CLAIMED:
        return
    rng = np.random.default_rng(seed)
    along = rng.normal(size=(2, 3, 3)) * [[[1.0], [1.0], [10.0 * bounce.is_ball]]]
    ours = np.array([np.sum(gradient * a) for a in along])
    wanted = np.array([bounce.difference(a) for a in along])
    assert np.linalg.norm(ours - wanted) < 0.05 * np.linalg.norm(wanted), (ours, wanted)
