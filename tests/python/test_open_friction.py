"""A face that slides and spins: the law leaves the push of each of its points open."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")


SURFACE = {"mu": 0.4, "restitution": 0.0, "density": 0.0, "gap": 0.03}
CORNERS = [(x, y) for x in (-0.3, 0.32) for y in (-0.2, 0.23)]


def spinning_box(spin: float) -> novaphy.ModelBuilder:
    """Return a box that slides and spins on the ground."""
    builder = novaphy.ModelBuilder()
    of = novaphy.ShapeConfig(mu=0.3, restitution=0.0, density=0.0, gap=0.03)
    inertia = np.diag([0.01, 0.012, 0.008])
    body = builder.add_body(xform=((0, 0, 0.0795), (0, 0, 0, 1)), mass=1.0, inertia=inertia)
    builder.add_shape_box(body, hx=0.1, hy=0.12, hz=0.08, cfg=of)
    builder.add_ground_plane(cfg=of)
    builder.joint_qd[:6] = [0.5, 0.2, -0.3, 0.0, 0.0, spin]
    return builder


def trunk_on_hinges(axis: tuple[float, float, float]) -> novaphy.ModelBuilder:
    """Return a trunk on four hinged bodies: wheels (axis y), or legs that turn about z."""
    builder, of = novaphy.ModelBuilder(), novaphy.ShapeConfig(**SURFACE)
    trunk = builder.add_link(
        xform=((0, 0, 0.2), (0, 0, 0, 1)), mass=2.0, inertia=np.diag([0.05, 0.06, 0.07])
    )
    joints = [builder.add_joint_free(trunk)]
    foot = (0.0, 0.0, 0.0) if axis[1] else (0.07, 0.05, 0.0)
    for x, y in CORNERS:
        wheel = builder.add_link(
            xform=((x, y, 0.0999), (0, 0, 0, 1)), mass=0.2, inertia=1e-3 * np.eye(3)
        )
        joints.append(
            builder.add_joint_revolute(
                trunk, wheel, axis=axis, parent_xform=((x, y, -0.1001), (0, 0, 0, 1))
            )
        )
        builder.add_shape_sphere(wheel, xform=(foot, (0, 0, 0, 1)), radius=0.1, cfg=of)
    builder.add_articulation(joints)
    builder.add_ground_plane(cfg=of)
    builder.joint_qd[:] = [0.9, -0.4, 0.0, 0.0, 0.0, 1.5, 3.0, -2.0, 4.0, 1.0]
    return builder


def feet(order: list[int]) -> novaphy.ModelBuilder:
    """Return a body on four feet that slides and spins, and a ball beside it."""
    builder, of = novaphy.ModelBuilder(), novaphy.ShapeConfig(**SURFACE)
    body = builder.add_body(
        xform=((0, 0, 0.0999), (0, 0, 0, 1)), mass=1.0, inertia=np.diag([0.01, 0.012, 0.015])
    )
    ball = builder.add_body(
        xform=((2, 0, 0.0999), (0, 0, 0, 1)), mass=1.0, inertia=0.004 * np.eye(3)
    )
    for k in order:
        at = (*CORNERS[k], 0.0) if k < 4 else (0.0, 0.0, 0.0)
        of_ball = k == 4
        builder.add_shape_sphere(
            ball if of_ball else body, xform=(at, (0, 0, 0, 1)), radius=0.1, cfg=of
        )
    builder.add_ground_plane(cfg=of)
    builder.joint_qd[:6] = [1.0, 0.3, 0.0, 0.0, 0.0, 3.0]
    return builder


def step_gradient(builder: novaphy.ModelBuilder, seed: int = 1):
    """Return GradientInfo of a step, and the error of its gradient (of its largest entry)."""
    from novaphy import diff, nova

    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model,
        contact_gradient="code",
        angular_damping=0.0,
        pgs_iterations=20000,
        pgs_tolerance=1e-9,
        pgs_slop=0.0,
        pgs_erp=1.0,
    )
    pipeline, start = novaphy.CollisionPipeline(model), model.joint_qd.numpy()
    weights = np.float32(np.random.default_rng(seed).normal(size=start.size))

    def begin(qd: np.ndarray) -> novaphy.SimState:
        before = model.state()
        before.joint_qd.assign(np.float32(qd))
        novaphy.eval_fk(model, before.joint_q, before.joint_qd, before)
        return before

    def run(before: novaphy.SimState) -> novaphy.SimState:
        after, contacts = model.state(), pipeline.contacts()
        pipeline.collide(before, contacts)
        solver.step(before, after, None, contacts, 0.01)
        return after

    before = begin(start)
    with nova.Tape() as tape:
        after = run(before)
        tape.backward(nova.sum(diff.state_joint_qd_tensor(after) * nova.tensor(weights)))
    info, ours = solver.gradient_info(), before.joint_qd.grad.numpy()

    def value(qd: np.ndarray) -> float:
        return float(run(begin(qd)).joint_qd.numpy() @ weights)

    moves = 1e-3 * np.eye(start.size)
    expected = np.array([(value(start + d) - value(start - d)) / 2e-3 for d in moves])
    return info, float(np.abs(ours - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("spin", [0.0, 0.5, 3.0])
def test_a_box_that_slides_and_spins_is_a_surrogate(spin: float) -> None:
    is_open = spin > 1.0
    info, error = step_gradient(spinning_box(spin), seed=3)
    assert info["sliding"] == 4
    assert (error > 0.02) == is_open
    assert info.label == ("surrogate" if is_open else "exact of the code")
    assert ("push of each point" in info.reason) == is_open


@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)], ids=["wheels", "legs"])
def test_hinges_between_contacts_leave_their_pushes_open(axis) -> None:
    info, error = step_gradient(trunk_on_hinges(axis))
    assert info.label == "surrogate" and error > 0.02


def test_the_order_of_shapes_does_not_decide_the_label() -> None:
    for order in ([0, 1, 2, 3, 4], [0, 1, 4, 2, 3], [4, 3, 1, 2, 0]):
        assert step_gradient(feet(order))[0].label == "surrogate", order
    info, error = step_gradient(feet([0, 1, 2, 4]))
    assert info.label == "exact of the code" and error < 0.01
