"""Two loops of one solver that alternate: each keeps the times of its joint limits."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

DT, STEPS = 1e-3, 200


def slider() -> novaphy.Model:
    """A slider that moves with 1 m/s to the spring of its limit, 0.1 m ahead."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    link = builder.add_link(mass=1.0, inertia=np.eye(3) * 0.01)
    joint = builder.add_joint_prismatic(
        -1, link, axis=(1, 0, 0), limit_lower=-1.0, limit_upper=0.1, limit_ke=1e3, limit_kd=0.0
    )
    builder.add_articulation([joint])
    return builder.finalize(requires_grad=True)


def slopes(alternate: bool) -> tuple[list[float], list[float], str]:
    """The derivatives of the ends of two loops by their starts, with the end rates (m/s)."""
    from novaphy import diff, nova

    model = slider()
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, angular_damping=0.0, contact_gradient="motion"
    )
    loops = [[model.state() for _ in range(STEPS + 1)] for _ in range(2)]
    for loop, start in zip(loops, (0.0, 0.02), strict=True):
        loop[0].joint_q.assign(np.float32([start]))
        loop[0].joint_qd.assign(np.float32([1.0]))
    order = [(k, loop) for k in range(STEPS) for loop in loops]
    if not alternate:
        order = [(k, loop) for loop in loops for k in range(STEPS)]
    with nova.Tape() as tape:
        for k, loop in order:
            solver.step(loop[k], loop[k + 1], None, None, DT)
        ends = [diff.state_joint_q_tensor(loop[STEPS]) for loop in loops]
        tape.backward(nova.sum(ends[0]) + nova.sum(ends[1]))
    slope = [float(loop[0].joint_q.grad.numpy()[0]) for loop in loops]
    rates = [float(loop[STEPS].joint_qd.numpy()[0]) for loop in loops]
    return slope, rates, solver.gradient_info().label


def test_loops_that_alternate_have_the_gradient_of_loops_in_turn() -> None:
    """A start that is 1 m farther comes back earlier: by the end's rate over that of the start."""
    wanted, rates, label = slopes(alternate=False)
    ours, _, ours_label = slopes(alternate=True)
    np.testing.assert_allclose(wanted, rates, rtol=0.01)
    assert max(rates) < -0.9
    np.testing.assert_array_equal(ours, wanted)
    assert ours_label == label


def test_loops_with_contacts_that_alternate_make_no_claim_about_the_motion() -> None:
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(restitution=0.5, density=0.0, gap=0.05)
    ball = builder.add_body(xform=((0, 0, 0.15), (0, 0, 0, 1)), mass=1.0, inertia=np.eye(3) * 0.004)
    builder.add_shape_sphere(ball, radius=0.1, cfg=surface)
    builder.add_ground_plane(cfg=surface)
    model = builder.finalize(requires_grad=True)
    labels = []
    for alternate in (False, True):
        solver = novaphy.solvers.DiffFeatherstoneSolver(model, pgs_slop=0.0, pgs_erp=1.0)
        pipeline = novaphy.CollisionPipeline(model)
        loops = [[model.state() for _ in range(STEPS + 1)] for _ in range(1 + alternate)]
        with nova.Tape() as tape:
            for k in range(STEPS):
                for loop in loops:
                    contacts = pipeline.contacts()
                    pipeline.collide(loop[k], contacts)
                    solver.step(loop[k], loop[k + 1], None, contacts, DT)
            tape.backward(nova.sum(diff.state_joint_q_tensor(loops[-1][STEPS])))
        labels.append(solver.gradient_info().label)
    assert labels == ["exact of the motion", "exact of the code"]


@pytest.mark.parametrize("thing", ["ball", "slider"])
def test_loops_of_penalty_forces_that_alternate_have_the_gradient_of_the_code(thing: str) -> None:
    """Each loop forgets the contacts and the limits of its last step."""
    from novaphy import diff, nova

    model = slider()
    if thing == "ball":
        builder = novaphy.ModelBuilder()
        surface = novaphy.ShapeConfig(ke=1e4, kd=0.0, mu=0.0, density=0.0, gap=0.05)
        body = builder.add_body(
            xform=((0, 0, 0.12), (0, 0, 0, 1)), mass=1.0, inertia=np.eye(3) * 0.004
        )
        builder.add_shape_sphere(body, radius=0.1, cfg=surface)
        builder.add_ground_plane(cfg=surface)
        model = builder.finalize(requires_grad=True)

    def run(alternate: bool, mode: str) -> tuple[np.ndarray, str]:
        config = novaphy.solvers.DiffSolverConfig(contact_gradient=mode)
        solver = novaphy.solvers.DiffSemiImplicitSolver(model, config)
        pipeline = novaphy.CollisionPipeline(model)
        loops = [[model.state() for _ in range(STEPS + 1)] for _ in range(1 + alternate)]
        for loop in loops:
            loop[0].body_qd.assign(np.float32([[1, 0, 0, 0, 0, 0]]))
        with nova.Tape() as tape:
            for k in range(STEPS):
                for loop in loops:
                    contacts = pipeline.contacts()
                    pipeline.collide(loop[k], contacts)
                    solver.step(loop[k], loop[k + 1], None, contacts, DT)
            end = diff.state_body_q_tensor(loops[-1][STEPS])[0]
            tape.backward(nova.sum(end[:3]))
            label = tape.gradient_info().label
        assert label == solver.gradient_info().label
        return loops[-1][0].body_q.grad.numpy(), label

    code, _ = run(False, "code")
    motion, label = run(False, "auto")
    ours, ours_label = run(True, "auto")
    assert label == ("exact of the motion" if thing == "ball" else "exact of the code")
    assert ours_label == "exact of the code"
    assert (np.abs(motion - code).max() > 0.1) == (thing == "ball")
    np.testing.assert_array_equal(ours, code)
