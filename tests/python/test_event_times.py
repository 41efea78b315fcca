"""Times of events as tape outputs, and the fields of GradientInfo that list events.

Against closed forms, and against central differences of event-driven motions in float64.
"""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
G = 9.81
MASS, INERTIA, RADIUS = 1.0, 0.004, 0.1


def ball(
    place: tuple[float, float, float],
    planes: list[tuple[float, float, float, float]],
    of: novaphy.ShapeConfig,
    worlds: int = 1,
) -> novaphy.Model:
    one = novaphy.ModelBuilder(gravity=-G)
    body = one.add_body(xform=(place, UPRIGHT), mass=MASS, inertia=np.eye(3) * INERTIA)
    one.add_shape_sphere(body, radius=RADIUS, cfg=of)
    builder = novaphy.ModelBuilder(gravity=-G)
    builder.replicate(one, worlds)
    for plane in planes:
        builder.add_shape_plane(plane=plane, width=0, length=0, cfg=of)
    return builder.finalize(requires_grad=True)


FLOOR = (0.0, 0.0, 1.0, 0.0)


def tree(model: novaphy.Model, mode: str = "motion") -> novaphy.solvers.DiffFeatherstoneSolver:
    return novaphy.solvers.DiffFeatherstoneSolver(
        model, angular_damping=0.0, pgs_slop=0.0, pgs_erp=1.0, contact_gradient=mode
    )


class Times:
    """The times of the events of a rollout of articulations, with the slopes of one of them."""

    def __init__(
        self,
        model: novaphy.Model,
        steps: int,
        dt: float,
        qd: list[float],
        of: int,
        along: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        from novaphy import diff, nova

        solver, path = tree(model), diff.Trajectory(model, steps)
        path[0].joint_qd.assign(np.float32(qd))
        with nova.Tape() as tape:
            solver.rollout(path, None, None, dt, pipeline=novaphy.CollisionPipeline(model))
            times = diff.event_times(path)
            tape.backward(times[of])
            self.of_q = path[0].joint_q.grad.numpy()
            self.of_qd = path[0].joint_qd.grad.numpy()
            if along is not None:
                start = [diff.state_joint_q_tensor(path[0]), diff.state_joint_qd_tensor(path[0])]
                tangents = [nova.tensor(np.float32(x)) for x in along]
                self.along = tape.jvp([times[of]], start, tangents)[0].item()
        self.times = times.numpy()
        self.info = tape.gradient_info()
        assert solver.gradient_info().event_list == self.info.event_list
        assert np.allclose([row["time"] for row in self.info.event_list], self.times, atol=1e-6)


@pytest.mark.parametrize("bounce", [0, 1, 2])
def test_a_bouncing_ball_has_the_times_of_the_closed_form(bounce: int) -> None:
    """t_k = t_1 (1 + 2 e + ... + 2 e^k), t_1 = (v + sqrt(v^2 + 2 g h)) / g."""
    height, e, v = 0.3, 0.7, 0.2
    root = np.sqrt(v**2 + 2 * G * height)
    # The speed of the first impact is `root`. Each later flight lasts 2 e^k root / g.
    flights = 2 * sum(e**k for k in range(1, bounce + 1))
    exact = (v + root + flights * root) / G
    by_height, by_speed = (1 + flights) / root, (1 + (1 + flights) * v / root) / G
    of = novaphy.ShapeConfig(mu=0.0, restitution=e, density=0, gap=0.05)
    errors = []
    for rate in (960, 3840):
        model = ball((0.0, 0.0, RADIUS + height), [FLOOR], of)
        along = (np.eye(7)[2], np.eye(6)[2])
        run = Times(model, round(1.1 * rate), 1 / rate, [0, 0, v, 0, 0, 0], bounce, along)
        assert abs(run.times[bounce] - exact) < 4 / rate
        errors.append(
            max(abs(run.of_q[2] - by_height) / by_height, abs(run.of_qd[2] - by_speed) / by_speed)
        )
        ours = run.of_q[2] + run.of_qd[2]
        assert abs(run.along - ours) < 2e-4 * abs(ours)  # float32, 4,200 steps
    assert errors[0] < 0.01 * (bounce + 1) and errors[1] < max(0.5 * errors[0], 2e-3)
    row = run.info.event_list[bounce]
    assert row["kind"] == "bounce" and row["friction"] == "none" and row["world"] == 0
    assert abs(row["approach"] - e**bounce * root) < 0.01 * root
    assert 0.0 <= row["phase"] <= 1.0 and {row["shape0"], row["shape1"]} == {0, 1}


class EventDriven:
    """A ball between two planes: flights in closed form, impacts with Coulomb friction."""

    NORMALS = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
    OFFSETS = np.array([0.0, -1.0])  # n x = offset is the plane

    def __init__(self, e: float, mu: float) -> None:
        self.e, self.mu = e, mu

    def impact(self, n: np.ndarray, v: np.ndarray, w: np.ndarray) -> tuple:
        arm = -RADIUS * n
        slip = v + np.cross(w, arm)
        slip = slip - n * (n @ slip)
        push = -(1 + self.e) * MASS * (n @ v)
        stick = -slip / (1 / MASS + RADIUS**2 / INERTIA)
        size = np.linalg.norm(stick)
        friction = stick * min(1.0, self.mu * push / max(size, 1e-300))
        return v + (n * push + friction) / MASS, w + np.cross(arm, friction) / INERTIA

    def times(self, start: np.ndarray, count: int) -> np.ndarray:
        x, v, w, now, found = start[0:3], start[3:6], start[6:9], 0.0, []
        gravity = np.array([0.0, 0.0, -G])
        while len(found) < count:
            waits = []
            for n, offset in zip(self.NORMALS, self.OFFSETS, strict=True):
                gap, speed, pull = n @ x - offset - RADIUS, n @ v, n @ gravity
                gap = max(gap, 0.0) if gap > 1e-9 else 0.0
                if pull == 0.0:
                    waits.append(-gap / speed if speed < 0.0 else np.inf)
                else:
                    waits.append((-speed - np.sqrt(speed**2 - 2 * pull * gap)) / pull)
            which = int(np.argmin(waits))
            x = x + waits[which] * v + 0.5 * waits[which] ** 2 * gravity
            v = v + waits[which] * gravity
            now += waits[which]
            found.append(now)
            v, w = self.impact(self.NORMALS[which], v, w)
        return np.array(found)


@pytest.mark.parametrize(("which", "mu"), [(0, 0.4), (1, 0.4), (2, 0.4), (3, 0.1)])
def test_times_agree_with_differences_of_an_event_driven_motion(which: int, mu: float) -> None:
    """Ground and a wall, with friction that sticks (mu 0.4) or slides (0.1)."""
    motion = EventDriven(0.8, mu)
    start = np.array([0.0, 0.0, 0.5, 2.0, 0.3, -1.0, 1.0, -4.0, 2.0])
    wanted = np.array(
        [
            (motion.times(start + d, which + 1) - motion.times(start - d, which + 1))[which] / 2e-6
            for d in 1e-6 * np.eye(9)
        ]
    )
    of = novaphy.ShapeConfig(mu=mu, restitution=0.8, density=0, gap=0.05)
    model = ball(tuple(start[:3]), [FLOOR, (-1.0, 0.0, 0.0, 1.0)], of)
    times = motion.times(start, which + 1)
    run = Times(model, int(4000 * (times[which] + 0.02)), 1 / 4000, start[3:].tolist(), which)
    assert np.allclose(run.times[: which + 1], times, atol=1.5e-3)
    ours = np.concatenate([run.of_q[:3], run.of_qd])
    error = np.linalg.norm(ours - wanted) / np.linalg.norm(wanted)
    assert error < 0.01, (ours, wanted)


def test_a_penalty_touch_and_a_particle_have_times_too() -> None:
    from novaphy import diff, nova

    of = novaphy.ShapeConfig(ke=1e4, kd=0.0, kf=0.0, mu=0.0, density=0)
    model = ball((0.0, 0.0, RADIUS + 0.2), [FLOOR], of)
    config = novaphy.solvers.DiffSolverConfig(angular_damping=0.0, contact_gradient="motion")
    solver = novaphy.solvers.DiffSemiImplicitSolver(model, config)
    path = diff.Trajectory(model, 1800)
    with nova.Tape() as tape:
        solver.rollout(path, None, None, 1 / 2000, pipeline=novaphy.CollisionPipeline(model))
        times = diff.event_times(path)
        tape.backward(times[1])
    root = np.sqrt(2 * G * 0.2)
    rows = tape.gradient_info().event_list
    assert [row["kind"] for row in rows] == ["spring", "spring"] and times.shape == (2,)
    assert abs(times.numpy()[0] - root / G) < 1e-3 and rows[0]["shape1"] in (0, 1)
    # The touch lasts a little more than pi / w, w = 100 / s, which the height hardly changes.
    assert abs(times.numpy()[1] - 3 * root / G - np.pi / 100) < 5e-3
    assert abs(path[0].body_q.grad.numpy()[0, 2] - 3 / root) < 0.03 * 3 / root


def test_a_limit_has_a_time() -> None:
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder(gravity=0.0)
    slide = builder.add_link(mass=1.0, inertia=np.eye(3) * 0.01)
    joint = builder.add_joint_prismatic(
        -1, slide, axis=(1, 0, 0), limit_lower=-9, limit_upper=0, limit_ke=1e4, limit_kd=10.0
    )
    builder.add_articulation([joint])
    model = builder.finalize(requires_grad=True)
    path = diff.Trajectory(model, 200)
    path[0].joint_q.assign(np.float32([-0.1]))
    path[0].joint_qd.assign(np.float32([2.0]))
    with nova.Tape() as tape:
        tree(model).rollout(path, None, None, 1 / 1000)
        times = diff.event_times(path)
        tape.backward(times[0])
    row = tape.gradient_info().event_list[0]
    assert row["kind"] == "limit" and row["joint"] == 0 and abs(row["approach"] - 2.0) < 1e-5
    assert abs(times.item() - 0.05) < 1e-5
    assert abs(path[0].joint_q.grad.numpy()[0] + 0.5) < 1e-4
    assert abs(path[0].joint_qd.grad.numpy()[0] + 0.025) < 1e-3


def test_each_world_has_its_events() -> None:
    of = novaphy.ShapeConfig(mu=0.0, restitution=0.5, density=0, gap=0.05)
    model = ball((0.0, 0.0, RADIUS + 0.1), [FLOOR], of, worlds=3)
    qd = [0.0, 0, -1, 0, 0, 0, 0, 0, -2, 0, 0, 0, 0, 0, -3, 0, 0, 0]
    run = Times(model, 100, 1 / 1000, qd, 1)
    assert [row["world"] for row in run.info.event_list] == [2, 1, 0]
    root = np.sqrt(4 + 2 * G * 0.1)
    assert abs(run.of_q[7 + 2] - 1 / root) < 1e-2 / root and not run.of_q[:7].any()
    assert run.info.least_separation == np.inf and run.info.lost_events == 0


def test_landings_and_their_friction_are_told() -> None:
    """A disc that lands and rolls; a box that lands spinning, whose friction turns."""
    from novaphy import diff, nova

    def land(model: novaphy.Model, qd: list[float], mode: str = "motion") -> object:
        path, steps = diff.Trajectory(model, 300), 300
        path[0].joint_qd.assign(np.float32(qd))
        with nova.Tape() as tape:
            tree(model, mode).rollout(
                path, None, None, 1 / 1000, pipeline=novaphy.CollisionPipeline(model)
            )
            tape.backward(diff.state_joint_q_tensor(path[steps])[0])
        return tape.gradient_info()

    of = novaphy.ShapeConfig(mu=0.4, restitution=0.0, density=0, gap=0.05)
    disc = ball((0.0, 0.0, RADIUS + 0.1), [FLOOR], of)
    info = land(disc, [1, 0, -1, 0, 3, 0])
    assert info.landings == len(info.event_list) == 1 and info.phased == 0
    row = info.event_list[0]
    assert row["kind"] == "landing" and row["friction"] in ("slides", "sticks")
    assert info.least_approach == pytest.approx(row["approach"]) and row["approach"] > 1.0
    assert info.label == "exact of the motion"
    # The correction by the time of the event is the difference of H before and after the event.
    assert row["h_before"] is not None and abs(row["h_before"] - row["h_after"]) > 0.05
    code = land(disc, [1, 0, -1, 0, 3, 0], "code")
    assert code.event_list == [] and code.landings == 0 and code.least_approach == np.inf

    turned = 0
    for angle in np.linspace(0.1, 0.6, 6):
        builder = novaphy.ModelBuilder(gravity=-G)
        slippery = novaphy.ShapeConfig(mu=0.2, restitution=0.0, density=0, gap=0.05)
        spun = (0.0, float(np.sin(angle / 2)), 0.0, float(np.cos(angle / 2)))
        body = builder.add_body(
            xform=((0.0, 0.0, 0.4), spun), mass=1.0, inertia=np.diag([0.01, 0.018, 0.02])
        )
        builder.add_shape_box(body, hx=0.196, hy=0.1, hz=0.125, cfg=slippery)
        builder.add_ground_plane(cfg=slippery)
        info = land(builder.finalize(requires_grad=True), [0.3, 0, 0, 0, 4.0, 0])
        turned += info.phased
        if info.phased > 0:
            assert info.label != "exact of the motion" and "turns" in info.reason
            assert any(row["friction"] == "turns" for row in info.event_list)
    assert turned > 0


def test_what_is_not_there_is_refused_by_name() -> None:
    from novaphy import diff, nova

    of = novaphy.ShapeConfig(mu=0.0, restitution=0.5, density=0, gap=0.05)
    model = ball((0.0, 0.0, RADIUS + 0.1), [FLOOR], of)
    path = diff.Trajectory(model, 50)
    with pytest.raises(ValueError, match=r"diff\.event_times: expected an active Tape, got none"):
        diff.event_times(path)
    pipeline = novaphy.CollisionPipeline(model)
    with nova.Tape():
        tree(model, "code").rollout(path, None, None, 1 / 100, pipeline=pipeline)
        with pytest.raises(ValueError, match='contact_gradient="motion" on the active tape'):
            diff.event_times(path)
    with nova.Tape() as tape:
        tree(model).rollout(path, None, None, 1e-4, pipeline=pipeline)
        none = diff.event_times(path)  # the body still falls
        assert none.shape == (0,)
        tape.backward(nova.sum(none) + nova.sum(diff.state_joint_q_tensor(path[50])))
    with nova.Tape(), pytest.raises(NotImplementedError, match="got one with checkpoints"):
        diff.event_times(diff.Trajectory(model, 50, checkpoint=5))
