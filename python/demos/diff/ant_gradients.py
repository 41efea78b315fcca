"""Derivatives of frames of a batch of Ants: frozen dynamics, or the exact adjoint.

A frame is simulated once, and its data are stored. Then `pull` computes, from adjoints of the
frame's end, the adjoints of its start and of its forces. Derivatives by a state are derivatives by
tangents {worlds, 14}: the displacement of the torso's center, the rotation about the center (both
in world axes), and the hinge angles; and by the 14 rates.

Frozen frames: in each substep, a change of the velocity passes through the mass matrix, the
damping, the drives and the springs of limits. The result is projected onto the null space of the
normals of pushing contacts. Frozen frames leave out the begin and end of contacts. They also leave
out the derivatives of mass matrix, bias and contact Jacobians by the state. Two optional terms are
added: "sticking" includes the friction of sticking contacts, and "dynamics" includes the
derivatives of mass matrix and bias.

Exact frames: the derivatives are those of DiffFeatherstoneSolver. Its gradient_info has their
label.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

import novaphy
from novaphy import diff, nova
from novaphy.envs import AntWorlds, rotate

DOFS = 14
STICKING = 0.98  # a contact sticks if its friction force is below this part of the Coulomb limit
ROWS_AT_ONCE = 512  # rows (worlds times substeps) computed at once, so that they fit in the cache
SOFTEST = 1e-6  # regularization of dependent rows, relative to the largest diagonal entry


def to_tangent(q: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Convert gradients with respect to coordinates {n, 15} to gradients by tangents {n, 14}."""
    v, w = q[:, 3:6], q[:, 6:7]
    gv, gw = gradient[:, 3:6], gradient[:, 6:7]
    turn = 0.5 * (w * gv + np.cross(v, gv) - gw * v)
    return np.concatenate([gradient[:, :3], turn, gradient[:, 7:]], axis=1)


def to_coordinates(q: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """Convert gradients with respect to tangents {n, 14} to gradients by coordinates {n, 15}.

    The gradient by the quaternion is tangent to the unit sphere.
    """
    e, v, w = tangent[:, 3:6], q[:, 3:6], q[:, 6:7]
    part = 2.0 * (w * e + np.cross(e, v))
    last = -2.0 * (e * v).sum(axis=1, keepdims=True)
    return np.concatenate([tangent[:, :3], part, last, tangent[:, 6:]], axis=1)


class FrozenFrames:
    """Frames of SolverFeatherstone with frozen dynamics."""

    def __init__(self, ants: AntWorlds, terms: Collection[str]) -> None:
        """Prepare the derivatives of a batch of worlds.

        Args:
            ants: the worlds.
            terms: any of "sticking" and "dynamics".
        """
        self.ants = ants
        self.tangents, self.dynamics = "sticking" in terms, "dynamics" in terms
        model = ants.model
        n = self.worlds = ants.num_worlds
        self.damping = model.joint_damping.numpy().reshape(n, DOFS)
        self.lower = model.joint_limit_lower.numpy().reshape(n, DOFS)
        self.upper = model.joint_limit_upper.numpy().reshape(n, DOFS)
        self.ke = model.joint_limit_ke.numpy().reshape(n, DOFS)
        self.kd = model.joint_limit_kd.numpy().reshape(n, DOFS)
        body = model.shape_body.numpy()
        per_world = model.body_count // n
        self.world_of_shape = np.where(body < 0, -1, body // per_world)
        self.link_of_shape = np.where(body < 0, -1, body % per_world)
        self.mu = model.shape_material_mu.numpy()
        self.com = model.body_com.numpy().reshape(n, per_world, 3)
        self.eye = np.eye(DOFS)
        # A function lead(substep), called before each substep to set targets of drives; None: none.
        self.lead = None

    def vary(self, **values: float) -> None:
        """Change parameters of the worlds, with the arguments of AntWorlds.vary."""
        self.ants.vary(**values)
        self.mu = self.ants.model.shape_material_mu.numpy()

    def label(self) -> str:
        """Return a description of the derivative."""
        held = "sticking feet held" if self.tangents else "normals of contacts held"
        return f"frozen, {held}" + (", mass matrix and bias by the state" if self.dynamics else "")

    def run(self, actions: np.ndarray) -> list[tuple[np.ndarray, ...]]:
        """Step one frame with actions {worlds, 8}. Return the data of each substep that `pull`
        needs.
        """
        a, steps = self.ants, []
        forces = a.joint_forces(actions)
        a.control.joint_f.assign(forces.ravel())
        drives = (a.model.joint_target_ke, a.model.joint_target_kd)
        self.drives = [x.numpy().reshape(self.worlds, DOFS) for x in drives]
        by_state = []
        for substep in range(a.substeps):
            if self.lead is not None:
                self.lead(substep)
            a.pipeline.collide(a.state, a.contacts)
            before = (
                a.q,
                novaphy.eval_mass_matrix(a.model, a.state),
                novaphy.eval_jacobian(a.model, a.state),
                a.state.body_q.numpy().reshape(self.worlds, -1, 7),
            )
            a.solver.step(a.state, a._after, a.control, a.contacts, a.dt)
            a.state, a._after = a._after, a.state
            steps.append((*before, self.pushes()))
            by_state.append(self.by_state())
        a.frame += 1
        kept, most = [], max(1, ROWS_AT_ONCE // self.worlds)
        for k in range(0, len(steps), most):  # in batches, because calls of NumPy are expensive
            kept += self.linearized(*zip(*steps[k : k + most], strict=True))
        return [(*x, y) for x, y in zip(kept, by_state, strict=True)]

    def by_state(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the derivatives of (mass matrix times acceleration + bias) in the last step.

        The two arrays {worlds, 14, 14} are derivatives by tangents and by rates. The result is None
        without the term "dynamics".
        """
        if not self.dynamics:
            return None
        a = self.ants
        qdd = (a.state.joint_qd.numpy() - a._after.joint_qd.numpy()) / np.float32(a.dt)
        by_q, by_qd, _ = novaphy.eval_inverse_dynamics_derivatives(a.model, a._after, qdd)
        return by_q.astype(np.float64), by_qd.astype(np.float64)

    def linearized(self, q, mass, jacobian, poses, pushes) -> list[tuple[np.ndarray, ...]]:
        """Return the matrices of the linearized substeps, four arrays {worlds, 14, 14} per substep.

        The arrays are the inverse of the matrix of the implicit step, the stiffness, the damping,
        and the transposed projection onto the null space of the contacts.
        """
        dt, shape = self.ants.dt, (len(q), self.worlds)
        x = np.stack(q)
        outside = np.zeros((*shape, DOFS), bool)
        hinges = x[..., 7:]
        outside[..., 6:] = (hinges < self.lower[:, 6:]) | (hinges > self.upper[:, 6:])
        k = (self.drives[0] + np.where(outside, self.ke, 0.0)).astype(np.float64)
        d = self.drives[1] + self.damping + np.where(outside, self.kd, 0.0).astype(np.float64)
        matrix = np.stack(mass).astype(np.float64)
        np.einsum("...ii->...i", matrix)[...] += dt * d + dt * dt * k
        inverse = np.linalg.inv(matrix)
        rows = self.rows(np.stack(jacobian), np.stack(poses), pushes)
        y = rows @ inverse
        a = y @ rows.swapaxes(-1, -2)
        diagonal = np.einsum("...ii->...i", a)
        diagonal += np.where(diagonal > 0.0, SOFTEST * diagonal.max(axis=-1, keepdims=True), 1.0)
        back = self.eye - rows.swapaxes(-1, -2) @ np.linalg.solve(a, y)
        return list(zip(inverse, k, d, back, strict=True))

    def pushes(self) -> tuple[np.ndarray, ...]:
        """Return six arrays with one entry for each pushing contact.

        The arrays are the world, the link of the Ant, the contact point (m, link frame), the margin
        (m), the normal, and whether the contact sticks.
        """
        c = self.ants.contacts
        count = int(c.rigid_contact_count.numpy()[0])
        force, normal = (
            x.numpy()[:count].astype(np.float64)
            for x in (c.rigid_contact_force, c.rigid_contact_normal)
        )
        push = np.abs((force * normal).sum(axis=1))
        i = np.flatnonzero(push > 0.0)
        force, normal, push = force[i], normal[i], push[i]
        shapes = np.stack([c.rigid_contact_shape0.numpy()[i], c.rigid_contact_shape1.numpy()[i]])
        side = self.link_of_shape[shapes[1]] >= 0  # whether shape 1 (not shape 0) is on the Ant
        shape = np.where(side, shapes[1], shapes[0])
        point = np.where(
            side[:, None], c.rigid_contact_point1.numpy()[i], c.rigid_contact_point0.numpy()[i]
        )
        margin = np.where(
            side, c.rigid_contact_margin1.numpy()[i], c.rigid_contact_margin0.numpy()[i]
        )
        sticks = np.zeros(len(i), bool)
        if self.tangents:
            slip = force - (force * normal).sum(axis=1, keepdims=True) * normal
            limit = 0.5 * (self.mu[shapes[0]] + self.mu[shapes[1]]) * push
            sticks = (slip**2).sum(axis=1) < (STICKING * limit) ** 2
        return self.world_of_shape[shape], self.link_of_shape[shape], point, margin, normal, sticks

    def rows(self, jacobian: np.ndarray, poses: np.ndarray, pushes) -> np.ndarray:
        """Return the constraint rows of the pushing contacts {substeps, worlds, most, 14}, padded
        with 0.
        """
        shape, n = poses.shape[:2], self.worlds
        substep = np.repeat(np.arange(shape[0]), [len(x[0]) for x in pushes])
        parts = (np.concatenate(x) for x in zip(*pushes, strict=True))
        world, link, point, margin, normal, sticks = parts
        if not len(world):
            return np.zeros((*shape, 1, DOFS))
        pose = poses[substep, world, link].astype(np.float64)
        # The vector from the center of mass to the surface point.
        arm = rotate(pose[:, 3:], point - self.com[world, link])
        arm[:, 2] -= margin
        one = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
        one /= np.sqrt((one**2).sum(axis=1, keepdims=True))
        axes = np.stack([normal, one, np.cross(normal, one)], axis=1)  # {n, 3 rows, 3}
        links = jacobian.reshape(*shape, -1, 6, DOFS)[substep, world, link].astype(np.float64)
        j = np.concatenate([axes, np.cross(arm[:, None], axes)], axis=2) @ links
        contact, axis = np.nonzero(np.stack([np.ones_like(sticks), sticks, sticks], axis=1))
        batch = (substep * n + world)[contact]
        slot = np.zeros(len(batch), int)  # the index of a row in its world
        order = np.argsort(batch, kind="stable")
        first = np.searchsorted(batch[order], batch[order])
        slot[order] = np.arange(len(batch)) - first
        rows = np.zeros((shape[0] * n, slot.max() + 1, DOFS))
        rows[batch, slot] = j[contact, axis]
        return rows.reshape(*shape, -1, DOFS)

    def pull(self, kept, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute adjoints at the start of a frame from m adjoints g {worlds, m, 28} at its end.

        Return the adjoints of tangents and rates at the start {worlds, m, 28}, and the adjoints of
        joint_f {worlds, m, 14}.
        """
        dt = self.ants.dt
        g_q, g_v = g[..., :DOFS].astype(np.float64), g[..., DOFS:].astype(np.float64)
        g_f = np.zeros_like(g_v)
        for inverse, k, d, back, by_state in reversed(kept):
            g_star = (g_v + dt * g_q) @ back.transpose(0, 2, 1)
            force = dt * (g_star @ inverse)
            g_f += force
            g_q = g_q - k[:, None] * force
            g_v = g_star - (d + dt * k)[:, None] * force
            if by_state is not None:
                g_q, g_v = (g - force @ by for g, by in zip((g_q, g_v), by_state, strict=True))
        return np.concatenate([g_q, g_v], axis=-1), g_f


class ExactFrames:
    """Frames of DiffFeatherstoneSolver, with the adjoint of every step."""

    def __init__(self, ants: AntWorlds) -> None:
        """Prepare a differentiable solver for a batch of worlds. Frames overwrite ants.state."""
        self.ants, self.worlds = ants, ants.num_worlds
        # In some steps the sweeps do not converge, because feet alternate between sliding and
        # sticking. Such a step must not stop the training. `label` reports how many steps are
        # exact.
        self.solver = novaphy.solvers.DiffFeatherstoneSolver(
            ants.model, **ants.solver_options, allow_unconverged=True, contact_gradient="code"
        )
        self.lead = None  # as in FrozenFrames, but called once per frame, for its middle substep

    def vary(self, **values: float) -> None:
        """Change parameters of the worlds, with the arguments of AntWorlds.vary."""
        self.ants.vary(**values)

    def label(self) -> str:
        """Return a description of the derivative."""
        info = self.solver.gradient_info()
        return (
            f"{info['label']} ({info['exact_steps']} of {info['steps']} steps are, "
            f"{info['contact_steps']} have contacts; {info['events']} events)"
        )

    def run(self, actions: np.ndarray):
        """Step one frame with actions {worlds, 8}. Return the data that `pull` needs."""
        kept = [self.ants.q, self.ants.qd, np.array(actions), None, None]
        kept[3:] = self.record(kept)
        kept.append(self.ants.q)
        self.ants.frame += 1
        return kept

    def record(self, kept):
        """Record one frame on a tape. The end of the frame becomes the state of the worlds.

        Return (tape, end) and the arrays that carry gradients: joint_q, joint_qd, joint_f.
        """
        a = self.ants
        trajectory, control = diff.Trajectory(a.model, a.substeps), a.model.control()
        control.joint_f.assign(a.joint_forces(kept[2]).ravel())
        control.joint_f.requires_grad = True
        if self.lead is not None:
            self.lead(a.substeps // 2)
        for name in ("joint_target_q", "joint_target_qd"):
            getattr(control, name).assign(getattr(a.control, name))
        first, last = trajectory[0], trajectory[a.substeps]
        first.joint_q.assign(kept[0].ravel())
        first.joint_qd.assign(kept[1].ravel())
        novaphy.eval_fk(a.model, first.joint_q, first.joint_qd, first)
        first.joint_q.requires_grad = first.joint_qd.requires_grad = True
        tape = nova.Tape()
        with tape:
            self.solver.rollout(trajectory, control, None, a.dt, pipeline=a.pipeline)
            end = nova.concat([diff.state_joint_q_tensor(last), diff.state_joint_qd_tensor(last)])
        for name in ("joint_q", "joint_qd", "body_q", "body_qd"):
            getattr(a.state, name).assign(getattr(last, name))
        return (tape, end), (first.joint_q, first.joint_qd, control.joint_f)

    def pull(self, kept, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return adjoints as FrozenFrames.pull does. Each of the m adjoints is a backward pass."""
        start, _, _, recorded, arrays, end = kept
        states, forces = [], []
        for m in range(g.shape[1]):
            for x in arrays if m > 0 else ():
                x.grad.zero_()
            seed = (to_coordinates(end, g[:, m, :DOFS]), g[:, m, DOFS:])
            recorded[0].backward(
                recorded[1], nova.tensor(np.concatenate([np.float32(s).ravel() for s in seed]))
            )
            g_q, g_qd, g_f = (
                x.grad.numpy().reshape(self.worlds, -1).astype(np.float64) for x in arrays
            )
            states.append(np.concatenate([to_tangent(start, g_q), g_qd], axis=1))
            forces.append(g_f)
        return np.stack(states, axis=1), np.stack(forces, axis=1)


def frame_jacobians(frames, q: np.ndarray, qd: np.ndarray, actions: np.ndarray):
    """Simulate a frame from states {worlds, ...}. Return two Jacobians of the state at its end.

    The Jacobian by the state at the start is {worlds, 28, 28}, and the Jacobian by the actions is
    {worlds, 28, 8}. The 28 numbers of a state are tangents and rates.
    """
    ants = frames.ants
    ants.set_state(q, qd)
    kept = frames.run(actions)
    eye = np.broadcast_to(np.eye(2 * DOFS), (ants.num_worlds, 2 * DOFS, 2 * DOFS))
    by_state, by_force = frames.pull(kept, eye)
    gear = ants.gear * ants.varied["gear"][:, None]
    return by_state, by_force[..., 6 + np.array(ants.hinge_of_action)] * gear


def make_frames(
    ants: AntWorlds, kind: str, terms: Collection[str] = ("sticking",)
) -> FrozenFrames | ExactFrames:
    """Return the frames of a kind: "frozen", with optional terms, or "exact"."""
    return ExactFrames(ants) if kind == "exact" else FrozenFrames(ants, terms)
