"""A face that slides and spins: the law leaves the push of each of its points open."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")


@pytest.mark.parametrize("spin", [0.0, 0.5, 3.0])
def test_a_box_that_slides_and_spins_is_a_surrogate(spin: float) -> None:
    from novaphy import diff, nova

    is_open = spin > 1.0

    builder = novaphy.ModelBuilder()
    of = novaphy.ShapeConfig(mu=0.3, restitution=0.0, density=0.0, gap=0.03)
    inertia = np.diag([0.01, 0.012, 0.008])
    body = builder.add_body(xform=((0, 0, 0.0795), (0, 0, 0, 1)), mass=1.0, inertia=inertia)
    builder.add_shape_box(body, hx=0.1, hy=0.12, hz=0.08, cfg=of)
    builder.add_ground_plane(cfg=of)
    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model,
        contact_gradient="code",
        angular_damping=0.0,
        pgs_iterations=4000,
        pgs_tolerance=1e-9,
        pgs_slop=0.0,
        pgs_erp=1.0,
    )
    pipeline = novaphy.CollisionPipeline(model)
    weights = np.float32(np.random.default_rng(3).normal(size=6))

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

    start = np.array([0.5, 0.2, -0.3, 0.0, 0.0, spin])
    before = begin(start)
    with nova.Tape() as tape:
        after = run(before)
        loss = nova.sum(diff.state_joint_qd_tensor(after) * nova.tensor(weights))
        tape.backward(loss)
    info = solver.gradient_info()
    ours = before.joint_qd.grad.numpy()

    def value(qd: np.ndarray) -> float:
        return float(run(begin(qd)).joint_qd.numpy() @ weights)

    differences = [(value(start + d) - value(start - d)) / 2e-3 for d in 1e-3 * np.eye(6)]
    error = np.abs(ours - differences).max() / np.abs(differences).max()
    assert info["sliding"] == 4
    assert (error > 0.02) == is_open
    assert info.label == ("surrogate" if is_open else "exact of the code")
    assert ("push of each point" in info.reason) == is_open
