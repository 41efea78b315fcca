"""Compare URDF robots with Pinocchio."""

from __future__ import annotations

import collections


def compare_urdf(exact, model, robot) -> dict[str, float]:
    """Compare masses, link poses, mass matrix, gravity and bias at random angles and rates."""
    import numpy as np
    import pinocchio

    import novaphy

    data, worst = exact.createData(), collections.defaultdict(float)

    def note(what: str, got, expected, least: float = 1e-6) -> None:
        got, expected = np.asarray(got, float), np.asarray(expected, float)
        scale = max(np.abs(expected).max(initial=0.0), least)
        worst[what] = max(worst[what], float(np.abs(got - expected).max(initial=0.0) / scale))

    note("mass", model.body_mass.numpy().sum(), sum(i.mass for i in exact.inertias))
    frames = {f.name: k for k, f in enumerate(exact.frames) if f.type == pinocchio.BODY}
    links = sorted(set(frames) & set(robot.links))
    draw = np.random.default_rng(0)
    state = model.state()
    for _ in range(4):
        q, full_q = model.joint_q.numpy(), pinocchio.neutral(exact)
        qd, full_qd = np.zeros(model.joint_dof_count, np.float32), np.zeros(exact.nv)
        ours, theirs = [], []
        for k in range(1, exact.njoints):
            joint, name = exact.joints[k], exact.names[k]
            if joint.nv != 1 or name not in robot.joints:
                return {}  # planar and floating joints use other velocities
            value = draw.uniform(-1, 1)
            q[robot.joint_coords[name]] = value
            full_q[joint.idx_q : joint.idx_q + joint.nq] = (
                [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
            )
            ours.append(robot.joint_dofs[name])
            theirs.append(joint.idx_v)
            qd[ours[-1]] = full_qd[theirs[-1]] = np.float32(draw.normal())
        state.joint_q.assign(q)
        state.joint_qd.zero_()
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        pinocchio.framesForwardKinematics(exact, data, full_q)
        poses = state.body_q.numpy().astype(float)
        places = [
            moved(poses[robot.links[link]], np.float64(robot.link_poses[link])) for link in links
        ]
        note("poses", places, [data.oMf[frames[link]].translation for link in links], 0.1)
        if not ours:
            continue
        full = np.asarray(pinocchio.crba(exact, data, full_q))
        full = np.triu(full) + np.triu(full, 1).T
        gravity = pinocchio.computeGeneralizedGravity(exact, data, full_q)
        armature = np.diag(model.joint_armature.numpy()[ours])
        blocks = assembled(model, novaphy.eval_mass_matrix(model, state))[np.ix_(ours, ours)]
        bias = novaphy.eval_bias(model, state).astype(float).ravel()[ours]
        note("mass matrix", blocks - armature, full[np.ix_(theirs, theirs)])
        note("gravity", bias, gravity[theirs])
        state.joint_qd.assign(qd)
        bias = novaphy.eval_bias(model, state).astype(float).ravel()[ours]
        note("bias", bias, pinocchio.nonLinearEffects(exact, data, full_q, full_qd)[theirs])
    return dict(worst)


def moved(pose, inside):
    """Return the pose of a frame that is fixed to a body (xyzw)."""
    import numpy as np

    v, w, p = pose[3:6], pose[6], inside[:3]
    return pose[:3] + p + 2 * np.cross(v, np.cross(v, p) + w * p)


def assembled(model, blocks):
    import numpy as np

    starts, ends = model.articulation_start.numpy(), model.articulation_end.numpy()
    rows = model.joint_qd_start.numpy()
    full = np.zeros((model.joint_dof_count,) * 2)
    for k in range(len(ends)):
        a, b = rows[starts[k]], rows[ends[k]]
        full[a:b, a:b] = np.asarray(blocks[k])[: b - a, : b - a]
    return full
