"""Three scenes whose verdict of diff.certify is known: out of reach, chaotic, and a policy."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from event_task_machines import PushImpulse
from event_task_scenes import UPRIGHT

import novaphy
from novaphy import diff, nova

POLICY_STEPS, POLICY_RATE, SKIP = 120, 120, 4


class Scene(NamedTuple):
    """A loss function of parameters, the parameters of a start, and their scale."""

    name: str
    solver_name: str
    what: str
    losses: Callable[[Any], nova.Tensor]
    theta: Any
    sigma: Any


@cache
def _push(worlds: int) -> PushImpulse:
    task = PushImpulse(worlds, "motion")
    task.steps = 48
    return task


def out_of_reach(theta: nova.Tensor) -> nova.Tensor:
    """Return the losses of a push for 0.1 s, in which the ball does not reach the box."""
    task = _push(theta.shape[0])
    task.path = diff.Trajectory(task.model, task.steps)
    return task.run(theta)


LINK = 0.5  # m


@cache
def _double_pendulum(worlds: int) -> Any:
    one = novaphy.ModelBuilder(gravity=-9.81)
    joints, parent = [], -1
    for _ in range(2):
        link = one.add_link(mass=1.0, inertia=np.eye(3) * 0.01)
        joints.append(
            one.add_joint_revolute(
                parent, link, axis=(0, 1, 0),
                parent_xform=((0.0, 0.0, 0.0 if parent < 0 else -LINK / 2), UPRIGHT),
                child_xform=((0.0, 0.0, LINK / 2), UPRIGHT),
            )
        )  # fmt: skip
        parent = link
    one.add_articulation(joints)
    builder = novaphy.ModelBuilder(gravity=-9.81)
    builder.replicate(one, worlds)
    model = builder.finalize(requires_grad=True)
    return model, novaphy.solvers.DiffFeatherstoneSolver(model, angular_damping=0.0)


def double_pendulum(theta: nova.Tensor) -> nova.Tensor:
    """Return the squared last angle of a double pendulum that starts at the angles theta."""
    worlds, steps = theta.shape[0], 1920
    model, solver = _double_pendulum(worlds)
    path = diff.Trajectory(model, steps)
    diff.state_joint_q_tensor(path[0]).copy_(theta.reshape(2 * worlds))
    solver.rollout(path, None, None, 1 / 240)
    last = diff.state_joint_q_tensor(path[steps]).reshape(worlds, 2)[:, 1]
    return last * last


@cache
def _pendulum(worlds: int) -> Any:
    one = novaphy.ModelBuilder(gravity=-9.81)
    link = one.add_link(mass=1.0, inertia=np.eye(3) * 0.01)
    low = ((0.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0))
    joint = one.add_joint_revolute(-1, link, axis=(0, 1, 0), child_xform=low, damping=0.1)
    one.add_articulation([joint])
    builder = novaphy.ModelBuilder(gravity=-9.81)
    builder.replicate(one, worlds)
    model = builder.finalize(requires_grad=True)
    return model, novaphy.solvers.DiffFeatherstoneSolver(model)


def policy(theta: dict[str, nova.Tensor]) -> nova.Tensor:
    """Return the mean square error of a pendulum that a network holds at 1 rad.

    The network maps angle and rate to a torque. theta has its weights: "inner" {worlds, 4, 3} and
    "outer" {worlds, 4}.
    """
    worlds = theta["inner"].shape[0]
    model, solver = _pendulum(worlds)
    state, loss = model.state(), None
    ones = nova.ones((worlds, 1))
    for _ in range(POLICY_STEPS // SKIP):
        q = diff.state_joint_q_tensor(state).reshape(worlds, 1)
        qd = diff.state_joint_qd_tensor(state).reshape(worlds, 1)
        seen = nova.concat([q - 1.0, qd, ones], axis=1).reshape(worlds, 1, 3)
        hidden = nova.tanh(nova.sum(theta["inner"] * seen, axis=-1))
        control = model.control()
        torque = nova.sum(hidden * theta["outer"], axis=-1)
        diff.control_joint_f_tensor(control).copy_(torque)
        for _ in range(SKIP):
            after = model.state()
            solver.step(state, after, control, None, 1 / POLICY_RATE)
            state = after
        off = diff.state_joint_q_tensor(state) - 1.0
        loss = off * off if loss is None else loss + off * off
    return loss * (SKIP / POLICY_STEPS)


def _weights() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "inner": np.float32(rng.normal(size=(4, 3)) * 0.5),
        "outer": np.float32(rng.normal(size=4)),
    }


SCENES = [
    Scene("out of reach", "Featherstone", '"motion"', out_of_reach, PushImpulse.start, 0.1),
    Scene("double pendulum", "Featherstone", "8 s", double_pendulum, [2.5, 2.0], 0.1),
    Scene("policy", "Featherstone", "16 weights", policy, _weights(), 0.1),
]
