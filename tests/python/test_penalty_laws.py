"""The mean force of penalty contacts (penalty_law="mean"): bounces whatever the phase.

Against closed forms of a spring and of a damped spring in float64, and against differences.
"""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = [
    pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF"),
    pytest.mark.filterwarnings("ignore:.*dt"),
]

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
RADIUS, SPEED, START, TIME = 0.1, 1.0, 0.03, 0.125


def ball(ke: float, kd: float, mu: float = 0.0, kf: float = 0.0, worlds: int = 1):
    """A ball of 1 kg above the ground, in worlds without gravity."""
    of = novaphy.ShapeConfig(ke=ke, kd=kd, kf=kf, mu=mu, density=0, gap=0.05)
    one = novaphy.ModelBuilder(gravity=0.0)
    body = one.add_body(
        xform=((0, 0, RADIUS + START), UPRIGHT), mass=1.0, inertia=np.eye(3) * 0.004
    )
    one.add_shape_sphere(body, radius=RADIUS, cfg=of)
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.replicate(one, worlds)
    builder.add_ground_plane(cfg=of)
    return builder.finalize(requires_grad=True)


def config(law: str, **more) -> novaphy.solvers.DiffSolverConfig:
    """The gradient is that of the code, so that the law alone makes the difference."""
    more = {"contact_gradient": "code", **more}
    return novaphy.solvers.DiffSolverConfig(angular_damping=0.0, penalty_law=law, **more)


class Run:
    """A rollout of a ball that starts at a height above START, and the slopes of its end."""

    def __init__(
        self,
        model,
        law: str,
        rate: int,
        lift: float,
        *,
        qd=(0, 0, -SPEED, 0, 0, 0),
        of: int = 2,
        along=None,
        gradient: bool = True,
        **more,
    ) -> None:
        from novaphy import diff, nova

        solver = novaphy.solvers.DiffSemiImplicitSolver(model, config(law, **more))
        steps = round(TIME * rate)
        path = diff.Trajectory(model, steps)
        first = path[0]
        start = np.float32([[0, 0, RADIUS + START + lift, *UPRIGHT]])
        first.body_q.assign(start)
        first.body_qd.assign(np.float32([qd]))
        how = {"pipeline": novaphy.CollisionPipeline(model)}
        if not gradient:
            solver.rollout(path, None, None, 1 / rate, **how)
        else:
            with nova.Tape() as tape:
                solver.rollout(path, None, None, 1 / rate, **how)
                loss = nova.sum(diff.state_body_q_tensor(path[steps])[:, of : of + 1])
                tape.backward(loss)
                self.of_q = first.body_q.grad.numpy()[0]
                self.of_qd = first.body_qd.grad.numpy()[0]
                if along is not None:
                    views = [diff.state_body_q_tensor(first), diff.state_body_qd_tensor(first)]
                    tangents = [nova.tensor(np.float32(x)) for x in along]
                    self.along = tape.jvp([loss], views, tangents)[0].item()
        self.end = path[steps].body_q.numpy()[0]
        self.speed = path[steps].body_qd.numpy()[0]


PHASES = np.arange(6) / 6


def test_a_spring_turns_the_height_whatever_the_phase() -> None:
    """The slope of the end by the height is -1, the speed behind is that before."""
    model, rate = ball(1e4, 0.0), 960  # dt sqrt(ke / m) = 0.1
    slopes, speeds, heights = {}, {}, {}
    for law in ("sampled", "mean"):
        runs = [Run(model, law, rate, phase / rate) for phase in PHASES]
        slopes[law] = max(abs(run.of_q[2] + 1.0) for run in runs)
        speeds[law] = max(abs(run.speed[2] - SPEED) for run in runs)
        touch = [RADIUS + SPEED * TIME - (START + phase / rate) for phase in PHASES]
        late = [run.end[2] - free for run, free in zip(runs, touch, strict=True)]
        assert abs(np.mean(late) + SPEED * np.pi / 100.0) < 1e-4  # the touch lasts pi / w
        heights[law] = np.ptp(late)
    assert slopes["mean"] < 3e-3 and slopes["sampled"] > 0.3, slopes
    assert speeds["mean"] < 0.01 * speeds["sampled"], speeds
    assert heights["mean"] < 0.01 * heights["sampled"], heights


def test_a_damper_has_the_slope_of_the_bounce() -> None:
    """A damped spring throws back with the speed e v: the slope by the height is -e."""
    ke, kd = 1e4, 30.0
    model = ball(ke, kd)
    errors = []
    for rate in (960, 3840):
        runs = [Run(model, "mean", rate, phase / rate) for phase in PHASES]
        errors.append(max(abs(r.of_q[2] + r.speed[2] / SPEED) for r in runs))
    sampled = [Run(model, "sampled", 3840, phase / 3840) for phase in PHASES]
    worst = max(abs(r.of_q[2] + r.speed[2] / SPEED) for r in sampled)
    assert errors[0] < 0.05 and errors[1] < 0.02 and worst > 0.3


@pytest.mark.parametrize("law", ["viscous", "huber"])
def test_with_friction_the_gradient_is_that_of_differences(law: str) -> None:
    """Differences that are small beside the way of a step see the motion too."""
    rate, qd = 960, np.float64([0.6, 0.2, -SPEED, 0.5, -3.0, 1.0])
    model = ball(1e4, 30.0, mu=0.4, kf=60.0)
    more = {"friction_law": law}
    for of in (0, 2):
        for phase in (0.1, 0.45, 0.8):
            rng = np.random.default_rng(3)
            along = (np.zeros((1, 7)), rng.normal(size=(1, 6)))
            along[0][0, :3] = rng.normal(size=3)
            run = Run(model, "mean", rate, phase / rate, qd=qd, of=of, along=along, **more)
            parts = np.concatenate([run.of_q * along[0][0], run.of_qd * along[1][0]])
            assert abs(run.along - parts.sum()) < 1e-5 * np.abs(parts).sum()
            eps = 2e-4
            ends = [
                Run(model, "mean", rate, phase / rate + s * eps, qd=qd, gradient=False, **more).end
                for s in (1, -1)
            ]
            difference = (ends[0][of] - ends[1][of]) / (2 * eps)
            assert abs(run.of_q[2] - difference) < 0.03, (of, phase, run.of_q[2], difference)
            for k in range(6):
                d = 2e-3 * np.eye(6)[k]
                ends = [
                    Run(
                        model, "mean", rate, phase / rate, qd=qd + s * d, gradient=False, **more
                    ).end
                    for s in (1, -1)
                ]
                difference = (ends[0][of] - ends[1][of]) / 4e-3
                assert abs(run.of_qd[k] - difference) < 5e-3, (of, phase, k)


def test_friction_is_continuous_where_the_mean_begins_and_ends() -> None:
    """A slide over the ground: the force against the depth has no jump."""
    model = ball(1e4, 30.0, mu=0.4, kf=60.0)
    solver = novaphy.solvers.SolverSemiImplicit(model, angular_damping=0.0, penalty_law="mean")
    assert solver.penalty_law == "mean"
    pipeline, dt = novaphy.CollisionPipeline(model), 1e-3
    way = SPEED * dt / 2
    forces = []
    gaps = np.linspace(-1.5 * way, 1.5 * way, 601)
    for gap in gaps:
        state, after, contacts = model.state(), model.state(), pipeline.contacts()
        state.body_q.assign(np.float32([[0, 0, RADIUS + gap, *UPRIGHT]]))
        state.body_qd.assign(np.float32([[2.0, 0.5, -SPEED, 0, 0, 0]]))
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, dt)
        forces.append(contacts.rigid_contact_force.numpy()[0])
    forces = np.array(forces)
    jumps = np.abs(np.diff(forces, axis=0)).max(axis=0)
    assert np.all(jumps < 0.01 * np.abs(forces).max(axis=0)), jumps
    assert np.all(forces[gaps > 1.01 * way] == 0.0)
    deep = gaps < -1.01 * way
    push = np.abs(forces[deep, 2])
    np.testing.assert_allclose(push, -1e4 * gaps[deep] + 30.0 * SPEED, rtol=1e-3)
    friction = np.linalg.norm(forces[:, :2], axis=1)
    assert np.all(friction <= 0.4 * np.abs(forces[:, 2]) * (1 + 1e-5))


def test_the_two_solvers_have_the_same_bits() -> None:
    model, dt = ball(1e4, 30.0, mu=0.4, kf=60.0), 1 / 960
    pipeline, ends = novaphy.CollisionPipeline(model), []
    for solver in (
        novaphy.solvers.SolverSemiImplicit(model, angular_damping=0.0, penalty_law="mean"),
        novaphy.solvers.DiffSemiImplicitSolver(model, config("mean")),
    ):
        now, then, contacts = model.state(), model.state(), pipeline.contacts()
        now.body_qd.assign(np.float32([[0.6, 0.2, -SPEED, 0.5, -3.0, 1.0]]))
        for _ in range(80):
            pipeline.collide(now, contacts)
            solver.step(now, then, None, contacts, dt)
            now, then = then, now
        ends.append(np.concatenate([now.body_q.numpy().ravel(), now.body_qd.numpy().ravel()]))
    np.testing.assert_array_equal(*ends)
    assert ends[0][9] > 0.5


def test_what_is_not_supported_is_refused_by_name() -> None:
    solvers, model = novaphy.solvers, ball(1e4, 0.0)
    with pytest.raises(ValueError, match='penalty_law: expected "sampled" or "mean", got "x"'):
        config("x")
    with pytest.raises(NotImplementedError, match='not supported with contact_gradient "motion"'):
        solvers.DiffSemiImplicitSolver(model, config("mean", contact_gradient="motion"))
    with pytest.raises(NotImplementedError, match="not supported with enable_static_contacts"):
        solvers.DiffSemiImplicitSolver(model, config("mean", enable_static_contacts=True))
    with pytest.raises(NotImplementedError, match='not supported with the friction law "newton18"'):
        solvers.SolverSemiImplicit(model, penalty_law="mean", friction_law="newton18")
    with pytest.raises(NotImplementedError, match='expected "sampled" with stick_ke'):
        solvers.SolverSemiImplicit(model, penalty_law="mean", stick_ke=1e4)
    builder = novaphy.ModelBuilder()
    builder.add_particle((0, 0, 1), (0, 0, 0), 1.0)
    with pytest.raises(NotImplementedError, match="not supported for contacts of particles"):
        solvers.SolverSemiImplicit(builder.finalize(), penalty_law="mean")
