"""Compare forces of springs, dampers and actuators, and accelerations, with MuJoCo."""

from __future__ import annotations


def note_forces(exact, data, model, robot, state, change, coordinates, note) -> None:
    """Compare the forces of springs, dampers, actuators and gravity compensation."""
    import numpy as np

    import novaphy

    qd = change @ data.qvel
    total = -model.joint_damping.numpy().astype(float) * qd
    stiffness, rest = model.joint_target_ke.numpy(), model.joint_target_q.numpy()
    starts, coords = model.joint_qd_start.numpy(), model.joint_q_start.numpy()
    for j in range(model.joint_count):
        d, n = starts[j], starts[j + 1] - starts[j]
        c, m = coords[j], coords[j + 1] - coords[j]
        if n == m:
            total[d : d + n] += stiffness[d : d + n] * (rest[c : c + n] - coordinates[c : c + n])
        elif n == 3:
            total[d : d + n] += stiffness[d : d + n] * turn_between(
                coordinates[c : c + m], rest[c : c + m].astype(float)
            )
    control = model.control()
    ctrl, act = control.ctrl.numpy(), state.act.numpy()
    names = [exact.actuator(k).name for k in range(exact.nu)]
    forces = {}
    for k, (name, row) in enumerate(sorted(robot.actuators.items(), key=lambda item: item[1])):
        index = names.index(name) if name in names else k
        forces[row] = data.actuator_force[index]
        ctrl[row] = data.ctrl[index]
        if exact.actuator_actnum[index]:
            act[model.actuator_state.numpy()[row]] = data.act[exact.actuator_actadr[index]]
    control.ctrl.assign(ctrl)
    state.act.assign(act)
    ours = novaphy.eval_actuator_forces(model, state, control).astype(float)
    on_dofs = model.actuator_dof.numpy() >= 0
    np.add.at(
        total, model.actuator_dof.numpy()[on_dofs], (model.actuator_gear.numpy() * ours)[on_dofs]
    )
    if not on_dofs.all():
        total += (moments(model, state)[~on_dofs] * ours[~on_dofs, None]).sum(axis=0)
    if not exact.jnt_actfrclimited.any():  # MuJoCo counts these limits as limits of joints
        note("actuators", [ours[row] for row in forces], list(forces.values()))
    total += lifted(model, state)
    note("forces", change.T @ total, data.qfrc_passive - data.qfrc_fluid + data.qfrc_actuator)
    if exact.opt.density > 0 or exact.opt.viscosity > 0:
        note("fluid", dragged(exact, data, model, state, change), data.qfrc_fluid)


def dragged(exact, data, model, state, change, dt=0.125):
    """Return the fluid forces on dofs, as the difference of steps with and without fluid."""
    import mujoco
    import numpy as np

    import novaphy

    names = ("joint_damping", "joint_friction", "joint_f", "joint_target_ke", "joint_target_kd")
    names += ("joint_limit_ke", "joint_limit_kd", "actuator_gain", "actuator_bias")
    names += ("fluid_density", "fluid_viscosity")
    kept = {name: getattr(model, name).numpy().copy() for name in names}
    try:
        for name in names[:-2]:
            getattr(model, name).zero_()
        ends = []
        for factor in (1.0, 0.0):
            for name in names[-2:]:
                getattr(model, name).assign(kept[name] * np.float32(factor))
            after = model.state()
            novaphy.solvers.SolverFeatherstone(model).step(state, after, None, None, dt)
            ends.append(after.joint_qd.numpy().astype(float))
    finally:
        for name, values in kept.items():
            getattr(model, name).assign(values)
    force = np.zeros(exact.nv)
    mujoco.mj_mulM(exact, data, force, np.linalg.solve(change, ends[0] - ends[1]) / dt)
    return force


def note_accelerations(model, state, change, drift, full, bias, draw, note) -> None:
    """Compare accelerations under random forces, relative to the error that float32 allows."""
    import numpy as np

    import novaphy

    force = np.float32(np.linalg.solve(change.T, draw.normal(size=len(full))))
    expected = change @ np.linalg.solve(full, change.T @ force - bias) + drift
    found = np.ravel(novaphy.eval_forward_dynamics(model, state, force)).astype(float)
    allowed = (1.0 + 0.02 * np.linalg.cond(full)) * np.abs(expected).max()
    note("accelerations", np.abs(found - expected).max() / allowed, 0.0, 1.0)


def turn_between(start, end):
    """Return the rotation vector (rad), at most pi long, from one quaternion (xyzw) to another."""
    import numpy as np

    v, w, a, b = end[:3], end[3], -start[:3], start[3]
    sine, cosine = w * a + b * v + np.cross(v, a), w * b - v @ a
    size = np.linalg.norm(sine)
    angle = 2 * np.arctan2(size, abs(cosine)) * (1 if cosine >= 0 else -1)
    return sine * (angle / size if size > 0 else 0.0)


def moments(model, state):
    """Return the moment arms {actuators, dofs}: forces on dofs by a unit force of each actuator."""
    import numpy as np

    import novaphy

    count = model.actuator_count
    given = {
        "gain": np.zeros((count, 3)), "bias": np.tile([0.0, 0.0, 1.0], (count, 1)),
        "force_range": np.tile([-1e10, 1e10], (count, 1)),
    }  # fmt: skip
    kept = {name: getattr(model, f"actuator_{name}").numpy().copy() for name in given}
    rates, columns = state.joint_qd.numpy().copy(), []
    try:
        for name, values in given.items():
            getattr(model, f"actuator_{name}").assign(np.float32(values))
        for unit in np.eye(model.joint_dof_count, dtype=np.float32):
            state.joint_qd.assign(unit)
            columns.append(novaphy.eval_actuator_forces(model, state))
    finally:
        for name, values in kept.items():
            getattr(model, f"actuator_{name}").assign(values)
        state.joint_qd.assign(rates)
    return np.array(columns, float).T


def lifted(model, state):
    """Return the gravity compensation on dofs, as the bias force of masses gravcomp * mass."""
    import novaphy

    mass, rates = model.body_mass.numpy(), state.joint_qd.numpy()
    part = mass * model.body_gravcomp.numpy()
    if not part.any():
        return 0.0
    try:
        model.body_mass.assign(part)
        state.joint_qd.zero_()
        return novaphy.eval_bias(model, state).astype(float)
    finally:
        model.body_mass.assign(mass)
        state.joint_qd.assign(rates)
