"""Gradients of the motion: the times of impacts move with the state.

Against closed forms, and against differences over steps that are large beside the way of a step.
"""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
G = 9.81


def surface(restitution: float, mu: float = 0.0) -> novaphy.ShapeConfig:
    return novaphy.ShapeConfig(mu=mu, restitution=restitution, density=500.0, gap=0.05)


def finish(builder: novaphy.ModelBuilder) -> novaphy.Model:
    return builder.finalize(requires_grad=True)


def ball(height: float, restitution: float, gravity: float = G, mu: float = 0.0) -> novaphy.Model:
    """A ball of 10 cm above the ground."""
    builder = novaphy.ModelBuilder(gravity=-gravity)
    of = surface(restitution, mu)
    body = builder.add_body(xform=((0.0, 0.0, 0.1 + height), UPRIGHT))
    builder.add_shape_sphere(body, radius=0.1, cfg=of)
    builder.add_ground_plane(cfg=of)
    return finish(builder)


def box(restitution: float, mu: float) -> novaphy.Model:
    builder = novaphy.ModelBuilder(gravity=-G)
    of = surface(restitution, mu)
    body = builder.add_body(xform=((0.0, 0.0, 0.5), (0.2, 0.3, 0.1, 0.927)))
    builder.add_shape_box(body, hx=0.1, hy=0.07, hz=0.05, cfg=of)
    builder.add_ground_plane(cfg=of)
    return finish(builder)


def make_solver(model: novaphy.Model, mode: str) -> novaphy.solvers.DiffFeatherstoneSolver:
    return novaphy.solvers.DiffFeatherstoneSolver(
        model, angular_damping=0.0, pgs_slop=0.0, pgs_erp=1.0, contact_gradient=mode
    )


class Run:
    """A rollout from (q, qd), the loss w . q at its end, and its gradients."""

    def __init__(
        self,
        model: novaphy.Model,
        mode: str,
        steps: int,
        dt: float,
        qd: np.ndarray,
        weights: np.ndarray,
        *,
        q: np.ndarray | None = None,
        controls: list[novaphy.Control] | None = None,
        checkpoint: int | None = None,
        along: tuple[np.ndarray, np.ndarray] | None = None,
        gradient: bool = True,
    ) -> None:
        from novaphy import diff, nova

        solver = make_solver(model, mode)
        path = diff.Trajectory(model, steps, checkpoint=checkpoint)
        if q is not None:
            path[0].joint_q.assign(np.float32(q))
        path[0].joint_qd.assign(np.float32(qd))
        novaphy.eval_fk(model, path[0].joint_q, path[0].joint_qd, path[0])
        how = {"pipeline": novaphy.CollisionPipeline(model)}
        if not gradient:
            solver.rollout(path, controls, None, dt, **how)
        else:
            with nova.Tape() as tape:
                solver.rollout(path, controls, None, dt, **how)
                end = diff.state_joint_q_tensor(path[steps])
                loss = nova.sum(end * nova.tensor(np.float32(weights)))
                tape.backward(loss)
                self.of_q = path[0].joint_q.grad.numpy()
                self.of_qd = path[0].joint_qd.grad.numpy()
                if along is not None:
                    start = [
                        diff.state_joint_q_tensor(path[0]),
                        diff.state_joint_qd_tensor(path[0]),
                    ]
                    tangents = [nova.tensor(np.float32(x)) for x in along]
                    self.along = tape.jvp([loss], start, tangents)[0].item()
            self.info = solver.gradient_info()
        self.path, self.start = path, path[0].joint_q.numpy()
        self.end = path[steps].joint_q.numpy()
        self.loss = float(np.float64(weights) @ np.float64(self.end))


HEIGHT = np.float32([0, 0, 1, 0, 0, 0, 0])


@pytest.mark.parametrize("dt", [1 / 480, 1 / 4800])
def test_a_bounce_turns_the_sign(dt: float) -> None:
    steps, speed = round(0.2 / dt), np.float32([0, 0, -1, 0, 0, 0])
    model = ball(0.05, restitution=1.0, gravity=0.0)
    code = Run(model, "code", steps, dt, speed, HEIGHT)
    motion = Run(model, "motion", steps, dt, speed, HEIGHT)
    assert np.array_equal(code.end, motion.end)
    assert abs(code.of_q[2] - 1.0) < 1e-5  # the derivative of the steps
    assert abs(motion.of_q[2] + 1.0) < 1e-5 and abs(motion.of_qd[2] + 0.2) < 1e-5
    assert motion.info.label == "exact of the motion" and motion.info.events == 2
    assert "move with the state" in motion.info.reason
    kept = Run(model, "motion", steps, dt, speed, HEIGHT, checkpoint=10)
    assert np.array_equal(kept.of_q, motion.of_q) and np.array_equal(kept.of_qd, motion.of_qd)


def test_a_bounce_in_gravity_converges_to_the_closed_form() -> None:
    """Falls h, rises for t = T - sqrt(2 h / g) from e sqrt(2 g h)."""
    height, e, time = 0.4, 0.7, 0.6
    fall, speed = np.sqrt(2 * height / G), np.sqrt(2 * G * height)
    rise = time - fall
    exact = e * G / speed * rise - e + G * rise / speed
    errors = []
    for rate in (960, 3840):
        run = Run(ball(height, e), "motion", round(time * rate), 1 / rate, np.zeros(6), HEIGHT)
        errors.append(abs(run.of_q[2] - exact))
    assert errors[0] < 0.02 and errors[1] < 0.3 * errors[0] + 1e-3


def difference(
    model: novaphy.Model, time: float, qd: np.ndarray, weights: np.ndarray, of: str, i: int
) -> float:
    """Over moves that are large beside the way of a step, the mean of some."""
    slopes = []
    for step in {"q": (4e-3, 6e-3, 8e-3), "qd": (2e-2, 3e-2)}[of]:
        losses = []
        for sign in (1.0, -1.0):
            q, v = model.joint_q.numpy().copy(), np.float32(qd).copy()
            (q if of == "q" else v)[i] += sign * step
            run = Run(model, "code", round(time * 4000), 1 / 4000, v, weights, q=q, gradient=False)
            losses.append(run.loss)
        slopes.append((losses[0] - losses[1]) / (2 * step))
    return float(np.mean(slopes))


@pytest.mark.parametrize(
    ("make", "time", "qd", "tolerance"),
    [
        (lambda: ball(0.4, 0.0, mu=0.4), 0.5, [1, 0, -1, 0, 3, 0], 0.03),  # lands, then rolls
        (lambda: box(0.3, 0.4), 0.6, [1, 0.3, 0, 2, 1, 3], 0.05),  # five impacts of corners
    ],
    ids=["disc", "box"],
)
def test_impacts_with_friction_have_the_gradient_of_differences(make, time, qd, tolerance) -> None:
    model, qd = make(), np.float32(qd)
    weights = np.float32([1, 0.5, 0, 0, 0, 0, 0])
    motion = Run(model, "motion", round(time * 4000), 1 / 4000, qd, weights)
    code = Run(model, "code", round(time * 4000), 1 / 4000, qd, weights)
    wanted = difference(model, time, qd, weights, "q", 2)
    assert abs(motion.of_q[2] - wanted) < tolerance * abs(wanted), (motion.of_q[2], wanted)
    assert abs(code.of_q[2] - wanted) > 10 * abs(motion.of_q[2] - wanted)
    wanted = difference(model, time, qd, weights, "qd", 0)
    assert abs(motion.of_qd[0] - wanted) < tolerance * abs(wanted)


def test_the_tangent_is_the_transpose_of_the_adjoint() -> None:
    rng = np.random.default_rng(3)
    weights = rng.normal(size=7)
    along = (rng.normal(size=7), rng.normal(size=6))
    qd = np.float32([1, 0.3, 0, 2, 1, 3])
    for restitution, time in ((0.3, 0.6), (0.0, 0.45)):
        run = Run(
            box(restitution, 0.4), "motion", round(time * 1000), 1e-3, qd, weights, along=along
        )
        adjoint = run.of_q @ along[0] + run.of_qd @ along[1]
        size = np.linalg.norm(run.of_q) + np.linalg.norm(run.of_qd)
        assert abs(run.along - adjoint) < 1e-3 * size, (run.along, adjoint)


def test_a_ball_that_meets_two_walls_at_once_turns_both_signs() -> None:
    """Two pairs in one step: each has its own time."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    of = surface(1.0)
    body = builder.add_body(xform=((0.15, 0.0, 0.15), UPRIGHT))
    builder.add_shape_sphere(body, radius=0.1, cfg=of)
    builder.add_ground_plane(cfg=of)
    builder.add_shape_plane(plane=(1.0, 0.0, 0.0, 0.0), width=0.0, length=0.0, cfg=of)
    model = finish(builder)
    speed = np.float32([-1, 0, -1, 0, 0, 0])
    for i in (0, 2):
        weights = np.zeros(7)
        weights[i] = 1.0
        run = Run(model, "motion", 96, 1 / 480, speed, weights, along=(np.eye(7)[i], np.zeros(6)))
        assert abs(run.of_q[i] + 1.0) < 1e-4 and abs(run.of_q[2 - i]) < 1e-4
        assert abs(run.along + 1.0) < 1e-4
        assert run.info.label == "surrogate" and "several pairs hit" in run.info.reason


def test_the_control_of_an_event_is_that_of_its_step() -> None:
    """A push that jumps where the ball hits: its clock does not move with the impact."""
    model, steps, dt = ball(0.05, restitution=1.0, gravity=0.0), 96, 1 / 480
    mass = float(model.body_mass.numpy()[0])
    hit = 24  # 0.05 m at 1 m/s
    speed = np.float32([0, 0, -1, 0, 0, 0])
    controls = []
    for t in range(steps):
        control = model.control()
        control.joint_f.assign(np.float32([0, 0, mass * (4.0 if t > hit else 0.0), 0, 0, 0]))
        controls.append(control)
    run = Run(model, "motion", steps, dt, speed, HEIGHT, controls=controls)
    assert abs(run.of_q[2] + 1.0) < 1e-3, run.of_q[2]


@pytest.mark.parametrize("damping", [0.0, 20.0])
@pytest.mark.parametrize("rate", [480, 3840])
def test_a_slide_leaves_its_limit_with_minus_its_restitution(damping: float, rate: int) -> None:
    """A spring turns a shift of the start to -(speed out / speed in), whatever the phase."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    slide = builder.add_link(mass=1.0, inertia=np.eye(3) * 0.01)
    joint = builder.add_joint_prismatic(
        -1, slide, axis=(1, 0, 0), limit_lower=-9, limit_upper=0, limit_ke=1e4, limit_kd=damping
    )
    builder.add_articulation([joint])
    model = finish(builder)
    worst = 0.0
    for phase in (0.0, 0.25, 0.5, 0.75):
        run = Run(
            model,
            "motion",
            round(0.25 * rate),
            1 / rate,
            np.ones(1),
            np.ones(1),
            q=np.full(1, -0.1 + phase / rate),
            along=(np.ones(1), np.zeros(1)),
        )
        out = run.path[round(0.25 * rate)].joint_qd.numpy()[0]
        assert out < -0.5
        assert abs(run.of_q[0] - out) < 2e-3 and abs(run.along - run.of_q[0]) < 1e-4
        code = Run(model, "code", round(0.25 * rate), 1 / rate, np.ones(1), np.ones(1), q=run.start)
        worst = max(worst, abs(code.of_q[0] - out))
    assert worst > 0.15


def test_what_is_not_there_is_refused_by_name() -> None:
    from novaphy import diff, nova

    model = ball(0.1, 0.5)
    with pytest.raises(ValueError, match='expected "auto", "code" or "motion", got "x"'):
        make_solver(model, "x")
    with pytest.raises(NotImplementedError, match="not supported with compliant_contacts"):
        novaphy.solvers.DiffFeatherstoneSolver(
            model, contact_gradient="motion", compliant_contacts=True
        )
    solver, path = make_solver(model, "motion"), diff.Trajectory(model, 2)
    pipeline = novaphy.CollisionPipeline(model)
    with (
        pytest.raises(NotImplementedError, match="not supported inside a ScopedCapture"),
        nova.ScopedCapture(),
        nova.Tape(),
    ):
        solver.rollout(path, None, None, 1e-3, pipeline=pipeline)


@pytest.mark.parametrize("speed", [0.0, 0.4])
def test_hits_on_a_kinematic_body_move_with_it(speed: float) -> None:
    """Two balls hit one moving box: z = (1 + e) (z_box + v_box T) - e (z + v T) + constant."""
    from novaphy import diff, nova

    restitution, steps, dt = 0.6, 120, 1 / 240
    of = novaphy.ShapeConfig(mu=0.0, restitution=restitution, density=0, gap=0.05)
    builder = novaphy.ModelBuilder(gravity=0.0)
    inertia = np.eye(3) * 0.01
    box = builder.add_body(mass=1.0, inertia=inertia, is_kinematic=True)
    builder.add_shape_box(box, hx=0.5, hy=0.5, hz=0.1, cfg=of)
    for place in ((-0.2, 0.0, 0.35), (0.2, 0.1, 0.3)):
        body = builder.add_body(xform=(place, (0, 0, 0, 1)), mass=1.0, inertia=inertia)
        builder.add_shape_sphere(body, radius=0.1, cfg=of)
    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, angular_damping=0.0, pgs_slop=0.0, pgs_erp=1.0, contact_gradient="motion"
    )
    path = diff.Trajectory(model, steps)
    rates = np.zeros((3, 6), np.float32)
    rates[:, 2] = [speed, -1.0, -1.0]
    path[0].joint_qd.assign(rates.ravel())
    along = np.linspace(-1.0, 1.0, 18).astype(np.float32)
    with nova.Tape() as tape:
        solver.rollout(path, None, None, dt, pipeline=novaphy.CollisionPipeline(model))
        loss = nova.sum(diff.state_joint_q_tensor(path[steps]).reshape(3, 7)[1:3, 2])
        tape.backward(loss)
        tangent = tape.jvp(
            [loss], [diff.state_joint_qd_tensor(path[0])], [nova.tensor(along)]
        )[0].item()  # fmt: skip
        info = tape.gradient_info()
    by_q = path[0].joint_q.grad.numpy().reshape(3, 7)[:, 2]
    by_qd = path[0].joint_qd.grad.numpy()
    end = steps * dt
    np.testing.assert_allclose(by_q, [2 * (1 + restitution), -restitution, -restitution], rtol=1e-4)
    np.testing.assert_allclose(by_qd.reshape(3, 6)[:, 2], end * by_q, rtol=1e-4)
    np.testing.assert_allclose(tangent, along @ by_qd, rtol=1e-4)
    assert info.label == "exact of the motion" and len(info.event_list) == 2
