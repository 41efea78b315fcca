"""linearize: the Jacobians A and B of a step of articulations, dx' = A dx + B du."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._core.diff import (
    control_joint_f_tensor,
    control_joint_target_q_tensor,
    control_joint_target_qd_tensor,
    state_joint_q_tensor,
    state_joint_qd_tensor,
)
from .._core.nova import Tape, zeros_like
from .._core.solvers import DiffFeatherstoneSolver

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._core import Contacts, Control, Model, SimState

_INPUTS = {
    "joint_f": control_joint_f_tensor,
    "joint_target_q": control_joint_target_q_tensor,
    "joint_target_qd": control_joint_target_qd_tensor,
}


def linearize(
    solver: DiffFeatherstoneSolver,
    state: SimState,
    control: Control | None,
    dt: float,
    *,
    contacts: Contacts | None = None,
    inputs: str = "joint_f",
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the Jacobians A, B of a step: dx' = A dx + B du, for all worlds at once.

    The state before the step is x = (q, qd), the state after the step is x', and the input is u.
    A world has n degrees of freedom, so dx has 2 n numbers: dq, then dqd. In dq, a hinge or slider
    has a change of angle or distance (rad, m). A BALL joint has a small rotation r (rad) in the
    joint frame, which changes the quaternion q to q + (r, 0) q / 2. A FREE joint has a displacement
    of its origin (m), then a small rotation.

    Args:
        solver: a DiffFeatherstoneSolver, whose device runs one forward-mode pass per column.
        state: the state x with the forces that act. The function does not write the state.
        control: the control of the step. None: the control of the model.
        dt: the time step (s).
        contacts: the contacts of the state, or None. Their points move with the bodies.
        inputs: the input u: "joint_f" (N or N m), "joint_target_qd" or "joint_target_q".

    Returns:
        A {worlds, 2 n, 2 n} and B {worlds, 2 n, m}, float32, with m numbers of u in a world.

    Raises:
        TypeError: the solver is no DiffFeatherstoneSolver.
        ValueError: an unknown input, or worlds whose joints differ.
    """
    if not isinstance(solver, DiffFeatherstoneSolver):
        raise TypeError(
            f"linearize, solver: expected a DiffFeatherstoneSolver, got {type(solver).__name__}"
        )
    if inputs not in _INPUTS:
        raise ValueError(f"linearize, inputs: expected one of {', '.join(_INPUTS)}, got {inputs!r}")
    model = solver.model
    rows = _Rows(model)
    now, after = state.clone(), model.state()
    now.requires_grad = True
    control = model.control() if control is None else control.clone()
    q, qd = state_joint_q_tensor(now, True), state_joint_qd_tensor(now, True)
    u = _INPUTS[inputs](control, True)
    with Tape() as tape:
        solver.step(now, after, control, contacts, dt)
    of_inputs = [q, qd, u]
    results = [state_joint_q_tensor(after), state_joint_qd_tensor(after)]
    into, back = rows.coordinates(q.numpy()), rows.tangents(results[0].numpy())

    def column(k: int, direction: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the tangents {worlds, 2 n} of the next state along a direction of of_inputs[k]."""
        tangents = [zeros_like(x) for x in of_inputs]
        tangents[k].assign(direction)
        moved_q, moved_qd = (t.numpy() for t in tape.jvp(results, of_inputs, tangents))
        dq = np.einsum("wij,wj->wi", back, moved_q[rows.q])
        return np.concatenate([dq, moved_qd[rows.qd]], axis=1)

    n, columns = rows.qd.shape[1], []
    for k in range(n):
        direction = np.zeros(q.shape, np.float32)
        direction[rows.q] = into[:, :, k]
        columns.append(column(0, direction))
    of_input = rows.q if inputs == "joint_target_q" else rows.qd
    for k, (which, shape) in enumerate([(rows.qd, qd.shape), (of_input, u.shape)], start=1):
        for world_rows in which.T:
            direction = np.zeros(shape, np.float32)
            direction[world_rows] = 1.0
            columns.append(column(k, direction))
    both = np.stack(columns, axis=2).astype(np.float32)
    return both[:, :, : 2 * n], both[:, :, 2 * n :]


class _Rows:
    """Row indices of the coordinates (q) and degrees of freedom (qd) of each world."""

    def __init__(self, model: Model) -> None:
        worlds = model.joint_world.numpy()
        q_start, qd_start = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
        kinds = model.joint_type.numpy()
        joints = [np.flatnonzero(worlds == w) for w in np.unique(worlds)]
        shape = [
            [(kinds[j], q_start[j + 1] - q_start[j], qd_start[j + 1] - qd_start[j]) for j in some]
            for some in joints
        ]
        if any(other != shape[0] for other in shape) or not joints:
            raise ValueError("linearize: expected worlds of the same joints, at least one")

        def rows_of(start: NDArray[np.int32]) -> NDArray[np.int64]:
            """Return the row indices {worlds, count} of the entries of every world's joints."""
            return np.array(
                [[k for j in some for k in range(start[j], start[j + 1])] for some in joints], int
            )

        self.q, self.qd = rows_of(q_start), rows_of(qd_start)
        # For each joint: its first coordinate and first dof in the world, its number of dofs, and
        # the number of dofs before its quaternion.
        self.joints: list[tuple[int, int, int, int]] = []
        at_q = at_qd = 0
        for _kind, coordinates, dofs in shape[0]:
            before = dofs if coordinates == dofs else dofs - 3
            self.joints.append((at_q, at_qd, int(dofs), int(before)))
            at_q, at_qd = at_q + int(coordinates), at_qd + int(dofs)

    def coordinates(self, q: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the derivative of q by the tangents dq, {worlds, coordinates, n}."""
        result = np.zeros((*self.q.shape, self.qd.shape[1]), np.float32)
        for at_q, at_qd, dofs, turn in self.joints:
            for k in range(turn):
                result[:, at_q + k, at_qd + k] = 1.0
            if turn < dofs:
                result[:, at_q + turn : at_q + turn + 4, at_qd + turn : at_qd + turn + 3] = (
                    _half_turns(q[self.q][:, at_q + turn : at_q + turn + 4])
                )
        return result

    def tangents(self, q: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the derivative of the tangents dq by q, {worlds, n, coordinates}."""
        result = self.coordinates(q).transpose(0, 2, 1).copy()
        for at_q, at_qd, dofs, turn in self.joints:
            if turn < dofs:
                # |(r, 0) q / 2| = |r| / 2, so the pseudo-inverse is 4 times the transpose.
                result[:, at_qd + turn : at_qd + turn + 3, at_q + turn : at_q + turn + 4] *= 4.0
        return result


def _half_turns(q: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the matrix {worlds, 4, 3} of r -> (r, 0) q / 2 for unit quaternions xyzw."""
    x, y, z, w = q.T
    return np.float32(0.5) * np.stack(
        [
            np.stack([w, z, -y], axis=1),
            np.stack([-z, w, x], axis=1),
            np.stack([y, -x, w], axis=1),
            np.stack([-x, -y, -z], axis=1),
        ],
        axis=1,
    )
