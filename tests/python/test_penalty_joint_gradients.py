"""Penalty joints in DiffSemiImplicitSolver: the forward bits, and every gradient by differences."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import JointDofConfig, JointTargetMode, diff, nova, solvers
from novaphy.testing import assert_same_bits

DT, STEPS = 1 / 200, 4
SOFT = {"joint_attach_ke": 200.0, "joint_attach_kd": 4.0}
TURNED = (0.1, -0.2, 0.3, np.sqrt(1 - 0.14))
DRIVE = {
    "target_ke": 30.0,
    "target_kd": 0.7,
    "target_q": 0.4,
    "target_qd": 0.3,
    "damping": 0.2,
    "actuator_mode": JointTargetMode.POSITION_VELOCITY,
    "effort_limit": 1e3,
}
STOPPED = DRIVE | {"limit_lower": 0.6, "limit_upper": 1.2, "limit_ke": 80.0, "limit_kd": 0.4}
WEAK = DRIVE | {"effort_limit": 0.5}
HINGE = {"axis": (0.6, 0.0, 0.8)}


def dof(axis, **settings):
    return JointDofConfig(axis=axis, **settings)


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
JOINTS = {
    "fixed": lambda b, p, c, **x: b.add_joint_fixed(p, c, **x),
    "revolute": lambda b, p, c, **x: b.add_joint_revolute(p, c, **HINGE, **DRIVE, **x),
    "revolute at its stop": lambda b, p, c, **x: b.add_joint_revolute(
        p, c, **HINGE, **STOPPED, **x
    ),
    "weak revolute": lambda b, p, c, **x: b.add_joint_revolute(p, c, **HINGE, **WEAK, **x),
    "prismatic": lambda b, p, c, **x: b.add_joint_prismatic(p, c, **HINGE, **DRIVE, **x),
    "prismatic at its stop": lambda b, p, c, **x: b.add_joint_prismatic(
        p, c, **HINGE, **STOPPED, **x
    ),
    "ball": lambda b, p, c, **x: b.add_joint_ball(p, c, damping=0.3, **x),
    "distance": lambda b, p, c, **x: b.add_joint_distance(
        p, c, min_distance=0.01, max_distance=0.03, limit_ke=300.0, limit_kd=3.0, **x
    ),
    "d6 of a slide and a turn": lambda b, p, c, **x: b.add_joint_d6(
        p, c, linear_axes=[dof(X, **DRIVE)], angular_axes=[dof(Y, **DRIVE)], **x
    ),
    "d6 of two turns": lambda b, p, c, **x: b.add_joint_d6(
        p, c, angular_axes=[dof(X, **DRIVE), dof(Y, **DRIVE)], **x
    ),
    "d6 of all": lambda b, p, c, **x: b.add_joint_d6(
        p,
        c,
        linear_axes=[dof(X, **DRIVE), dof(Y, **STOPPED), dof(Z, **DRIVE)],
        angular_axes=[dof(X, **DRIVE), dof(Y, **DRIVE), dof(Z, **DRIVE)],
        **x,
    ),
}


def chain(*kinds):
    """A free body, and one after the other on it by these joints, none of them at rest."""
    builder = novaphy.ModelBuilder()
    inertia = np.diag([0.05, 0.06, 0.08])
    last = -1
    joints = []
    for k in range(len(kinds) + 1):
        angle = 0.15 * k
        pose = (0.3 * k, 0.02 * k, 1.0 - 0.03 * k, 0.1 * k, -0.05 * k, np.sin(angle))
        w = np.sqrt(1 - sum(x * x for x in pose[3:]))
        link = builder.add_link(
            xform=(*pose, w), mass=1.0 + 0.3 * k, com=(0.02, 0.01 * k, -0.01), inertia=inertia
        )
        builder.body_qd[link] = (0.2, -0.3, 0.1 * k, 0.5, -0.4 + 0.3 * k, 0.6)
        if last < 0:
            joints.append(builder.add_joint_free(link))
        else:
            joints.append(
                JOINTS[kinds[k - 1]](
                    builder,
                    last,
                    link,
                    parent_xform=(0.13, 0.03, 0.02, *TURNED),
                    child_xform=(-0.12, 0.01, 0.0, *TURNED),
                )
            )
        last = link
    builder.add_articulation(joints)
    builder.joint_f = [0.3 * np.cos(i) for i in range(len(builder.joint_f))]
    return builder.finalize(requires_grad=True)


def run(model, control=None, interval=1):
    """The weighted end of a rollout, {1}."""
    trajectory = diff.Trajectory(model, STEPS, checkpoint=interval)
    config = solvers.DiffSolverConfig(**SOFT)
    solvers.DiffSemiImplicitSolver(model, config).rollout(trajectory, control, None, DT)
    end = trajectory[STEPS]
    loss = None
    for term in (diff.state_body_q_tensor(end), diff.state_body_qd_tensor(end)):
        weights = np.cos(np.arange(term.size, dtype=np.float32) * 1.7).reshape(term.shape)
        part = nova.sum(term * nova.tensor(weights))
        loss = part if loss is None else loss + part
    return loss, trajectory


@pytest.mark.parametrize("kind", JOINTS)
def test_a_rollout_has_the_bits_of_the_forward_solver(kind):
    model = chain(kind, "revolute", kind)
    steps = 120
    ends = []
    for solver in (
        solvers.SolverSemiImplicit(model, **SOFT),
        solvers.DiffSemiImplicitSolver(model, solvers.DiffSolverConfig(**SOFT)),
    ):
        trajectory = diff.Trajectory(model, steps)
        solver.rollout(trajectory, None, None, DT)
        ends.append(trajectory)
    assert_same_bits(ends[1].body_q.numpy(), ends[0].body_q.numpy())
    assert_same_bits(ends[1].body_qd.numpy(), ends[0].body_qd.numpy())
    state, after = model.state(), model.state()
    step = solvers.DiffSemiImplicitSolver(model, solvers.DiffSolverConfig(**SOFT))
    for _ in range(steps):
        step.step(state, after, None, None, DT)
        state, after = after, state
    assert_same_bits(state.body_q.numpy(), ends[0][steps].body_q.numpy())


# The step of the differences for each array of the model.
ARRAYS = {
    "body_q": 2e-3,
    "body_qd": 2e-2,
    "body_mass": 2e-2,
    "body_com": 4e-3,
    "body_inertia": 1e-3,
    "gravity": 2e-1,
    "joint_f": 5e-2,
    "joint_target_q": 2e-2,
    "joint_target_qd": 1e-1,
    "joint_target_ke": 2.0,
    "joint_target_kd": 1e-1,
    "joint_damping": 5e-2,
    "joint_effort_limit": 1e-1,
    "joint_limit_lower": 1e-2,
    "joint_limit_upper": 1e-2,
    "joint_limit_ke": 5.0,
    "joint_limit_kd": 1e-1,
    "joint_X_p": 2e-3,
    "joint_X_c": 2e-3,
    "joint_axis": 8e-4,  # D6 axes must stay perpendicular
}
STATES = ("body_q", "body_qd")


@pytest.mark.parametrize("kind", JOINTS)
def test_every_gradient_equals_the_differences(kind):
    model = chain(kind)
    for name in ARRAYS:
        if name not in STATES:
            getattr(model, name).requires_grad = True
    with nova.Tape() as tape:
        loss, trajectory = run(model)
        tape.backward(loss)
    for name, step in ARRAYS.items():
        array = getattr(model, name)
        if name in STATES:
            gradient = getattr(trajectory[0], name).grad.numpy().reshape(-1)
        else:
            gradient = array.grad.numpy().reshape(-1)
        values = array.numpy()
        limits = np.abs(values) > 1e5  # numbers that stand for no limit
        fd = np.zeros(values.size)
        directions = np.eye(values.size, dtype=np.float32).reshape(-1, *values.shape)
        if name == "body_inertia":  # is symmetric
            directions = directions + directions.transpose(0, 1, 3, 2)
            gradient = (gradient.reshape(values.shape) * directions).reshape(values.size, -1).sum(1)
        for k, direction in enumerate(directions):
            if limits.reshape(-1)[k]:
                continue
            ends = []
            for sign in (1.0, -1.0):
                moved = values + np.float32(sign * step) * direction
                array.assign(moved)
                try:
                    ends.append(run(model)[0].item())
                except NotImplementedError:  # a setting that this joint does not have
                    ends.append(0.0)
            fd[k] = (ends[0] - ends[1]) / (2 * step)
        array.assign(values)
        scale = max(np.abs(fd).max(), 1e-3)
        noise = 4e-7 * abs(loss.item()) / step
        assert np.abs(gradient - fd).max() < 1e-2 * scale + noise, (name, gradient, fd)


ACTS = {
    "revolute": ("joint_target_q", "joint_target_ke", "joint_target_kd", "joint_damping"),
    "revolute at its stop": ("joint_limit_lower", "joint_limit_ke", "joint_limit_kd"),
    "weak revolute": ("joint_effort_limit",),
    "prismatic": ("joint_target_q", "joint_target_qd", "joint_axis"),
    "distance": ("joint_limit_upper", "joint_limit_ke", "joint_limit_kd"),
    "ball": ("joint_damping", "joint_f"),
}


@pytest.mark.parametrize("kind", ACTS)
def test_the_scenes_have_what_they_are_named_for(kind):
    model = chain(kind)
    for name in ACTS[kind]:
        getattr(model, name).requires_grad = True
    with nova.Tape() as tape:
        loss, _ = run(model)
        tape.backward(loss)
    for name in ACTS[kind]:
        assert np.abs(getattr(model, name).grad.numpy()).max() > 1e-5, name


class Controlled:
    """A chain that a control drives, of which everything is made before a capture."""

    names = ("joint_target_q", "joint_target_qd", "joint_f")

    def __init__(self, interval=1):
        self.model = chain("revolute", "ball", "prismatic")
        self.control = self.model.control()
        for name in self.names:
            getattr(self.control, name).requires_grad = True
        self.solver = solvers.DiffSemiImplicitSolver(self.model, solvers.DiffSolverConfig(**SOFT))
        self.trajectory = diff.Trajectory(self.model, STEPS, checkpoint=interval)
        weights = np.cos(np.arange(28, dtype=np.float32)).reshape(4, 7)
        self.weights = nova.tensor(weights)

    def run(self):
        with nova.Tape() as tape:
            self.solver.rollout(self.trajectory, self.control, None, DT)
            end = diff.state_body_q_tensor(self.trajectory[STEPS])
            loss = nova.sum(end * self.weights)
            tape.backward(loss)
        return [loss, *(getattr(self.control, n).grad for n in self.names)]


def test_the_control_has_the_gradients_and_all_paths_the_same_bits():
    expected = [x.numpy() for x in Controlled().run()]
    assert all(x.any() for x in expected)
    for interval in (2, STEPS):
        for got, want in zip(Controlled(interval).run(), expected, strict=True):
            assert_same_bits(got.numpy(), want)
    captured = Controlled()
    with nova.ScopedCapture() as capture:
        results = captured.run()
    capture.graph.launch()
    for got, want in zip(results, expected, strict=True):
        assert_same_bits(got.numpy(), want)


def test_a_controlled_force_alone_moves_a_free_body():
    builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
    builder.add_body(mass=2.0, inertia=np.eye(3))
    model = builder.finalize(requires_grad=True)
    control = model.control()
    solver = solvers.DiffSemiImplicitSolver(model)
    state, after = model.state(), model.state()
    solver.step(state, after, control, None, 0.1)
    assert not after.body_qd.numpy().any()
    control.joint_f.assign(np.float32([0, 0, 4, 0, 0, 0]))
    solver.step(state, after, control, None, 0.1)
    np.testing.assert_allclose(after.body_qd.numpy()[0], [0, 0, 0.2, 0, 0, 0], atol=1e-7)


def test_what_is_not_covered_is_named():
    model = chain("revolute")
    config = solvers.DiffSolverConfig
    with pytest.raises(NotImplementedError, match=r"model.joint_type\[1\].*enable_joints"):
        solvers.DiffSemiImplicitSolver(model, config(enable_joints=False))
    for option in ("joint_attach_ke", "joint_attach_kd", "angular_damping"):
        for bad in (-1.0, np.nan):
            said = f": {option}: expected a finite number >= 0, got {bad:g}"
            with pytest.raises(ValueError, match="DiffSemiImplicitSolver" + said):
                solvers.DiffSemiImplicitSolver(model, config(**{option: bad}))
            with pytest.raises(ValueError, match="^SolverSemiImplicit" + said):
                solvers.SolverSemiImplicit(model, **{option: bad})
    stiff = solvers.DiffSemiImplicitSolver(model, config(joint_attach_ke=1e9))
    with pytest.raises(ValueError, match="dt: expected at most"):
        stiff.step(model.state(), model.state(), None, None, DT)
    model.joint_friction.assign(np.full(model.joint_dof_count, 0.5, np.float32))
    with pytest.raises(NotImplementedError, match="DiffSemiImplicitSolver: model.joint_friction"):
        solvers.DiffSemiImplicitSolver(model)
