"""Captures: replays have the bits of what runs at once, and what cannot be recorded raises."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scenes import DT, LEARNING_RATE, STEPS, TARGET, ball_contacts, ball_model, golden

import novaphy
from novaphy import diff, nova, solvers
from novaphy.testing import assert_same_bits


class Training:
    """One training iteration of the ball as a rollout."""

    def __init__(self) -> None:
        """Make everything that a capture needs to stay where it is."""
        self.model = ball_model()
        self.trajectory = diff.Trajectory(self.model, STEPS)
        self.contacts = ball_contacts(self.model, self.trajectory[0])
        self.solver = solvers.DiffSemiImplicitSolver(
            self.model, solvers.DiffSolverConfig(contact_gradient="code")
        )
        self.velocity = diff.state_particle_qd_tensor(self.trajectory[0], requires_grad=True)
        self.last = diff.state_particle_q_tensor(self.trajectory[STEPS])

    def iteration(self):
        """Forward, backward, update; the loss."""
        with nova.Tape() as tape:
            self.solver.rollout(self.trajectory, None, self.contacts, DT)
            loss = diff.particle_point_loss_generated(self.last, 0, *TARGET)
            tape.backward(loss)
            nova.sgd_update_f32(self.velocity, LEARNING_RATE)
            tape.zero()
        return loss


def test_a_replay_has_the_bits_of_what_runs_at_once():
    newton = golden("newton_ball_strict")
    eager, captured = Training(), Training()
    start = captured.velocity.numpy()
    with nova.ScopedCapture() as capture:
        loss = captured.iteration()
    assert capture.graph.size == len(capture.graph) > STEPS
    assert_same_bits(captured.velocity, start, "recorded, not run")
    for k in range(10):
        expected = eager.iteration()
        if k % 2:
            capture.graph.launch()
        else:
            nova.capture_launch(capture.graph)
        assert_same_bits(loss, expected, "loss")
        assert_same_bits(captured.velocity, eager.velocity, "velocity")
        assert_same_bits(captured.trajectory.particle_q, eager.trajectory.particle_q, "states")
        assert loss.item() == pytest.approx(float(newton["train_loss"][k]), rel=1e-5)


def test_a_replay_sees_new_values():
    x, y = nova.tensor([1.0, 2.0]), nova.zeros(2)
    with nova.ScopedCapture() as capture:
        y.copy_(x * x + 1)
    assert y.tolist() == [0, 0]
    version = y.version
    for values in ([1.0, 2.0], [3.0, 4.0]):
        x.assign(values)
        capture.graph.launch()
        assert y.tolist() == [v * v + 1 for v in values]
    assert y.version > version


@pytest.mark.parametrize(
    "call",
    [
        lambda s: s.velocity.numpy(),
        lambda s: s.velocity.numpy(copy=False),
        lambda s: s.velocity.numpy(copy=False, writable=True),
        lambda s: float(s.last[0, 0]),
        lambda s: s.last.tolist(),
        lambda s: np.asarray(s.velocity),
        lambda s: np.from_dlpack(s.velocity),
        lambda s: s.trajectory[0].particle_q.numpy(),
        lambda s: s.trajectory[0].particle_q[0],
        lambda s: s.trajectory[0].particle_q.__setitem__(0, (0, 0, 0)),
        lambda s: s.trajectory[0].particle_q.assign([(0, 0, 0)]),
        lambda s: s.trajectory[0].particle_q.fill_(0),
        lambda s: s.trajectory[0].clear_forces(),
        lambda s: s.solver.step(s.trajectory[0], s.trajectory[1], None, s.contacts, DT),
        lambda s: solvers.SolverSemiImplicit(s.model).step(
            s.trajectory[0], s.trajectory[1], None, s.contacts, DT
        ),
        lambda s: s.model.collide(s.trajectory[0]),
        lambda s: s.contacts.soft_contacts(),
        lambda s: nova.ones(1).item(),
        lambda s: nova.ScopedCapture().__enter__(),
    ],
)
def test_what_cannot_be_recorded_raises_and_changes_nothing(call):
    scene = Training()
    before = scene.trajectory[0].particle_q.numpy()
    with nova.ScopedCapture() as capture, pytest.raises(novaphy.Error, match=r"[Cc]apture"):
        call(scene)
    assert_same_bits(scene.trajectory[0].particle_q, before)
    capture.graph.launch()


def test_a_graph_whose_contacts_changed_refuses():
    scene = Training()
    with nova.ScopedCapture() as capture:
        scene.iteration()
    capture.graph.launch()
    scene.contacts.assign(ball_contacts(scene.model, scene.trajectory[0]))
    with pytest.raises(novaphy.Error, match="index table"):
        capture.graph.launch()


def test_a_graph_keeps_what_it_works_on():
    x = nova.tensor([1.0])
    total = nova.zeros(1)
    with nova.ScopedCapture() as capture:
        total.copy_(total + x * 2)
    graph = capture.graph
    del x, capture
    for _ in range(3):
        graph.launch()
    assert total.item() == 6


def test_a_capture_ends_with_its_block():
    capture = nova.ScopedCapture()
    with pytest.raises(novaphy.Error, match="with"):
        _ = capture.graph
    with pytest.raises(ZeroDivisionError), capture:
        _ = 1 / 0
    assert nova.tensor([1.0]).item() == 1
    with nova.Tape() as tape:
        with nova.ScopedCapture():
            pass
        x = nova.tensor([1.0], requires_grad=True)
        with pytest.raises(novaphy.Error, match="Tape|recorded"):
            with nova.ScopedCapture() as inner:
                pass
            inner.graph.launch()
        assert tape.size == 0 and x.is_leaf


def test_a_prepared_graph_has_not_run():
    y = nova.zeros(2)
    with nova.ScopedCapture() as capture:
        y.copy_(y + nova.full(2, 0.5))
        with pytest.raises(novaphy.Error, match="prepare\\(\\) inside a ScopedCapture"):
            capture.graph.prepare()
    capture.graph.prepare()
    assert y.tolist() == [0.0, 0.0]
    capture.graph.launch()
    capture.graph.prepare()
    assert y.tolist() == [0.5, 0.5]


def test_tensors_may_be_made_inside():
    y = nova.zeros(2)
    with nova.ScopedCapture() as capture:
        y.copy_(y + nova.tensor([1.0, 2.0]) + nova.full(2, 0.5))
    capture.graph.launch()
    capture.graph.launch()
    assert y.tolist() == [3, 5]


def test_a_captured_rollout_refuses_other_numbers_of_its_model_and_follows_its_arrays():
    builder = novaphy.ModelBuilder()
    builder.add_particle((0, 0, 0.05), (0, 0, 0), 1.0)
    builder.add_ground_plane()
    model = builder.finalize()
    config = solvers.DiffSolverConfig(enable_static_contacts=True)
    solver = solvers.DiffSemiImplicitSolver(model, config)
    trajectory = diff.Trajectory(model, 20)

    def height() -> float:
        return trajectory[20].particle_q.numpy()[0, 2]

    with nova.ScopedCapture() as capture:
        solver.rollout(trajectory, None, None, 1e-3)
    capture.graph.launch()
    before = height()
    model.soft_contact_ke = 1e5
    with pytest.raises(novaphy.Error, match=r"model\.soft_contact_ke: recorded as 1000, and now"):
        capture.graph.launch()
    model.soft_contact_ke = 1e3
    model.particle_mass.assign(np.array([4.0], np.float32))
    capture.graph.launch()
    assert height() != before
    replayed = trajectory[20].particle_q.numpy()
    solver.rollout(trajectory, None, None, 1e-3)
    np.testing.assert_array_equal(trajectory[20].particle_q.numpy(), replayed)


class Throws:
    """Many balls that start close above the ground, some of them beyond the speed limit."""

    def __init__(self, balls: int, steps: int) -> None:
        """The same balls every time."""
        random = np.random.default_rng(7)
        spread = random.uniform([-1, -1, 0.05], [1, 1, 0.6], (balls, 3)).astype(np.float32)
        speed = random.normal(0, 3, (balls, 3)).astype(np.float32)
        builder = novaphy.ModelBuilder()
        builder.add_particles(spread, speed, np.ones(balls, np.float32))
        builder.add_ground_plane(cfg=novaphy.ShapeConfig(ke=1.0e4, kd=10.0, kf=5.0, mu=0.3))
        self.model = builder.finalize(requires_grad=True)
        self.model.particle_max_velocity = 8.0
        self.trajectory = diff.Trajectory(self.model, steps)
        self.contacts = ball_contacts(self.model, self.trajectory[0])
        self.solver = solvers.DiffSemiImplicitSolver(
            self.model, solvers.DiffSolverConfig(contact_gradient="code")
        )
        self.start = diff.state_particle_q_tensor(self.trajectory[0], requires_grad=True)
        self.velocity = diff.state_particle_qd_tensor(self.trajectory[0], requires_grad=True)
        self.last = diff.state_particle_q_tensor(self.trajectory[steps])

    def gradients(self, leaves: bool) -> None:
        """Forward and backward."""
        with nova.Tape(leaf_gradients_only=leaves) as tape:
            self.solver.rollout(self.trajectory, None, self.contacts, DT)
            tape.backward(nova.dot(self.last, self.last))


# Enough balls for blocks; a rest that fills no group of lanes; states beyond every cache.
@pytest.mark.parametrize("balls,steps", [(2051, 24), (4096, 24), (20000, 96)])
@pytest.mark.parametrize("leaves", [False, True])
def test_blocks_of_a_large_rollout_have_the_bits_of_single_steps(balls, steps, leaves):
    captured, stepped = Throws(balls, steps), Throws(balls, steps)
    with nova.ScopedCapture() as capture:
        captured.gradients(leaves)
    for _ in range(2):
        captured.velocity.zero_grad()
        captured.start.zero_grad()
        capture.graph.launch()
    # Step adds to the forces of its state, so each has its own.
    states = [stepped.model.state() for _ in range(steps - 1)]
    states = [stepped.trajectory[0], *states, stepped.trajectory[steps]]
    with nova.Tape() as tape:
        for before, after in itertools.pairwise(states):
            before.clear_forces()
            stepped.solver.step(before, after, None, stepped.contacts, DT)
        tape.backward(nova.dot(stepped.last, stepped.last))
    speed = np.linalg.norm(stepped.trajectory[steps].particle_qd.numpy(), axis=1)
    positions = np.stack([s.particle_q.numpy() for s in states])
    velocities = np.stack([s.particle_qd.numpy() for s in states])
    touched = positions[:, :, 2] < 0.1
    assert speed.max() == pytest.approx(8.0, rel=1e-4)
    assert 0.02 < touched.mean() < 0.9
    assert_same_bits(captured.trajectory.particle_q, positions, "positions")
    assert_same_bits(captured.trajectory.particle_qd, velocities, "velocities")
    assert_same_bits(captured.velocity.grad, stepped.velocity.grad, "gradient of the velocities")
    assert_same_bits(captured.start.grad, stepped.start.grad, "gradient of the positions")


def test_a_plan_that_is_printed_says_what_fuses_and_why_the_rest_does_not(capfd, monkeypatch):
    """Kernels over many rows share blocks; a sum, and kernels over few rows, do not."""
    monkeypatch.setenv("NOVAPHY_PRINT_PLAN", "1")

    def plan(rows: int) -> str:
        x = nova.tensor(np.ones(rows, np.float32))
        with nova.ScopedCapture() as capture:
            nova.sum(nova.sin(x * 2.0) + 1.0)
        capture.graph.launch()
        return capfd.readouterr().err

    many = plan(5000)
    assert "block by block, 5000 rows" in many
    assert "1 x mul_scalar, 1 x sin, 1 x add_scalar" in many
    assert "in no block, because it is no traced kernel" in many
    few = plan(100)
    assert "block by block" not in few
    assert "sin: in no block, because it has 100 rows, of at least 2048" in few
    monkeypatch.delenv("NOVAPHY_PRINT_PLAN")
    assert plan(5000) == ""
