"""Gradients of the motion through penalty contacts: the times of touches move with the state.

Against closed forms, and against differences over moves that are large beside the way of a step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
G = 9.81


def surface(ke: float, kd: float = 0.0, kf: float = 0.0, mu: float = 0.0) -> novaphy.ShapeConfig:
    return novaphy.ShapeConfig(ke=ke, kd=kd, kf=kf, mu=mu, density=0)


def add_ball(
    builder: novaphy.ModelBuilder, at: tuple[float, float, float], of: novaphy.ShapeConfig
) -> int:
    """A ball of 1 kg and 10 cm."""
    body = builder.add_body(xform=(at, UPRIGHT), mass=1.0, inertia=np.eye(3) * 0.004)
    builder.add_shape_sphere(body, radius=0.1, cfg=of)
    return body


def balls(
    *at: tuple[float, float, float],
    of: novaphy.ShapeConfig,
    gravity: float = 0.0,
    planes: tuple[tuple[float, float, float, float], ...] = (),
) -> novaphy.Model:
    builder = novaphy.ModelBuilder(gravity=-gravity)
    for place in at:
        add_ball(builder, place, of)
    for plane in planes:
        builder.add_shape_plane(plane=plane, width=0, length=0, cfg=of)
    return builder.finalize(requires_grad=True)


FLOOR = ((0.0, 0.0, 1.0, 0.0),)


class Run:
    """A rollout with the loss w . body_q at its end (or at the state `read`), and its gradients."""

    def __init__(
        self,
        model: novaphy.Model,
        mode: str,
        steps: int,
        dt: float,
        qd: Any,
        weights: Any,
        *,
        q: np.ndarray | None = None,
        read: int | None = None,
        forces: np.ndarray | None = None,
        checkpoint: int | None = None,
        along: tuple[np.ndarray, np.ndarray] | None = None,
        gradient: bool = True,
    ) -> None:
        from novaphy import diff, nova

        config = novaphy.solvers.DiffSolverConfig(angular_damping=0.0, contact_gradient=mode)
        solver = novaphy.solvers.DiffSemiImplicitSolver(model, config)
        path = diff.Trajectory(model, steps, checkpoint=checkpoint)
        if q is not None:
            path[0].body_q.assign(np.float32(q))
        path[0].body_qd.assign(np.float32(qd))
        pipeline = novaphy.CollisionPipeline(model)
        read = steps if read is None else read
        more: dict[str, Any] = {}
        if forces is not None:
            more["body_forces"] = self.forces = nova.tensor(np.float32(forces))
            self.forces.requires_grad = True
        if not gradient:
            solver.rollout(path, None, None, dt, pipeline=pipeline, **more)
        else:
            with nova.Tape() as tape:
                solver.rollout(path, None, None, dt, pipeline=pipeline, **more)
                end = diff.state_body_q_tensor(path[read])
                loss = nova.sum(end * nova.tensor(np.float32(weights)))
                tape.backward(loss)
                self.of_q = path[0].body_q.grad.numpy()
                self.of_qd = path[0].body_qd.grad.numpy()
                if along is not None:
                    start = [
                        diff.state_body_q_tensor(path[0]),
                        diff.state_body_qd_tensor(path[0]),
                    ]
                    tangents = [nova.tensor(np.float32(x)) for x in along]
                    self.along = tape.jvp([loss], start, tangents)[0].item()
                self.info = tape.gradient_info()
                assert self.info.label == solver.gradient_info().label
        self.end, self.end_qd = path[steps].body_q.numpy(), path[steps].body_qd.numpy()
        self.loss = float((np.float64(weights) * np.float64(path[read].body_q.numpy())).sum())


def weight(bodies: int, body: int, axis: int) -> np.ndarray:
    weights = np.zeros((bodies, 7))
    weights[body, axis] = 1.0
    return weights


def difference(
    model: novaphy.Model,
    time: float,
    qd: Any,
    weights: np.ndarray,
    along: tuple[np.ndarray, np.ndarray],
    *,
    rate: int = 4000,
    moves: tuple[float, ...] = (4e-3, 6e-3),
) -> float:
    """The mean slope over some moves of the start, which are large beside the way of a step."""
    slopes = []
    for move in moves:
        losses = []
        for sign in (1.0, -1.0):
            q = model.body_q.numpy() + sign * move * along[0]
            v = np.float64(qd) + sign * move * along[1]
            run = Run(model, "code", round(time * rate), 1 / rate, v, weights, q=q, gradient=False)
            losses.append(run.loss)
        slopes.append((losses[0] - losses[1]) / (2 * move))
    return float(np.mean(slopes))


@pytest.mark.parametrize("speed", [1.9, 1.95, 2.0, 2.05, 2.1])
def test_two_balls_pass_the_start_on_at_every_phase(speed: float) -> None:
    """Six steps in contact, hw 0.5. x_B(T) = x_B + v T - gap: dx_B/dx_A = 1, dx_B/dx_B = 0."""
    model = balls((0, 0, 0), (0.6, 0, 0), of=surface(2e4))
    qd = [[speed, 0, 0, 0, 0, 0], [0] * 6]
    code = Run(model, "code", 400, 1 / 400, qd, weight(2, 1, 0))
    motion = Run(model, "motion", 400, 1 / 400, qd, weight(2, 1, 0))
    assert np.array_equal(code.end, motion.end) and np.array_equal(code.end_qd, motion.end_qd)
    assert code.of_q[0, 0] > 5.0  # the derivative of the steps
    assert abs(motion.of_q[0, 0] - 1.0) < 0.012 and abs(motion.of_q[1, 0]) < 0.012
    assert abs(motion.of_qd[0, 0] - 1.0) < 0.025
    assert motion.info.label == "exact of the motion" and motion.info.events == 2
    assert motion.info.ramp_steps == 2 and motion.info.one_sided == 0
    assert "begin and end move with the state" in motion.info.reason


CURVED = {
    "ellipsoid": {"rx": 0.1, "ry": 0.15, "rz": 0.07},
    "cylinder": {"radius": 0.1, "half_height": 0.2},
    "cone": {
        "radius": 0.15,
        "half_height": 0.1,
        "xform": ((0, 0, 0), (0, -(0.5**0.5), 0, 0.5**0.5)),
    },
    "sphere": {"radius": 0.1},
}


def curved(*shapes: str, at: tuple[float, float, float], of: novaphy.ShapeConfig) -> novaphy.Model:
    """A shape at the origin, and one at a place; a cone looks back along x."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    for shape, place in zip(shapes, ((0.0, 0.0, 0.0), at), strict=True):
        body = builder.add_body(xform=(place, UPRIGHT), mass=1.0, inertia=np.eye(3) * 0.01)
        getattr(builder, f"add_shape_{shape}")(body, cfg=of, **CURVED[shape])
    return builder.finalize(requires_grad=True)


@pytest.mark.parametrize(
    "shapes",
    [
        ("ellipsoid", "ellipsoid"),
        ("cylinder", "sphere"),
        ("ellipsoid", "cone"),
        ("cylinder", "cone"),
    ],
)
def test_two_curved_bodies_pass_the_start_on(shapes: tuple[str, str]) -> None:
    for speed in (1.9, 2.05):
        model = curved(*shapes, at=(0.6, 0, 0), of=surface(2e4))
        qd = [[speed, 0, 0, 0, 0, 0], [0] * 6]
        run = Run(model, "motion", 400, 1 / 400, qd, weight(2, 1, 0))
        assert abs(run.of_q[0, 0] - 1.0) < 0.012 and abs(run.of_q[1, 0]) < 0.012
        assert run.info.frozen_steps == 0 and run.info.events == 2


@pytest.mark.parametrize("kd", [0.0, 60.0])
def test_a_ball_on_a_plane_comes_back_with_its_restitution(kd: float) -> None:
    """A shift of the start comes back as -e of it, with e = speed after / before of the steps."""
    for height in (0.3, 0.30005, 0.3001, 0.30015):
        model = balls((0, 0, height), of=surface(1e5, kd), planes=FLOOR)
        run = Run(model, "motion", 960, 1 / 2400, [[0, 0, -1, 0, 0, 0]], weight(1, 0, 2))
        e = run.end_qd[0, 2]
        assert 0.7 < e < 1.02 and (kd == 0.0 or e < 0.9)
        assert abs(run.of_q[0, 2] + e) < 2e-3
        assert run.info.label == "exact of the motion"


BALL_SCENES = {
    "damped": (1e4, 30.0, 0.0, 0.0, [0.0, 0, -0.5, 0, 0, 0]),
    "sliding": (1e4, 30.0, 100.0, 0.4, [1.5, 0.2, -0.5, 0, 0, 0]),
    "spinning": (1e4, 0.0, 20.0, 0.4, [1.5, 0.2, -0.5, 0, 3, 0]),
}


@pytest.mark.parametrize("name", BALL_SCENES)
def test_a_ball_in_gravity_agrees_with_differences(name: str) -> None:
    ke, kd, kf, mu, qd = BALL_SCENES[name]
    model = balls((0, 0, 0.3), of=surface(ke, kd, kf, mu), gravity=G, planes=FLOOR)
    weights = weight(1, 0, 2) + 0.5 * weight(1, 0, 0)
    motion = Run(model, "motion", 400, 1 / 1000, [qd], weights)
    assert motion.info.label == "exact of the motion"
    for axis, of in ((2, "q"), (2, "qd"), (4, "qd")):
        along = (np.zeros((1, 7)), np.zeros((1, 6)))
        along[of == "qd"][0, axis] = 1.0
        ours = (motion.of_q if of == "q" else motion.of_qd)[0, axis]
        moves = (5e-3,) if of == "q" else (2e-2,)
        assert (
            abs(ours - difference(model, 0.4, [qd], weights, along, rate=8000, moves=moves)) < 0.06
        )


@pytest.mark.parametrize(
    "shapes", [("sphere", "sphere"), ("ellipsoid", "sphere"), ("cylinder", "ellipsoid")]
)
def test_an_oblique_hit_turns_the_normal_and_jvp_is_the_transpose(shapes: tuple[str, str]) -> None:
    model = curved(*shapes, at=(0.5, 0.08, 0.03), of=surface(2e4))
    qd = [[1.5, 0, 0, 0, 0, 0], [0] * 6]
    weights = weight(2, 1, 1) + 0.5 * weight(2, 0, 0)
    random = np.random.default_rng(3)
    along = (np.zeros((2, 7)), random.normal(size=(2, 6)))
    along[0][:, :3] = random.normal(size=(2, 3))
    run = Run(model, "motion", 600, 1 / 1000, qd, weights, along=along)
    ours = float((run.of_q * along[0]).sum() + (run.of_qd * along[1]).sum())
    assert abs(run.along - ours) < 1e-4 * max(1.0, abs(ours))
    wide = difference(model, 0.6, qd, weights, along, moves=(3e-3,))
    assert abs(ours - wide) < 0.03 * max(1.0, abs(wide))


@pytest.mark.parametrize(
    ("mu", "time", "rate", "label"),
    [
        (0.0, 0.26, 4000, "exact of the motion"),
        (0.3, 0.28, 1000, "surrogate"),  # the body slips, then sticks
    ],
)
def test_a_box_on_its_corner_agrees_with_differences(
    mu: float, time: float, rate: int, label: str
) -> None:
    builder = novaphy.ModelBuilder(gravity=-G)
    of = surface(1e4, 20.0, 100.0, mu)
    turn = (0.2, 0.3, 0.1, 0.927)
    inertia = np.diag([0.005, 0.006, 0.007])
    body = builder.add_body(xform=((0.0, 0.0, 0.4), turn), mass=1.0, inertia=inertia)
    builder.add_shape_box(body, hx=0.1, hy=0.07, hz=0.05, cfg=of)
    builder.add_ground_plane(cfg=of)
    model = builder.finalize(requires_grad=True)
    qd = [[0.5, 0, -1, 1, 0.5, 0]]
    weights = weight(1, 0, 2) + weight(1, 0, 0)
    motion = Run(model, "motion", round(time * rate), 1 / rate, qd, weights)
    code = Run(model, "code", round(time * rate), 1 / rate, qd, weights)
    assert motion.info.label == label
    along = (weight(1, 0, 2), np.zeros((1, 6)))
    wide = difference(model, time, qd, weights, along)
    assert abs(motion.of_q[0, 2] - wide) < 0.03
    assert abs(code.of_q[0, 2] - wide) > 0.06


def test_checkpoints_give_the_same_bits() -> None:
    model = balls((0, 0, 0), (0.6, 0, 0), of=surface(2e4, 5.0))
    qd = [[2.0, 0.01, 0, 0, 0, 0], [0] * 6]
    whole = Run(model, "motion", 200, 1 / 400, qd, weight(2, 1, 0))
    kept = Run(model, "motion", 200, 1 / 400, qd, weight(2, 1, 0), checkpoint=7)
    assert np.array_equal(whole.of_q, kept.of_q) and np.array_equal(whole.of_qd, kept.of_qd)
    # Without kept states the stiffness of contacts is not known.
    assert all(whole.info[k] == kept.info[k] for k in kept.info if k != "steps_per_contact")


def test_a_loss_within_the_touch_is_that_of_the_motion() -> None:
    """z in the middle of a bounce: the spring has moved sin(w t), whatever phase the steps have."""
    model = balls((0, 0, 0.3), of=surface(1e4), planes=FLOOR)
    qd = [[0, 0, -1, 0, 0, 0]]
    # The ball touches at 0.2 s, with w = 100 / s. The loss reads z 10 ms later: with the time
    # t = T - (z0 - 0.1) since the touch, z = 0.1 - sin(w t) / w.
    run = Run(model, "motion", 600, 1 / 2000, qd, weight(1, 0, 2), read=420)
    assert abs(run.of_q[0, 2] - np.cos(1.0)) < 0.03
    assert run.info.label == "exact of the motion"


def test_forces_that_change_within_the_touch_keep_their_clock() -> None:
    """A push that begins in the middle of the touch does not move with the touch."""
    model = balls((0, 0, 0.3), of=surface(1e4), planes=FLOOR)
    push, begin, end, w = 40.0, 0.215, 0.4, 100.0

    def height(z: float) -> float:
        """The spring with w = 100 / s swings about 0, then about push / w^2, until it lets go."""
        inside = begin - (z - 0.1)
        d, v, rest = -np.sin(w * inside) / w, -np.cos(w * inside), push / w**2
        # d(t) = rest + r cos(w t + phase), until d reaches 0 on its way up.
        r, phase = np.hypot(d - rest, v / w), np.arctan2(-v / w, d - rest)
        leaves = ((2 * np.pi - np.arccos(-rest / r) - phase) % (2 * np.pi)) / w
        speed, left = np.sqrt((r * w) ** 2 - (rest * w) ** 2), end - begin - leaves
        return 0.1 + speed * left + 0.5 * push * left**2

    forces, down = np.zeros((800, 1, 6)), [[0, 0, -1, 0, 0, 0]]
    forces[430:, 0, 2] = push
    run = Run(model, "motion", 800, 1 / 2000, down, weight(1, 0, 2), forces=forces)
    assert abs(run.end[0, 2] - height(0.3)) < 0.01
    assert run.info.label == "exact of the motion"
    slope = (height(0.3 + 1e-5) - height(0.3 - 1e-5)) / 2e-5
    assert abs(slope) > 5.0 and abs(run.of_q[0, 2] - slope) < 0.02 * abs(slope)
    late = run.forces.grad.numpy()[780, 0, 2]
    assert abs(late - 20 / 2000**2) < 1e-8  # a force that acts 20 steps before the end


def test_labels_tell_which_touches_are_not_covered() -> None:
    # The touch begins within the steps and does not end there.
    stiff = balls((0, 0, 0.3), of=surface(1e5), planes=FLOOR)
    down = [[0, 0, -1, 0, 0, 0]]
    cut = Run(stiff, "motion", 203, 1 / 1000, down, weight(1, 0, 2)).info
    assert cut.label == "surrogate" and cut.one_sided == 1
    assert "outside of the steps" in cut.reason
    # The touch exists at the start.
    inside = balls((0, 0, 0.0995), of=surface(1e5), planes=FLOOR)
    up = [[0, 0, 1, 0, 0, 0]]
    moved, code = (Run(inside, m, 100, 1 / 1000, up, weight(1, 0, 2)) for m in ("motion", "code"))
    assert moved.info.label == "exact of the code" and moved.info.one_sided == 1
    assert np.array_equal(moved.of_q, code.of_q) and np.array_equal(moved.of_qd, code.of_qd)
    # A corner of two planes at once.
    corner = balls(
        (0.3, 0, 0.3), of=surface(1e5), planes=((0.0, 0.0, 1.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    )
    both = Run(corner, "motion", 300, 1 / 1000, [[-1, 0, -1, 0, 0, 0]], weight(1, 0, 2)).info
    assert both.label == "surrogate" and both.several == 2
    assert "several contacts at once" in both.reason
    # Friction of kf dt (1/m + r^2/I) = 3.5 shakes.
    rough = balls((0, 0, 0.3), of=surface(1e4, 0.0, 1e3, 0.5), planes=FLOOR)
    with pytest.warns(RuntimeWarning, match="shakes at the cone"):
        slip = Run(rough, "motion", 300, 1 / 1000, [[1, 0, -1, 0, 0, 0]], weight(1, 0, 2)).info
    assert slip.label == "surrogate" and "takes half of the slip in a step" in slip.reason
    # No contact begins or ends. Both gradients are then equal, and the label is the stronger one.
    free = Run(stiff, "motion", 20, 1 / 1000, down, weight(1, 0, 2)).info
    assert free.label == "exact of the motion" and free.events == 0


def test_soft_contacts_at_once_follow_the_mean_force() -> None:
    """A corner of two planes, hw 0.05: both directions come back as -1, and touch at once."""
    model = balls(
        (0.3, 0, 0.3005), of=surface(1e4), planes=((0.0, 0.0, 1.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    )
    qd, worst = [[-1, 0, -1, 0, 0, 0]], 0.0
    code = Run(model, "code", 800, 1 / 2000, qd, weight(1, 0, 2))
    motion = Run(model, "motion", 800, 1 / 2000, qd, weight(1, 0, 2))
    assert motion.info.label == "exact of the motion"
    worst = max(abs(motion.of_q[0, 2] + 1.0), abs(motion.of_q[0, 0]))
    assert worst < 0.02 < abs(code.of_q[0, 2] + 1.0)


def test_a_held_body_is_not_claimed() -> None:
    builder = novaphy.ModelBuilder(gravity=-G)
    of = surface(1e5)
    body = builder.add_link(xform=((0.3, 0.0, 0.3), UPRIGHT), mass=1.0, inertia=np.eye(3) * 0.004)
    builder.add_shape_sphere(body, radius=0.1, cfg=of)
    joint = builder.add_joint_prismatic(
        parent=-1, child=body, axis=(0, 0, 1), parent_xform=((0.3, 0.0, 0.3), UPRIGHT)
    )
    builder.add_articulation([joint])
    builder.add_ground_plane(cfg=of)
    model = builder.finalize(requires_grad=True)
    info = Run(model, "motion", 300, 1 / 1000, [[0, 0, -1, 0, 0, 0]], weight(1, 0, 2)).info
    assert info.events > 0 and info.label == "surrogate"
    assert "joints, elements or adhesion" in info.reason


def test_a_loop_of_steps_is_a_rollout() -> None:
    from novaphy import diff, nova

    model = balls((0, 0, 0.3), of=surface(1e5), planes=FLOOR)
    config = novaphy.solvers.DiffSolverConfig(angular_damping=0.0, contact_gradient="motion")
    solver = novaphy.solvers.DiffSemiImplicitSolver(model, config)
    pipeline = novaphy.CollisionPipeline(model)
    down = [[0, 0, -1, 0, 0, 0]]
    states = [model.state() for _ in range(301)]
    states[0].body_qd.assign(np.float32(down))
    with nova.Tape() as tape:
        for i in range(300):
            contacts = pipeline.contacts()
            pipeline.collide(states[i], contacts)
            solver.step(states[i], states[i + 1], None, contacts, 1 / 1000)
        tape.backward(diff.state_body_q_tensor(states[300])[0, 2])
    run = Run(model, "motion", 300, 1 / 1000, down, weight(1, 0, 2))
    assert np.array_equal(states[300].body_q.numpy(), run.end)
    assert np.array_equal(states[0].body_q.grad.numpy(), run.of_q)
    assert tape.gradient_info().label == run.info.label == "exact of the motion"


def test_another_dt_cuts_a_touch() -> None:
    from novaphy import diff, nova

    model = balls((0, 0, 0.3), of=surface(1e5), planes=FLOOR)
    config = novaphy.solvers.DiffSolverConfig(angular_damping=0.0, contact_gradient="motion")
    solver = novaphy.solvers.DiffSemiImplicitSolver(model, config)
    pipeline = novaphy.CollisionPipeline(model)
    path = diff.Trajectory(model, 300)
    path[0].body_qd.assign(np.float32([[0, 0, -1, 0, 0, 0]]))
    with nova.Tape() as tape:
        solver.rollout(path, None, None, 1 / 1000, pipeline=pipeline, stop=203)
        solver.rollout(path, None, None, 1 / 2000, pipeline=pipeline, start=203)
        tape.backward(diff.state_body_q_tensor(path[300])[0, 2])
    info = tape.gradient_info()
    assert info.label == "surrogate" and info.one_sided >= 1


def particle(z: float, mode: str, gradient: bool = True) -> Any:
    """z(0.6 s) of a particle that falls on a heavy ball, beside its middle."""
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder(gravity=0.0)
    of = surface(1e4)
    builder.add_particle((0.0, 0.0, 0.3 + z), (0.1, 0.05, -1.0), 1.0, radius=0.05)
    body = builder.add_body(xform=((0.02, 0.01, 0.0), UPRIGHT), mass=2.0, inertia=np.eye(3) * 0.01)
    builder.add_shape_sphere(body, radius=0.1, cfg=of)
    model = builder.finalize(requires_grad=True)
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_kf = 1e4, 0.0, 0.0
    config = novaphy.solvers.DiffSolverConfig(angular_damping=0.0, contact_gradient=mode)
    solver = novaphy.solvers.DiffSemiImplicitSolver(model, config)
    rate = 1000 if gradient else 4000
    path = diff.Trajectory(model, round(0.6 * rate))
    pipeline = novaphy.CollisionPipeline(model, soft_contact_margin=0.1)
    if not gradient:
        solver.rollout(path, None, None, 1 / rate, pipeline=pipeline)
        return path[round(0.6 * rate)].particle_q.numpy()[0, 2]
    with nova.Tape() as tape:
        solver.rollout(path, None, None, 1 / rate, pipeline=pipeline)
        tape.backward(diff.state_particle_q_tensor(path[round(0.6 * rate)])[0, 2])
    return path[0].particle_q.grad.numpy()[0, 2], path[0].body_q.grad.numpy()[0, 2], tape


def test_a_particle_that_hits_a_body() -> None:
    of_z, of_body, tape = particle(0.0, "motion")
    assert tape.gradient_info().label == "exact of the motion"
    assert abs(of_z + of_body - 1.0) < 1e-3  # both moved
    wide = np.mean(
        [(particle(x, "code", False) - particle(-x, "code", False)) / (2 * x) for x in (3e-3, 5e-3)]
    )
    assert abs(of_z - wide) < 0.02
    assert abs(particle(0.0, "code")[0] - wide) > 0.5


def test_what_is_not_there_is_refused_by_name() -> None:
    config_of = novaphy.solvers.DiffSolverConfig
    make = novaphy.solvers.DiffSemiImplicitSolver
    model = balls((0, 0, 0.3), of=surface(1e4), planes=FLOOR)
    with pytest.raises(ValueError, match='expected "auto", "code" or "motion", got "x"'):
        config_of(contact_gradient="x")
    with pytest.raises(NotImplementedError, match="enable_static_contacts; give rollout a pipeli"):
        make(model, config_of(contact_gradient="motion", enable_static_contacts=True))
    config = config_of(contact_gradient="motion")
    assert make(model, config).config.contact_gradient == "motion"
    assert config_of().contact_gradient == "auto"


def test_a_capture_is_refused_by_name() -> None:
    from novaphy import diff, nova

    model = balls((0, 0, 0.3), of=surface(1e4), planes=FLOOR)
    config = novaphy.solvers.DiffSolverConfig(contact_gradient="motion")
    solver = novaphy.solvers.DiffSemiImplicitSolver(model, config)
    path = diff.Trajectory(model, 4)
    pipeline = novaphy.CollisionPipeline(model)
    with (
        pytest.raises(NotImplementedError, match='"motion" is not supported inside a Scoped'),
        nova.ScopedCapture(),
        nova.Tape(),
    ):
        solver.rollout(path, None, None, 1e-3, pipeline=pipeline)
