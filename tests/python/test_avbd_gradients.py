"""Gradients of steps of rigid bodies in DiffSolverVBD, against closed forms and differences."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from vbd_steps import H

import novaphy
from novaphy import JointTargetMode, diff, nova
from novaphy.solvers import DiffSolverVBD, SolverVBD

TURNED = (0.1, -0.2, 0.3, np.sqrt(1 - 0.14))
HINGE = {"axis": (0.6, 0.0, 0.8)}
DRIVE: dict[str, Any] = {
    "target_ke": 30.0,
    "target_kd": 0.7,
    "target_q": 0.4,
    "target_qd": 0.3,
    "actuator_mode": JointTargetMode.POSITION_VELOCITY,
}
FULL = DRIVE | {"damping": 0.05, "armature": 0.02}
STOP = {"limit_lower": 0.1, "limit_upper": 1.0, "limit_ke": 300.0, "limit_kd": 1.0}
ROD = {"stretch_stiffness": 2e4, "bend_stiffness": 20.0, "bend_damping": 0.2}
JOINTS: dict[str, Callable[..., int]] = {
    "fixed": lambda b, p, c, **x: b.add_joint_fixed(p, c, **x),
    "ball": lambda b, p, c, **x: b.add_joint_ball(p, c, **x),
    "hinge": lambda b, p, c, **x: b.add_joint_revolute(p, c, **HINGE, **x),
    "driven": lambda b, p, c, **x: b.add_joint_revolute(p, c, **HINGE, **FULL, **x),
    "weak": lambda b, p, c, **x: b.add_joint_revolute(
        p, c, **HINGE, **DRIVE, effort_limit=0.5, **x
    ),
    "stuck": lambda b, p, c, **x: b.add_joint_revolute(p, c, **HINGE, friction=20.0, **x),
    "stop": lambda b, p, c, **x: b.add_joint_revolute(p, c, **HINGE, **STOP, **x),
    "slide": lambda b, p, c, **x: b.add_joint_prismatic(p, c, **HINGE, **FULL, friction=0.02, **x),
    "rope": lambda b, p, c, **x: b.add_joint_distance(
        p, c, min_distance=0.01, max_distance=0.03, **x
    ),
}
# The step of the differences of each array. Masses, inertias and materials: relative
# to the value.
STEPS = {
    "body_q": 1e-3,
    "body_qd": 2e-2,
    "body_f": 0.5,
    "gravity": 1.0,
    "body_mass": 0.05,
    "body_inertia": 0.02,
    "joint_f": 0.5,
    "joint_target_q": 0.05,
    "joint_target_qd": 0.5,
    "joint_target_ke": 3.0,
    "joint_target_kd": 0.1,
    "joint_damping": 0.03,
    "joint_armature": 5e-3,
    "joint_friction": 0.01,
    "shape_material_ke": 0.02,
    "shape_material_kd": 0.02,
    "shape_material_mu": 0.02,
}


def add_link(builder: novaphy.ModelBuilder, k: int, **options: Any) -> int:
    x, y, z = 0.05 * k, -0.05 * k, np.sin(0.07 * k)
    turn = (x, y, z, np.sqrt(1 - x * x - y * y - z * z))
    inertia = np.diag([0.05, 0.06, 0.08])
    inertia[0, 1] = inertia[1, 0] = 0.01
    link = builder.add_link(
        xform=((0.3 * k, 0.02 * k, 1 - 0.03 * k), turn),
        mass=1 + 0.3 * k,
        com=(0.02, 0.01 * k, -0.01),
        inertia=inertia,
        **options,
    )
    builder.body_qd[link] = (0.2, -0.3, 0.1 * k, 0.5, -0.4 + 0.3 * k, 0.6)
    return link


def chain_of(*kinds: str, root: str = "free") -> novaphy.ModelBuilder:
    """Bodies that move, one after the other on joints with errors, whose root hangs, is free, or
    moves with its velocity."""
    builder = novaphy.ModelBuilder()
    last = add_link(builder, 0, is_kinematic=root == "kinematic")
    if root == "hangs":
        builder.add_joint_revolute(
            -1,
            last,
            axis=(0, 1, 0),
            parent_xform=((0.1, 0, 1), (0, 0, 0, 1)),
            **FULL,
            friction=0.02,
        )
    else:
        builder.add_joint_free(last)
    for k, kind in enumerate(kinds):
        link = add_link(builder, k + 1)
        frames = {
            "parent_xform": ((0.13, 0.03, 0.02), TURNED),
            "child_xform": ((-0.12, 0.01, 0), TURNED),
        }
        JOINTS[kind](builder, last, link, **frames)
        last = link
    return builder


def four_bars() -> novaphy.ModelBuilder:
    """A closed loop with more hard rows than it needs."""
    builder = novaphy.ModelBuilder()
    places = [(0, 0, 0.25), (0.25, 0, 0.5), (0.5, 0, 0.25)]
    inertia = np.diag([0.02, 0.03, 0.04])
    bars = [
        builder.add_link(xform=(p, (0, 0, 0, 1)), mass=1 + 0.2 * k, inertia=inertia)
        for k, p in enumerate(places)
    ]
    ends: list[tuple[int, tuple, int, tuple, dict]] = [
        (-1, (0, 0, 0), bars[0], (0, 0, -0.25), DRIVE),
        (bars[0], (0, 0, 0.25), bars[1], (-0.25, 0, 0), {}),
        (bars[1], (0.25, 0, 0), bars[2], (0, 0, 0.25), {}),
        (-1, (0.5, 0, 0), bars[2], (0, 0, -0.25), {}),
    ]
    for parent, at_parent, child, at_child, drive in ends:
        builder.add_joint_revolute(
            parent,
            child,
            axis=(0, 1, 0),
            parent_xform=(at_parent, (0, 0, 0, 1)),
            child_xform=(at_child, (0, 0, 0, 1)),
            **drive,
        )
    return builder


def cable() -> novaphy.ModelBuilder:
    builder = novaphy.ModelBuilder()
    points = [(0.2 * k, 0.0, 1.0) for k in range(4)]
    density = novaphy.ShapeConfig(density=1000.0)
    bodies, _ = builder.add_rod(points, radius=0.05, cfg=density, **ROD)
    builder.add_joint_fixed(-1, bodies[0], parent_xform=builder.body_q[bodies[0]])
    return builder


def material(**changes: float) -> novaphy.ShapeConfig:
    return novaphy.ShapeConfig(**{"ke": 1e4, "kd": 0.0, "mu": 0.5, "density": 500.0, **changes})


def on_a_plane(ball: bool = False, speed: tuple = (0.0,) * 6, **changes: float) -> Any:
    """A box or a ball that presses into a plane, and moves."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=material(**changes))
    body = builder.add_body(xform=((0, 0, 0.0985), (0, 0, 0, 1)))
    if ball:
        builder.add_shape_sphere(body, radius=0.1, cfg=material(**changes))
    else:
        builder.add_shape_box(body, hx=0.1, hy=0.08, hz=0.1, cfg=material(**changes))
    builder.body_qd[body] = speed
    return builder


def foot() -> novaphy.ModelBuilder:
    """An arm whose tip rests on a plane."""
    builder = chain_of("driven", root="hangs")
    height = builder.body_q[1][2] - 0.0985
    builder.add_shape_sphere(1, radius=0.1, cfg=material(density=0.0))
    builder.add_ground_plane(height=height, cfg=material())
    return builder


def stack() -> novaphy.ModelBuilder:
    builder = on_a_plane()
    body = builder.add_body(xform=((0.02, 0, 0.297), (0, 0, 0, 1)))
    builder.add_shape_box(body, hx=0.1, hy=0.08, hz=0.1, cfg=material())
    builder.body_qd[body] = (0.5, 0.1, 0, 0, 0, 0)
    return builder


def turned(q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return quaternions {n, 4} after the rotations w {n, 3} (rad) about world axes."""
    angle = np.linalg.norm(w, axis=1, keepdims=True)
    v, s = w * np.sin(angle / 2) / angle, np.cos(angle / 2)
    vector = s * q[:, :3] + q[:, 3:] * v + np.cross(v, q[:, :3])
    return np.concatenate([vector, s * q[:, 3:] - (v * q[:, :3]).sum(1, keepdims=True)], axis=1)


class Problem:
    """The weighted end of a rollout, as a function of every input."""

    def __init__(self, builder: novaphy.ModelBuilder, steps: int, iterations: int) -> None:
        self.model = model = builder.finalize(requires_grad=True)
        self.rng = rng = np.random.default_rng(1)
        self.control = model.control()
        force = self.control.joint_f.numpy()
        hinges = model.joint_type.numpy() == novaphy.JointType.REVOLUTE
        force[model.joint_qd_start.numpy()[:-1][hinges]] = 0.3
        self.control.joint_f.assign(force)
        self.solver = DiffSolverVBD(model, gradient="implicit", iterations=iterations)
        self.trajectory = diff.Trajectory(model, steps)
        start = self.trajectory[0]
        force = rng.normal(size=(model.body_count, 6)).astype(np.float32)
        # Contacts begin and end with larger forces and steps.
        touches = (model.shape_body.numpy() < 0).any()
        self.size = 0.2 if touches else 1.0
        if not touches:
            start.body_f.assign(force)
        self.pipeline = novaphy.CollisionPipeline(model)
        self.contacts = None  # of the start, instead of those of each step
        self.weights = [
            (scale * rng.normal(size=(model.body_count, width))).astype(np.float32)
            for scale, width in ((1.0, 7), (H, 6))
        ]
        of = {"body": start, "joint": self.control}
        self.arrays = {
            name: getattr(of.get(name.split("_")[0], model), name, None) or getattr(model, name)
            for name in STEPS
        }

    def run(self) -> None:
        self.solver.reset()
        pipeline = self.pipeline if self.contacts is None else None
        self.solver.rollout(self.trajectory, self.control, self.contacts, H, pipeline=pipeline)

    def value(self) -> float:
        self.run()
        end = self.trajectory[-1]
        return sum(
            float((array.numpy().astype(float) * w).sum())
            for array, w in zip((end.body_q, end.body_qd), self.weights, strict=True)
        )

    def record(self) -> tuple[nova.Tape, list[nova.Tensor], nova.Tensor]:
        """Return the tape of a rollout, its end, and the loss."""
        for array in self.arrays.values():
            array.requires_grad = True
        with nova.Tape() as tape:
            self.run()
            end = self.trajectory[-1]
            last = [diff.state_body_q_tensor(end), diff.state_body_qd_tensor(end)]
            loss = nova.sum(last[0] * nova.tensor(self.weights[0]))
            loss = loss + nova.sum(last[1] * nova.tensor(self.weights[1]))
        return tape, last, loss

    def backward(self) -> novaphy.GradientInfo:
        tape, _, loss = self.record()
        tape.backward(loss)
        return self.solver.gradient_info()

    def direction(self, name: str, values: np.ndarray) -> np.ndarray:
        """Return a direction along which the input stays valid, and 0 where it is 0."""
        along = self.rng.uniform(0.5, 1.0, values.shape) * self.rng.choice((-1, 1), values.shape)
        if name == "body_q":
            moved = turned(values[:, 3:], 1e-6 * along[:, 3:6])
            along[:, 3:] = (moved - values[:, 3:]) / 1e-6
        if name == "body_inertia":
            along = 0.5 * (along + np.swapaxes(along, 1, 2))
        if name in ("body_mass", "body_inertia") or name.startswith("shape"):
            return along * values
        keeps_zeros = name.startswith("joint") and name != "joint_target_q"
        return along * (values != 0) if keeps_zeros else along

    def compare(self) -> Iterator[tuple[str, float, float, float]]:
        """Yield the name, the derivative, the difference and its rounding for each array."""
        size = float(np.sqrt(sum((w.astype(float) ** 2).sum() for w in self.weights)))
        for name, array in self.arrays.items():
            before = array.numpy().copy()
            values = before.astype(float)
            along = self.direction(name, values)
            if not along.any():
                continue
            ends, step = [], self.size * STEPS[name]
            for sign in (1, -1):
                to = values + sign * step * along
                if name == "body_q":
                    to[:, 3:] /= np.linalg.norm(to[:, 3:], axis=1, keepdims=True)
                array.assign(to.astype(np.float32))
                ends.append(self.value())
            array.assign(before)
            found = float((array.grad.numpy().astype(float) * along).sum())
            difference = (ends[0] - ends[1]) / (2 * step)
            yield name, found, difference, 1e-7 * size / step


SCENES: dict[str, tuple[Callable[[], novaphy.ModelBuilder], int, int]] = {
    "one body": (lambda: chain_of(), 2, 5),
    "a pendulum": (lambda: chain_of(root="hangs"), 5, 10),
    "a chain of 4 with drives": (lambda: chain_of(*3 * ["driven"], root="hangs"), 5, 20),
    "fixed, ball": (lambda: chain_of("fixed", "ball"), 2, 30),
    "slide, rope": (lambda: chain_of("slide", "rope"), 2, 30),
    "stuck, hinge": (lambda: chain_of("stuck", "hinge"), 2, 30),
    "ropes": (lambda: chain_of("rope", "rope"), 3, 10),
    "weak, stop": (lambda: chain_of("weak", "stop"), 2, 30),
    "a kinematic root": (lambda: chain_of("driven", "ball", root="kinematic"), 3, 30),
    "a closed loop": (four_bars, 3, 100),
    "a cable": (cable, 3, 60),
    "a box slides": (lambda: on_a_plane(speed=(2, 0.3, 0, 0, 0, 0.5)), 3, 30),
    "a box with damping": (lambda: on_a_plane(speed=(2, 0.3, 0, 0, 0, 0.5), kd=50.0), 2, 30),
    "a box sticks": (on_a_plane, 3, 60),
    "a ball rolls": (lambda: on_a_plane(ball=True, speed=(1, 0.3, 0, -3, 10, 0.5)), 4, 40),
    "a foot": (foot, 3, 60),
    "a stack": (stack, 1, 200),
}


@pytest.mark.parametrize("name", SCENES)
def test_every_gradient_is_that_of_differences(name: str) -> None:
    build, steps, iterations = SCENES[name]
    problem = Problem(build(), steps, iterations)
    if name == "a stack":
        problem.contacts = problem.pipeline.contacts()
        problem.pipeline.collide(problem.trajectory[0], problem.contacts)
    info = problem.backward()
    assert info.label == ("frozen" if name == "a stack" else "implicit")
    assert info.steps == steps and info.converged
    assert info.primal.relative < 1e-4 and info.linear_residual < 1e-6
    clear = 0
    for array, found, difference, rounding in problem.compare():
        assert abs(found - difference) <= 3e-3 * abs(difference) + 3 * rounding, array
        clear += abs(difference) > 100 * rounding
    assert clear >= 3


@pytest.mark.parametrize("name", SCENES)
def test_a_tangent_is_the_transpose_of_the_adjoint(name: str) -> None:
    build, steps, iterations = SCENES[name]
    problem = Problem(build(), steps, iterations)
    owners = {"body_": ("state", problem.trajectory[0]), "joint": ("control", problem.control)}
    inputs, directions, arrays = [], [], []
    for of, array in problem.arrays.items():
        kind, owner = owners.get(of[:5], ("model", problem.model))
        for prefix, thing in ((kind, owner), ("model", problem.model)):
            view = getattr(diff, f"{prefix}_{of}_tensor", None)
            if view is not None and array.size > 0:
                inputs.append(view(thing, requires_grad=True))
                along = problem.rng.normal(size=inputs[-1].shape) / (1 + abs(array.numpy()).max())
                directions.append(along.astype(np.float32).reshape(inputs[-1].shape))
                arrays.append(array)
                break
    tape, last, loss = problem.record()
    tape.backward(loss)
    assert len(inputs) > 10
    for given, along, array in zip(inputs, directions, arrays, strict=True):
        tangents = tape.jvp(last, [given], [nova.tensor(along)])
        assert problem.solver.gradient_info().converged
        terms = [
            t.numpy().astype(float) * w for t, w in zip(tangents, problem.weights, strict=True)
        ]
        forwards, size = sum(t.sum() for t in terms), sum(np.abs(t).sum() for t in terms)
        backwards = (array.grad.numpy().astype(float).reshape(along.shape) * along).sum()
        assert abs(forwards - backwards) <= 1e-3 * abs(backwards) + 1e-5 * size


def test_a_body_that_cannot_move_has_no_derivative_by_forces() -> None:
    problem = Problem(chain_of("fixed", root="kinematic"), 1, 20)
    assert problem.backward().linear_residual < 1e-6
    assert np.abs(problem.arrays["body_f"].grad.numpy()).max() < 1e-8
    assert np.abs(problem.arrays["body_q"].grad.numpy()).max() > 0.1


def test_a_free_body_has_the_derivatives_of_its_closed_form() -> None:
    """x' = x + h v', v' = v + h (g + f/m): no joint, so the balance is that of inertia alone."""
    builder = novaphy.ModelBuilder()
    builder.add_body(mass=2.0, inertia=np.diag([0.1, 0.1, 0.1]))
    model = builder.finalize(requires_grad=True)
    solver = DiffSolverVBD(model, gradient="implicit")
    before, after = model.state(), model.state()
    before.body_f.assign(np.array([[3.0, 0, 0, 0, 0, 0.2]], np.float32))
    before.body_f.requires_grad = model.body_mass.requires_grad = True
    with nova.Tape() as tape:
        solver.step(before, after, None, None, H)
        pose, speed = diff.state_body_q_tensor(after), diff.state_body_qd_tensor(after)
        loss = nova.sum(pose * nova.tensor(np.array([[1, 0, 0, 0, 0, 0, 0]], np.float32)))
        loss = loss + nova.sum(speed * nova.tensor(np.array([[0, 0, 0, 0, 0, 1]], np.float32)))
    tape.backward(loss)
    assert np.allclose(before.body_f.grad.numpy(), [[H * H / 2, 0, 0, 0, 0, H / 0.1]], rtol=1e-6)
    assert np.allclose(model.body_mass.grad.numpy(), -3 * H * H / 4, rtol=1e-6)
    assert np.allclose(before.body_q.grad.numpy(), [[1, 0, 0, 0, 0, 0, 0]], atol=1e-7)
    assert np.allclose(before.body_qd.grad.numpy(), [[H, 0, 0, 0, 0, 1]], atol=1e-7)


def test_a_step_is_the_solution_that_many_iterations_reach() -> None:
    model = chain_of("driven", "ball", root="hangs").finalize()
    start, after, expected = model.state(), model.state(), model.state()
    solver = DiffSolverVBD(model, gradient="implicit", iterations=1)
    solver.step(start, after, None, None, H)
    SolverVBD(model, iterations=100).step(start, expected, None, None, H)
    assert np.allclose(after.body_q.numpy(), expected.body_q.numpy(), atol=2e-6)
    assert np.allclose(after.body_qd.numpy(), expected.body_qd.numpy(), atol=2e-4)


def test_an_unsolved_step_raises_or_lowers_the_label() -> None:
    few = {"iterations": 1, "newton_iterations": 0}
    problem = Problem(chain_of("driven", "ball", root="hangs"), 1, 1)
    problem.solver = DiffSolverVBD(problem.model, gradient="implicit", **few)
    with pytest.raises(novaphy.Error, match="the step was not solved.* raise iterations"):
        problem.run()
    problem.solver = DiffSolverVBD(
        problem.model, gradient="implicit", allow_unconverged=True, **few
    )
    info = problem.backward()
    assert info.label == "surrogate" and not info.converged and info.primal.relative > 0.01


def test_what_has_no_gradient_is_refused_by_name() -> None:
    model = chain_of("ball").finalize(requires_grad=True)
    with pytest.raises(NotImplementedError, match='gradient: expected "implicit"'):
        DiffSolverVBD(model)
    solver = DiffSolverVBD(model, gradient="implicit", iterations=30)
    before, after = model.state(), model.state()
    with nova.ScopedCapture(), pytest.raises(NotImplementedError, match="no capture"):
        solver.step(before, after, None, None, H)
    model.body_com.requires_grad = True
    with nova.Tape(), pytest.raises(NotImplementedError, match=r"model\.body_com"):
        solver.step(before, after, None, None, H)
    model.body_com.requires_grad = False
    trajectory = diff.Trajectory(model, 4, checkpoint=2)
    with pytest.raises(NotImplementedError, match="checkpoint=1"):
        solver.rollout(trajectory, None, None, H)
    both = chain_of("ball")
    both.add_particle((0, 0, 3), (0, 0, 0), 1.0)
    both.color()
    with pytest.raises(NotImplementedError, match="particle_count 1"):
        DiffSolverVBD(both.finalize(), gradient="implicit")


def test_gradients_have_the_same_bits_for_any_number_of_threads() -> None:
    found, before = [], novaphy.num_threads()
    for threads in (1, 3):
        novaphy.set_num_threads(threads)
        problem = Problem(foot(), 3, 60)
        problem.backward()
        arrays = problem.arrays.values()
        found.append([array.grad.numpy().tobytes() for array in arrays if array.size > 0])
    novaphy.set_num_threads(before)
    assert found[0] == found[1]
