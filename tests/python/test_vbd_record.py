"""tape.adjoint_record() with DiffSolverVBD: contacts of particles with shapes, step by step."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

if not novaphy.has_diff():
    pytest.skip("needs NOVAPHY_WITH_DIFF", allow_module_level=True)

from novaphy import diff, nova

DT, STEPS = 1 / 240, 48


def particle() -> novaphy.ModelBuilder:
    builder = novaphy.ModelBuilder(gravity=-9.81)
    builder.add_particle((0, 0, 0.12), (0, 0, 0), 0.2, radius=0.05)
    return builder


def cloth() -> novaphy.ModelBuilder:
    """Nine particles that fall on the ground."""
    builder = novaphy.ModelBuilder(gravity=-9.81)
    builder.add_cloth_grid(
        pos=(0, 0, 0.07), rot=(0, 0, 0, 1), vel=(0, 0, 0), dim_x=2, dim_y=2, cell_x=0.1,
        cell_y=0.1, mass=0.05, tri_ke=300.0, tri_ka=300.0, tri_kd=0.1, edge_ke=0.1, edge_kd=0.0,
        particle_radius=0.03,
    )  # fmt: skip
    return builder


class Run:
    """All particles start with the velocity `speed`; the loss is of their positions at the end."""

    def __init__(self, builder: novaphy.ModelBuilder, damping=2.0, **options) -> None:
        builder.add_ground_plane(cfg=novaphy.ShapeConfig(ke=2e3, kd=damping, mu=0.4))
        builder.color()
        self.model = builder.finalize(requires_grad=True)
        self.model.soft_contact_ke, self.model.soft_contact_kd = 2e3, damping
        self.model.soft_contact_mu = 0.4
        self.options = {"iterations": 30, **options}
        self.n = self.model.particle_count
        self.weights = np.random.default_rng(3).normal(size=(self.n, 3)).astype(np.float32)
        self.speed = nova.tensor([0.3, 0.1, -1.0], requires_grad=True)
        with nova.Tape() as self.tape:
            self.path, loss = self.roll(np.zeros((STEPS, self.n, 3)))
            self.tape.backward(loss, record=True)
        self.slope = self.speed.grad.numpy()
        self.record = self.tape.adjoint_record([self.speed])

    def roll(self, forces: np.ndarray) -> tuple[diff.Trajectory, nova.Tensor]:
        path = diff.Trajectory(self.model, STEPS)
        rates = nova.zeros((self.n, 3)) + self.speed
        diff.state_particle_qd_tensor(path[0]).copy_(rates)
        solver = novaphy.solvers.DiffSolverVBD(self.model, **self.options)
        pipeline = novaphy.CollisionPipeline(self.model)
        given = nova.tensor(forces.astype(np.float32))
        solver.rollout(path, None, None, DT, pipeline=pipeline, forces=given)
        end = diff.state_particle_q_tensor(path[STEPS])
        return path, nova.sum(end * nova.tensor(self.weights))

    def difference(self, step: int, particle: int, impulse: np.ndarray) -> float:
        """Change of the loss per size of an external impulse (N s), by a central difference."""
        losses = []
        for sign in (1.0, -1.0):
            forces = np.zeros((STEPS, self.n, 3))
            forces[step, particle] = sign * impulse / DT
            losses.append(self.roll(forces)[1].item())
        return (losses[0] - losses[1]) / 2.0


@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
def test_the_ground_carries_what_free_flight_does_not(gradient) -> None:
    """A free particle has the slope weight * duration in each direction."""
    run = Run(particle(), gradient=gradient)
    downhill = -run.slope / np.linalg.norm(run.slope)
    free = STEPS * DT * run.weights[0] @ downhill
    carried = sum(c["carried"] for c in run.record.contacts)
    assert carried == pytest.approx(run.slope @ downhill - free, rel=2e-3)
    assert abs(carried) > 0.05
    assert str(run.record).count("carried") == 1  # the touch as a whole
    for c in run.record.contacts:
        assert (c["particle"], c["shape1"], c["held"]) == (0, -1, False)
        assert c["normal"] == [0, 0, 1] and c["impulse"][2] > 0.0


def test_impulses_are_those_of_the_motion() -> None:
    """The momentum that the particle gains, but for gravity."""
    run = Run(particle())
    gained = 0.2 * (run.path[STEPS].particle_qd.numpy()[0] - run.speed.numpy())
    gained[2] += 0.2 * 9.81 * STEPS * DT
    assert np.allclose(sum(np.array(c["impulse"]) for c in run.record.contacts), gained, atol=1e-4)
    assert np.linalg.norm(gained) > 0.1 and abs(gained[0]) > 0.01  # also friction


def test_the_adjoint_is_the_difference_by_an_external_impulse() -> None:
    run = Run(cloth(), friction_epsilon=0.1)
    rows = run.record.contacts
    assert len({c["particle"] for c in rows}) == 9 and not any(c["held"] for c in rows)
    for c in rows[:: len(rows) // 4]:
        wanted = [run.difference(c["step"], c["particle"], 5e-4 * e) / 5e-4 for e in np.eye(3)]
        assert np.allclose(c["adjoint"], wanted, atol=0.03 * np.linalg.norm(wanted))
        assert np.linalg.norm(wanted) > 0.02


@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
def test_all_particles_that_touch_a_shape_count_as_one_pair(gradient) -> None:
    """A velocity of all particles deforms nothing in free flight."""
    run = Run(cloth(), damping=0.0, gradient=gradient)
    downhill = -run.slope / np.linalg.norm(run.slope)
    free = STEPS * DT * run.weights.sum(axis=0) @ downhill
    carried = sum(c["carried"] for c in run.record.contacts)
    assert carried == pytest.approx(run.slope @ downhill - free, rel=5e-3)
    assert abs(carried) > 0.5
    assert "particles and shape 0 carried" in str(run.record)


def test_steps_without_a_record_are_refused_by_name() -> None:
    builder = particle()
    builder.color()
    model = builder.finalize(requires_grad=True)
    path = diff.Trajectory(model, 4, checkpoint=2)
    with nova.Tape() as tape:
        novaphy.solvers.DiffSolverVBD(model).rollout(path, None, None, DT)
        loss = nova.sum(diff.state_particle_q_tensor(path[4]))
        with pytest.raises(NotImplementedError, match="steps of DiffSolverVBD with checkpoints"):
            tape.backward(loss, record=True)
