"""A particle glides over a curved shape: points and normals of the contacts move with the particle.

The particle starts at the depth that carries its weight, so the contact never opens. Differences
then have no kink, and the gradient of the code is that of the motion.
"""

import numpy as np
import pytest

import novaphy
from novaphy import diff, nova

STEPS, DT = 96, 1 / 960
WEIGHTS = np.float32([[1.0, 2.0, 0.0]])
RADIUS, DEPTH = 0.02, 0.05 * 30.0 / 4e3


def gliding(shape: str, worlds: int = 1) -> novaphy.Model:
    """Return a model in which a particle starts on the shape, in contact."""
    builder = novaphy.ModelBuilder(gravity=-30.0)
    surface = novaphy.ShapeConfig(ke=4e3, kd=0.0, kf=0.3, mu=0.4)
    if shape == "sphere":
        builder.add_shape_sphere(-1, radius=0.5, cfg=surface)
        away, at = np.array([0.2, 0.1, 0.97]), np.zeros(3)
    elif shape == "capsule":
        builder.add_shape_capsule(-1, radius=0.4, half_height=0.1, cfg=surface)
        away, at = np.array([0.2, 0.1, 0.97]), np.array([0.0, 0.0, 0.1])
    elif shape == "ellipsoid":
        builder.add_shape_ellipsoid(-1, rx=0.6, ry=0.5, rz=0.4, cfg=surface)
        at = np.array([0.1, 0.05, 0.0])
        at[2] = 0.4 * np.sqrt(1 - (at[0] / 0.6) ** 2 - (at[1] / 0.5) ** 2)
        away = at / np.square([0.6, 0.5, 0.4])
    else:
        builder.add_shape_cone(-1, radius=0.5, half_height=0.2, cfg=surface)
        side = np.array([2.0, 1.0, 0.0]) / np.sqrt(5)
        at, away = side * 0.25, side * 0.4 + np.array([0.0, 0.0, 0.5])
    away = away / np.linalg.norm(away)
    on = at + away * ({"sphere": 0.5, "capsule": 0.4}.get(shape, 0.0))
    gap = RADIUS - DEPTH * away[2]
    across = np.cross(away, (0.0, 1.0, 0.0))
    world = novaphy.ModelBuilder(gravity=-30.0)
    world.add_particle(tuple(on + away * gap), tuple(0.3 * across), 0.05, radius=RADIUS)
    for _ in range(worlds):
        builder.add_world(world)
    model = builder.finalize(requires_grad=True)
    model.soft_contact_ke, model.soft_contact_kd = 4e3, 0.0
    model.soft_contact_kf, model.soft_contact_mu = 0.3, 0.4
    return model


def glide(
    model: novaphy.Model, q: np.ndarray, checkpoint: int = 1
) -> tuple[np.ndarray, np.ndarray, novaphy.solvers.GradientInfo]:
    """Return the last positions, the gradient by the first ones, and the information on it."""
    solver = novaphy.solvers.DiffSemiImplicitSolver(
        model, novaphy.solvers.DiffSolverConfig(contact_gradient="code")
    )
    path = diff.Trajectory(model, STEPS, checkpoint=checkpoint)
    path[0].particle_q.assign(np.float32(q))
    with nova.Tape() as tape:
        solver.rollout(path, None, None, DT, pipeline=novaphy.CollisionPipeline(model))
        last = diff.state_particle_q_tensor(path[STEPS])
        tape.backward(nova.sum(last * nova.tensor(np.repeat(WEIGHTS, len(q), axis=0))))
    return last.numpy(), path[0].particle_q.grad.numpy(), solver.gradient_info()


@pytest.mark.parametrize("shape", ["sphere", "capsule", "ellipsoid", "cone"])
def test_the_normal_turns_with_the_particle(shape):
    model = gliding(shape)
    q = model.particle_q.numpy()
    _, gradient, info = glide(model, q)
    assert (info.label, info.frozen_steps, info.events) == ("exact of the code", 0, 0)
    for k, step in enumerate((1e-4, 1e-4, 2e-5)):
        moved = np.float32([q, q])
        moved[:, 0, k] += (step, -step)
        ends = [glide(model, at)[0].astype(float) for at in moved]
        way = float(moved[0, 0, k]) - float(moved[1, 0, k])
        difference = ((ends[0] - ends[1]) * WEIGHTS).sum() / way
        assert gradient[0, k] == pytest.approx(difference, abs=1e-3 * float(np.abs(gradient).max()))


def test_worlds_and_checkpoints_have_the_bits_of_one_world():
    one, several = gliding("ellipsoid"), gliding("ellipsoid", worlds=3)
    q = one.particle_q.numpy()
    ends, gradient, _ = glide(one, q)
    for interval in (1, 10):
        all_ends, all_gradients, _ = glide(several, np.repeat(q, 3, axis=0), interval)
        np.testing.assert_array_equal(all_ends, np.repeat(ends, 3, axis=0))
        np.testing.assert_array_equal(all_gradients, np.repeat(gradient, 3, axis=0))


def test_the_forward_solver_has_the_same_bits():
    model = gliding("sphere")
    ends, _, _ = glide(model, model.particle_q.numpy())
    path = diff.Trajectory(model, STEPS)
    novaphy.solvers.SolverSemiImplicit(model).rollout(
        path, None, None, DT, pipeline=novaphy.CollisionPipeline(model)
    )
    np.testing.assert_array_equal(path[STEPS].particle_q.numpy(), ends)
