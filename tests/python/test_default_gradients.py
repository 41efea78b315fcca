"""The default contact_gradient: that of the motion where it is supported, else that of the code."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

STEPS, DT = 48, 1 / 480


class Result(NamedTuple):
    """The end of a rollout, its gradient and tangent by the first velocity, and the report."""

    end: np.ndarray
    gradient: np.ndarray
    tangent: np.ndarray
    info: novaphy.solvers.GradientInfo

    def has_bits_of(self, other: Result) -> bool:
        return all(np.array_equal(a, b) for a, b in zip(self[:3], other[:3], strict=True))


def ball(kind: str) -> novaphy.Model:
    """A ball that meets the ground after 0.03 s and leaves it."""
    law = {"restitution": 0.6} if kind == "tree" else {"ke": 4e4, "kd": 0.0}
    surface = novaphy.ShapeConfig(mu=0.0, density=500.0, gap=0.05, **law)
    builder = novaphy.ModelBuilder()
    if kind == "particle":
        builder.add_particle(pos=(0, 0, 0.13), vel=(0, 0, -1), mass=1.0, radius=0.1)
    else:
        body = builder.add_body(xform=((0, 0, 0.13), (0, 0, 0, 1)))
        builder.add_shape_sphere(body, radius=0.1, cfg=surface)
        builder.joint_qd[2], builder.body_qd[0] = -1.0, (0, 0, -1, 0, 0, 0)
    builder.add_ground_plane(cfg=surface)
    return builder.finalize(requires_grad=True)


def run(
    model: novaphy.Model, solver: novaphy.solvers.SolverBase, captured: bool, interval: int = 1
) -> Result:
    """A rollout, and the derivatives of the height at its end."""
    from novaphy import diff, nova

    kind = "joint" if isinstance(solver, novaphy.solvers.DiffFeatherstoneSolver) else "body"
    kind = kind if model.body_count > 0 else "particle"
    path = diff.Trajectory(model, STEPS, checkpoint=interval)
    place = getattr(diff, f"state_{kind}_q_tensor")
    rate = getattr(diff, f"state_{kind}_qd_tensor")(path[0], requires_grad=True)
    static = solver.config.enable_static_contacts if kind != "joint" else False
    pipeline = None if static else novaphy.CollisionPipeline(model)
    found = {}

    def iterate() -> None:
        with nova.Tape() as tape:
            solver.rollout(path, None, None, DT, pipeline=pipeline)
            end = place(path[STEPS]).reshape(-1)
            found["tangent"] = tape.jvp([end], [rate], [nova.ones(rate.shape)])[0]
            tape.backward(end[2])

    if captured:
        with nova.ScopedCapture() as capture:
            iterate()
        capture.graph.launch()
    else:
        iterate()
    end = place(path[STEPS]).numpy()
    return Result(end, rate.grad.numpy(), found["tangent"].numpy(), solver.gradient_info())


def tree(model: novaphy.Model, **options: object) -> novaphy.solvers.SolverBase:
    overlaps = {} if "compliant_contacts" in options else {"pgs_slop": 0.0, "pgs_erp": 1.0}
    return novaphy.solvers.DiffFeatherstoneSolver(model, **overlaps, **options)


def springs(model: novaphy.Model, **options: object) -> novaphy.solvers.SolverBase:
    config = novaphy.solvers.DiffSolverConfig(**options)
    return novaphy.solvers.DiffSemiImplicitSolver(model, config)


KINDS = {"tree": tree, "body": springs, "particle": springs}


def results(
    kind: str, modes: str, captured: bool = False, interval: int = 1, **options: object
) -> list[Result]:
    make: Callable[..., novaphy.solvers.SolverBase] = KINDS[kind]
    model = ball(kind)
    asked = ({} if mode == "default" else {"contact_gradient": mode} for mode in modes.split())
    return [run(model, make(model, **mode, **options), captured, interval) for mode in asked]


@pytest.mark.parametrize("interval", [1, 7])
@pytest.mark.parametrize("kind", KINDS)
def test_the_default_is_the_derivative_of_the_motion(kind: str, interval: int) -> None:
    default, motion, code = results(kind, "default motion code", interval=interval)
    assert default.has_bits_of(motion)
    assert np.array_equal(default.end, code.end)
    # 1 cm/s more downwards hits earlier and comes back higher; the code holds the step of the hit.
    assert default.gradient.reshape(-1)[2] < 0.0
    assert not np.allclose(default.gradient, code.gradient, rtol=0.1)
    assert (default.info.label, default.info.reason) == (motion.info.label, motion.info.reason)
    assert "held" not in default.info.reason and code.info.label == "exact of the code"


@pytest.mark.parametrize("kind", KINDS)
def test_a_capture_has_the_derivative_of_the_code_and_says_so(kind: str) -> None:
    default, code = results(kind, "default code", captured=True)
    assert default.has_bits_of(code)
    assert default.info.label == code.info.label == "exact of the code"
    assert default.info.events > 0
    assert "constant in steps inside a ScopedCapture" in default.info.reason


@pytest.mark.parametrize(
    ("kind", "options", "text"),
    [
        ("tree", {"compliant_contacts": True}, "with compliant_contacts"),
        ("body", {"enable_static_contacts": True}, "with enable_static_contacts"),
        ("body", {"penalty_law": "mean", "friction_law": "huber"}, 'with penalty_law "mean"'),
        ("particle", {"enable_static_contacts": True}, "with enable_static_contacts"),
    ],
)
def test_options_without_gradients_of_the_motion_have_those_of_the_code(
    kind: str, options: dict, text: str
) -> None:
    default, code = results(kind, "default code", **options)
    assert default.has_bits_of(code)
    assert default.info.label == code.info.label == "exact of the code"
    assert f"constant in steps {text}" in default.info.reason
    with pytest.raises(NotImplementedError, match="motion"):
        results(kind, "motion", **options)


def test_a_capture_lowers_the_label_of_steps_outside_of_it() -> None:
    """One solver: a rollout whose times move, and one in a capture that holds them."""
    model = ball("tree")
    solver = tree(model)
    before = run(model, solver, captured=False).info
    after = run(model, solver, captured=True).info
    assert before.label == "exact of the motion"
    assert after.label == "exact of the code"
    assert "constant in steps inside a ScopedCapture" in after.reason
    solver.clear_gradient_info()
    assert run(model, solver, captured=False).info.label == "exact of the motion"


def test_the_name_of_the_default() -> None:
    assert novaphy.solvers.DiffSolverConfig().contact_gradient == "auto"
    with pytest.raises(ValueError, match='expected "auto", "code" or "motion", got "x"'):
        novaphy.solvers.DiffSolverConfig(contact_gradient="x")


@pytest.mark.parametrize("kind", KINDS)
def test_a_captured_backward_of_steps_outside_has_the_derivative_of_the_code(kind: str) -> None:
    from novaphy import diff, nova

    model = ball(kind)
    name = "joint" if kind == "tree" else kind

    def found(mode: str) -> tuple[list[np.ndarray], str]:
        solver, path = KINDS[kind](model, contact_gradient=mode), diff.Trajectory(model, STEPS)
        rate = getattr(diff, f"state_{name}_qd_tensor")(path[0], requires_grad=True)
        with nova.Tape() as tape:
            solver.rollout(path, None, None, DT, pipeline=novaphy.CollisionPipeline(model))
            end = getattr(diff, f"state_{name}_q_tensor")(path[STEPS]).reshape(-1)[2]
        with nova.ScopedCapture() as capture:
            tangent = tape.jvp([end], [rate], [nova.ones(rate.shape)])[0]
            tape.backward(end)
        capture.graph.launch()
        return [rate.grad.numpy(), tangent.numpy()], solver.gradient_info().label

    default, label = found("auto")
    code = found("code")[0]
    assert label == "exact of the code" and np.abs(code[0]).max() > 0.01
    for mine, theirs in zip(default, code, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-5, atol=1e-6)
    with pytest.raises(NotImplementedError, match='"motion" is not supported by a backward or jvp'):
        found("motion")


def pendulum() -> novaphy.Model:
    builder = novaphy.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=np.eye(3) * 0.1, com=(0.3, 0.0, 0.0))
    hinge = builder.add_joint_revolute(
        -1, link, axis=(0, 1, 0), limit_upper=0.1, limit_ke=1e3, limit_kd=10.0
    )
    builder.add_articulation([hinge])
    return builder.finalize(requires_grad=True)


def test_articulations_without_contacts_have_the_derivative_of_the_code() -> None:
    """The limit of a pendulum begins to push. Its time moves in the gradient of the motion only."""
    from novaphy import diff, nova

    model = pendulum()

    def found(**mode: str) -> tuple[np.ndarray, str]:
        solver, path = tree(model, **mode), diff.Trajectory(model, 100)
        start = diff.state_joint_q_tensor(path[0], requires_grad=True)
        with nova.Tape() as tape:
            solver.rollout(path, None, None, 2e-3)
            tape.backward(diff.state_joint_q_tensor(path[100])[0])
        return start.grad.numpy(), solver.gradient_info().label

    (default, label), (code, _), (motion, _) = (
        found(**mode) for mode in ({}, {"contact_gradient": "code"}, {"contact_gradient": "motion"})
    )
    assert np.array_equal(default, code) and not np.allclose(motion, code, rtol=0.01)
    assert label == "exact of the code"


def test_cloth_has_the_derivative_of_the_code() -> None:
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder()
    builder.add_cloth_grid(
        pos=(0, 0, 0.102), dim_x=2, dim_y=2, cell_x=0.1, cell_y=0.1, mass=0.01,
        particle_radius=0.1, tri_ke=100.0, tri_ka=100.0, tri_kd=0.1,
    )  # fmt: skip
    builder.add_ground_plane()
    model = builder.finalize(requires_grad=True)

    def found(**mode: str) -> tuple[np.ndarray, novaphy.solvers.GradientInfo]:
        solver = springs(model, enable_triangles=True, enable_bending=True, **mode)
        path = diff.Trajectory(model, 40)
        start = diff.state_particle_q_tensor(path[0], requires_grad=True)
        with nova.Tape() as tape:
            solver.rollout(path, None, None, 1e-3, pipeline=novaphy.CollisionPipeline(model))
            tape.backward(nova.sum(diff.state_particle_q_tensor(path[40])))
        return start.grad.numpy(), solver.gradient_info()

    (default, info), (code, _) = found(), found(contact_gradient="code")
    assert np.array_equal(default, code) and info.events > 0
    assert "constant in steps with springs, cloth or soft bodies" in info.reason
