"""tape.adjoint_record() with penalty contacts of bodies: what each pair carries, step by step."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
DT, RADIUS, STEPS = 1e-3, 0.1, 120
SURFACE = {"ke": 1e4, "kd": 5.0, "kf": 20.0, "mu": 0.3, "density": 0, "gap": 0.05}


def balls(places: list[tuple[float, float, float]]) -> novaphy.Model:
    """Balls of 1 kg, without gravity."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    for place in places:
        body = builder.add_body(xform=(place, UPRIGHT), mass=1.0, inertia=np.eye(3) * 0.004)
        builder.add_shape_sphere(body, radius=RADIUS, cfg=novaphy.ShapeConfig(**SURFACE))
    return builder.finalize(requires_grad=True)


class Run:
    """The first body has the velocity `speed` along an axis; the loss is of the last body."""

    def __init__(self, model, mode="code", axis=0, velocity=1.0, weights=(1.0, 0.5, 0.0)) -> None:
        from novaphy import diff, nova

        count = model.body_count
        self.path = diff.Trajectory(model, STEPS)
        self.speed = nova.tensor(np.float32([velocity]), requires_grad=True)
        self.forces = nova.zeros((STEPS, count, 6), requires_grad=True)
        along = np.zeros((count, 6), np.float32)
        along[0, axis] = 1.0
        solver = novaphy.solvers.DiffSemiImplicitSolver(
            model,
            novaphy.solvers.DiffSolverConfig(
                friction_law="huber", angular_damping=0.0, contact_gradient=mode
            ),
        )
        with nova.Tape() as self.tape:
            diff.state_body_qd_tensor(self.path[0]).copy_(self.speed * nova.tensor(along))
            solver.rollout(
                self.path, None, None, DT, pipeline=novaphy.CollisionPipeline(model),
                body_forces=self.forces,
            )  # fmt: skip
            end = diff.state_body_q_tensor(self.path[STEPS])[count - 1, 0:3]
            self.loss = nova.sum(end * nova.tensor(np.float32(weights)))
            self.other = -100.0 * diff.state_body_q_tensor(self.path[STEPS])[0, 0]
            self.tape.backward(self.loss, record=True)
        self.slope = self.speed.grad.item()
        self.record = self.tape.adjoint_record([self.speed])

    def carried(self, first: int, second: int) -> float:
        """Sum over the steps of a pair of shapes."""
        pair = {first, second}
        rows = [c for c in self.record.contacts if {c["shape0"], c["shape1"]} == pair]
        assert len(rows) > 5
        return sum(c["carried"] for c in rows)


@pytest.mark.parametrize("mode", ["code", "motion"])
@pytest.mark.parametrize("offset", [0.0, 0.06])
def test_one_contact_carries_the_whole_derivative(offset: float, mode: str) -> None:
    """The second ball moves only because of the contact; off the line the arms change, too."""
    run = Run(balls([(0, 0, 0), (0.23, offset, 0)]), mode)
    bound = 1e-3 if offset == 0.0 else 0.01
    assert abs(run.slope) > 0.01
    assert abs(run.carried(0, 1) + abs(run.slope)) < bound * abs(run.slope)
    steps = [c["step"] for c in run.record.contacts]
    assert steps == list(range(steps[0], steps[0] + len(steps)))
    begins = [c["begins"] for c in run.record.contacts]
    assert begins == [True] + [False] * (len(steps) - 1)
    assert not any(c["held"] for c in run.record.contacts)
    assert str(run.record).count("carried") == 1  # the touch as a whole


def test_a_record_is_of_one_loss() -> None:
    """Leaves accumulate the gradients of two losses, here with another sign than the first."""
    run = Run(balls([(0, 0, 0), (0.23, 0.06, 0)]))
    run.tape.backward(run.other)
    assert run.speed.grad.item() * run.slope < 0.0
    with pytest.raises(novaphy.Error, match="got one without a record behind it"):
        run.tape.adjoint_record([run.speed])
    run.tape.backward(run.loss, record=True)
    first, run.record = run.record, run.tape.adjoint_record([run.speed])
    assert abs(run.carried(0, 1) + abs(run.slope)) < 0.01 * abs(run.slope)
    assert run.record.boundaries[0]["norm"] == pytest.approx(first.boundaries[0]["norm"], rel=1e-4)


@pytest.mark.parametrize("mode", ["code", "motion"])
def test_each_pair_of_a_chain_carries_the_derivative(mode: str) -> None:
    run = Run(balls([(0, 0, 0), (0.22, 0, 0), (0.44, 0, 0)]), mode)
    for pair in ((0, 1), (1, 2)):
        assert abs(run.carried(*pair) + abs(run.slope)) < 1e-3 * abs(run.slope)


def test_impulses_and_adjoints_are_those_of_the_motion() -> None:
    run = Run(balls([(0, 0, 0), (0.23, 0, 0)]))
    rows = run.record.contacts
    sign = 1.0 if rows[0]["shape1"] == 1 else -1.0
    gained = run.path[STEPS].body_qd.numpy()[1, 0]
    assert sign * sum(c["impulse"][0] for c in rows) == pytest.approx(gained, rel=1e-4)
    assert gained > 0.9
    by_wrench = run.forces.grad.numpy()  # the gradient by external forces
    for c in rows:
        arms = np.array(c["point"]) - run.path[c["step"]].body_q.numpy()[:, 0:3]
        by_force = by_wrench[c["step"], :, 0:3] + np.cross(by_wrench[c["step"], :, 3:6], arms)
        wanted = sign * (by_force[1] - by_force[0]) / DT
        assert np.allclose(c["adjoint"], wanted, atol=1e-4 * np.abs(wanted).max())
        assert np.dot(c["normal"], c["impulse"]) > 0.0
        assert c["point"][0] == pytest.approx(0.13, abs=0.02)


def bouncing(mode: str) -> Run:
    builder = novaphy.ModelBuilder(gravity=-9.81)
    body = builder.add_body(xform=((0, 0, 0.15), UPRIGHT), mass=1.0, inertia=np.eye(3) * 0.004)
    surface = novaphy.ShapeConfig(**SURFACE)
    builder.add_shape_sphere(body, radius=RADIUS, cfg=surface)
    builder.add_ground_plane(cfg=surface)
    return Run(builder.finalize(requires_grad=True), mode, 2, -1.0, (0.0, 0.0, 1.0))


@pytest.mark.parametrize("mode", ["code", "motion"])
def test_the_ground_carries_what_free_flight_does_not(mode: str) -> None:
    """d height / d speed is the duration without the ground."""
    run = bouncing(mode)
    downhill = -np.sign(run.slope)
    wanted = -abs(run.slope) - downhill * STEPS * DT
    assert run.carried(0, 1) == pytest.approx(wanted, rel=1e-3)


def test_missed_begin_and_end_of_a_spring_are_suspects() -> None:
    code, motion = bouncing("code").record, bouncing("motion").record
    assert code.suspects and code.suspects[0]["cause"].startswith("missed event of shapes")
    ends = {code.contacts[0]["step"] - 1, code.contacts[-1]["step"]}
    assert code.suspects[0]["step"] in {*ends, code.contacts[0]["step"]}
    assert motion.suspects == []
    assert max(row["drift"] for row in motion.boundaries) < 0.01
    norms = [row["norm"] for row in code.boundaries]
    assert len(norms) == STEPS + 1 and min(norms) > 0.0


def test_steps_without_a_record_are_refused_by_name() -> None:
    from novaphy import diff, nova

    solvers = novaphy.solvers
    model = balls([(0, 0, 0), (0.23, 0, 0)])

    def refused(solver, model: novaphy.Model, match: str, checkpoint=None, pipeline=True) -> None:
        path = diff.Trajectory(model, 4, checkpoint=checkpoint)
        with nova.Tape() as tape:
            given = {"pipeline": novaphy.CollisionPipeline(model)} if pipeline else {}
            solver.rollout(path, None, None, DT, **given)
            loss = nova.sum(diff.state_body_q_tensor(path[4]))
            with pytest.raises(NotImplementedError, match=match):
                tape.backward(loss, record=True)

    solver = solvers.DiffSemiImplicitSolver(model)
    refused(solver, model, "steps of DiffSemiImplicitSolver with checkpoints, only of", 2)
    mean = solvers.DiffSolverConfig(penalty_law="mean", friction_law="huber")
    refused(solvers.DiffSemiImplicitSolver(model, mean), model, 'with penalty_law "mean"')
    builder = novaphy.ModelBuilder()
    body = builder.add_body(xform=((0, 0, 1), UPRIGHT), mass=1.0, inertia=np.eye(3))
    builder.add_shape_sphere(body, radius=RADIUS)
    builder.add_ground_plane()
    ground = builder.finalize(requires_grad=True)
    static = solvers.DiffSolverConfig(enable_static_contacts=True)
    static_solver = solvers.DiffSemiImplicitSolver(ground, static)
    refused(static_solver, ground, "with enable_static_contacts", pipeline=False)
    builder.add_particle((0, 0, 3), (0, 0, 0), 1.0)
    both = builder.finalize(requires_grad=True)
    refused(solvers.DiffSemiImplicitSolver(both), both, "with particles")
