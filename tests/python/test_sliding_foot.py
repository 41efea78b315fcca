"""A foot that slides while its leg leans: friction acts against the normal."""

import numpy as np
import pytest

import novaphy

DT = 1 / 480
UPRIGHT = (0, 0, 0, 1)
LEAN = 0.45  # rad
LEG = 0.3  # m, from the hinge to the middle of the foot
RADIUS = 0.04  # m


def machine(mu: float) -> novaphy.Model:
    """Build a body on two slides, and a leg on a hinge whose foot touches the ground."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=mu, density=0, gap=0.05)
    cart = builder.add_link(mass=0.01, inertia=np.eye(3) * 1e-4)
    base = builder.add_link(mass=3.0, inertia=np.eye(3) * 0.01)
    leg = builder.add_link(mass=0.5, inertia=np.eye(3) * 0.003)
    builder.add_articulation(
        [
            builder.add_joint_prismatic(-1, cart, axis=(1, 0, 0)),
            builder.add_joint_prismatic(cart, base, axis=(0, 0, 1)),
            builder.add_joint_revolute(
                base, leg, axis=(0, 1, 0), child_xform=((0, 0, LEG / 2), UPRIGHT)
            ),
        ]
    )
    builder.add_shape_sphere(leg, xform=((0, 0, -LEG / 2), UPRIGHT), radius=RADIUS, cfg=surface)
    builder.add_ground_plane(cfg=surface)
    builder.joint_q = [0.0, RADIUS + LEG * np.cos(LEAN), LEAN]
    return builder.finalize()


def tip_jacobian(lean: float) -> np.ndarray:
    """Return the derivatives of (x, z) of the middle of the foot by x, z, lean."""
    return np.array([[1, 0, -LEG * np.cos(lean)], [0, 1, LEG * np.sin(lean)]])


@pytest.mark.parametrize("mu", [0.5, 1.0, 2.0, 4.0])
def test_the_impulse_is_that_of_the_closed_form_within_the_default_sweeps(mu: float) -> None:
    model = machine(mu)
    solver = novaphy.solvers.SolverFeatherstone(model, pgs_slop=0.0, pgs_erp=1.0)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    free, state, end = model.state(), model.state(), model.state()
    for start in (free, state):
        start.joint_qd[:] = [3.0, -1.0, 0.0]
        novaphy.eval_fk(model, start.joint_q, start.joint_qd, start)
    pipeline.collide(state, contacts)
    solver.step(free, end, None, None, DT)
    before = np.array(end.joint_qd, float)
    solver.step(state, end, None, contacts, DT)
    after = np.array(end.joint_qd, float)

    mass = sum(
        m * j.T @ j
        for m, j in (
            (0.01, np.array([[1.0, 0, 0]])),
            (3.0, np.eye(3)[:2]),
            (0.5, np.array([[1, 0, -LEG / 2 * np.cos(LEAN)], [0, 1, LEG / 2 * np.sin(LEAN)]])),
        )
    )
    mass[2, 2] += 0.003
    # Friction acts at the surface of the foot.
    jacobian = tip_jacobian(LEAN) - np.array([[0, 0, RADIUS], [0, 0, 0]])
    w = jacobian @ np.linalg.solve(mass, jacobian.T)
    push = np.array([-mu, 1.0])  # of a foot that slides to +x, per normal impulse
    against = w[1] @ push
    # Sweeps of one row after the other multiply the error by this ratio: from -0.96 to -7.7.
    assert -mu * w[1, 0] / w[1, 1] > 1.9 * mu
    normal = -(jacobian[1] @ before) / against
    np.testing.assert_allclose(
        after, before + np.linalg.solve(mass, jacobian.T @ push) * normal, rtol=1e-4, atol=1e-4
    )
    assert solver.pgs_residual < 1e-5
    assert (jacobian @ after)[0] > 0  # still slides
