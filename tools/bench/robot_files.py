#!/usr/bin/env python3
"""Report which robot files load, and compare the results with MuJoCo or Pinocchio.
    python tools/bench/robot_files.py FOLDER [--kind mjcf|urdf] [--manifest OUT.json]

FOLDER has one folder for each collection, for example an unpacked wheel of gymnasium or dm-control.
Files with the same content count once. Pieces that other files include do not count. A file counts
as read if add_mjcf or add_urdf, finalize and one step give finite values.

Files that NovaPhy reads with its default options are compared with MuJoCo at random states: masses,
inertias, poses, mass matrix, inverse dynamics, accelerations, forces of joints and actuators, and
pairs of geoms that may touch. URDF files without repaired parts are compared with Pinocchio:
masses, poses, mass matrix, gravity, bias. Errors of accelerations are divided by 1 + 0.02 times the
condition number of the mass matrix. A separate process reads the files, because it may crash or
take too long. Needs mujoco, and pin for URDF.
"""

from __future__ import annotations

import collections
import hashlib
import json
import re
import sys
import warnings

from robot_collections import Worker, finish, read_options, run_files
from robot_forces import note_accelerations, note_forces
from robot_urdf import assembled, compare_urdf

TOLERANCE = 1e-5


# The functions of a worker process.


def read_novaphy(path: str, kind: str, unsupported: str, folders: list[str]):
    import numpy as np

    import novaphy

    builder = novaphy.ModelBuilder()
    add = builder.add_mjcf if kind == "mjcf" else builder.add_urdf
    robot = add(path, unsupported=unsupported, package_dirs=folders)
    model = builder.finalize()
    if model.joint_dof_count:
        solver = novaphy.solvers.SolverFeatherstone(model)
        now, then = model.state(), model.state()
        solver.step(now, then, None, None, 1e-4)
        if not np.isfinite(then.joint_q.numpy()).all():
            raise ValueError("a step that is not finite")
    return robot, model


def work(task: dict) -> dict:
    result: dict = {"novaphy": "", "warn": "", "oracle": "", "difference": {}}
    path, kind, folders = task["path"], task["kind"], task["folders"]
    warnings.simplefilter("ignore")
    robot = model = exact = None
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            robot, model = read_novaphy(path, kind, "error", folders)
        raised = sum("principal moments were raised" in str(w.message) for w in said)
    except Exception as error:
        result["novaphy"] = f"{type(error).__name__}: {error}"
        try:
            read_novaphy(path, kind, "warn", folders)
        except Exception as second:
            result["warn"] = f"{type(second).__name__}: {second}"
    try:
        if kind == "mjcf":
            import mujoco

            exact = mujoco.MjModel.from_xml_path(path)
        else:
            import pinocchio

            exact = pinocchio.buildModelFromUrdf(path)
    except Exception as error:
        result["oracle"] = f"{type(error).__name__}: {error}"
    if kind == "urdf" and model is not None and exact is not None:
        result["mended"] = len(robot.report.mended) + raised
        result["difference"] = compare_urdf(exact, model, robot)
    if kind == "mjcf" and model is not None and exact is not None:
        result["mended"] = len(robot.report.mended)
        result["difference"] = compare(exact, model, robot)
    return result


def compare(exact, model, robot) -> dict[str, float]:
    """Return the largest relative differences, and the number of pairs that only one engine has."""
    import mujoco
    import numpy as np

    import novaphy

    flags = mujoco.mjtDisableBit
    off = flags.mjDSBL_LIMIT | flags.mjDSBL_FRICTIONLOSS | flags.mjDSBL_EQUALITY
    exact.opt.disableflags |= off
    bodies = [b for b in model.body_label if not is_between(b, robot.joints)]
    worst: dict[str, float] = collections.defaultdict(float)
    if len(bodies) != exact.nbody - 1:
        return {"bodies": abs(len(bodies) - exact.nbody + 1)}
    index = {label: k for k, label in enumerate(model.body_label)}
    rows = [index[b] for b in bodies]
    pairs = pairs_of_mujoco(exact)
    exact.opt.disableflags |= flags.mjDSBL_CONTACT

    def note(what: str, got, expected, least: float = 1e-12) -> None:
        got, expected = np.asarray(got, float), np.asarray(expected, float)
        scale = max(np.abs(expected).max(initial=0.0), least)
        error = np.abs(got - expected).max(initial=0.0) / scale
        worst[what] = max(worst[what], float(error if np.isfinite(error) else np.inf))

    mass = model.body_mass.numpy()
    # The inertia of a welded body is added to the body that carries it.
    weld = exact.body_weldid[1:]
    groups = np.unique(weld[weld > 0])
    sums = [[of[weld == g].sum() for g in groups] for of in (mass[rows], exact.body_mass[1:])]
    note("mass", *sums)
    alike = np.isclose(mass[rows], exact.body_mass[1:], rtol=1e-5) & (exact.body_mass[1:] > 0)
    data = mujoco.MjData(exact)
    state = model.state()
    coordinates = model.joint_q_start.numpy()[:-1]
    draw = np.random.default_rng(0)
    com = model.body_com.numpy().astype(float)
    inertia = model.body_inertia.numpy().astype(float)
    for _ in range(4):
        q, t = [], []
        mujoco.mj_resetData(exact, data)
        data.qvel[:] = draw.normal(size=exact.nv)
        for body in range(1, exact.nbody):
            if exact.body_mocapid[body] >= 0:
                k = exact.body_mocapid[body]
                q += [*data.mocap_pos[k], *np.roll(data.mocap_quat[k], -1)]
                t.append(None)
                continue
            for j in range(
                exact.body_jntadr[body], exact.body_jntadr[body] + exact.body_jntnum[body]
            ):
                a, d = exact.jnt_qposadr[j], exact.jnt_dofadr[j]
                kind = exact.jnt_type[j]
                if kind <= 1:
                    quat = draw.normal(size=4)
                    quat /= np.linalg.norm(quat)
                    turn = np.zeros(9)
                    mujoco.mju_quat2Mat(turn, quat)
                    turn = turn.reshape(3, 3)
                if kind == 0:
                    row = int(np.flatnonzero(coordinates == len(q))[-1])
                    data.qpos[a : a + 3] = draw.uniform(-1, 1, 3)
                    data.qpos[a + 3 : a + 7] = quat
                    q += [*data.qpos[a : a + 3], *np.roll(quat, -1)]
                    arm = turn @ com[rows[body - 1]]
                    if model.joint_type.numpy()[row] != novaphy.JointType.FREE:
                        arm = 0 * arm  # slides and a ball joint, about the origin
                    block = np.zeros((6, 6))
                    block[:3, :3] = np.eye(3)
                    block[:3, 3:] = -cross_matrix(arm) @ turn
                    block[3:, 3:] = turn
                    w = turn @ data.qvel[d + 3 : d + 6]
                    t.append((d, block, [*np.cross(w, np.cross(w, arm)), 0, 0, 0]))
                elif kind == 1:
                    data.qpos[a : a + 4] = quat
                    q += [*np.roll(quat, -1)]
                    t.append((d, turn, [0, 0, 0]))
                else:
                    data.qpos[a] = draw.uniform(-1, 1)
                    q.append(data.qpos[a])
                    t.append((d, np.eye(1), [0]))
        size = sum(6 if x is None else len(x[1]) for x in t)
        if size != model.joint_dof_count or len(q) != model.joint_coord_count:
            return {"dofs": abs(size - model.joint_dof_count)}
        change, drift = np.zeros((size, exact.nv)), np.zeros(size)
        at = 0
        ours = []  # NovaPhy's rows that MuJoCo also has
        for x in t:
            if x is None:
                at += 6
                continue
            d, block, extra = x
            n = len(block)
            change[at : at + n, d : d + n] = block
            drift[at : at + n] = extra
            ours += range(at, at + n)
            at += n
        acceleration = draw.normal(size=exact.nv)
        state.joint_q.assign(np.float32(q))
        state.joint_qd.assign(np.float32(change @ data.qvel))
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        draw_controls(exact, data, draw)
        mujoco.mj_forward(exact, data)
        pose = state.body_q.numpy().astype(float)
        center, tensor, tensor_exact = [], [], []
        for body, row in enumerate(rows, 1):
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, np.roll(pose[row, 3:], 1))
            turn = turn.reshape(3, 3)
            center.append(pose[row, :3] + turn @ com[row])
            tensor.append(turn @ inertia[row] @ turn.T)
            axes = data.ximat[body].reshape(3, 3)
            tensor_exact.append(axes @ np.diag(exact.body_inertia[body]) @ axes.T)
        if alike.any():
            note("poses", np.array(center)[alike], data.xipos[1:][alike], 0.1)
            note("inertia", np.array(tensor)[alike], np.array(tensor_exact)[alike])
        note("origins", pose[rows, :3], data.xpos[1:], 0.1)
        if not exact.nv:
            break
        note_forces(exact, data, model, robot, state, change, np.array(q), note)
        if exact.nmocap:  # MuJoCo's dynamics ignore kinematic bodies
            continue
        full = np.zeros((exact.nv, exact.nv))
        mujoco.mj_fullM(exact, data, full)
        kinds = novaphy.eval_mass_matrix(model, state)
        note("mass matrix", change.T @ assembled(model, kinds) @ change, full)
        tau = novaphy.eval_inverse_dynamics(
            model, state, np.float32(change @ acceleration + drift)
        ).astype(float)
        tau = change.T @ np.asarray(tau).ravel()
        note("inverse dynamics", tau, full @ acceleration + data.qfrc_bias)
        note_accelerations(model, state, change, drift, full, data.qfrc_bias, draw, note)
    worst["pairs"] = len(pairs ^ pairs_of(model, bodies, exact)) if pairs is not None else 0
    return dict(worst)


def is_between(label: str, joints) -> bool:
    parts = label.split("/")
    return any("/".join(parts[k:]) in joints for k in range(1, len(parts)))


def cross_matrix(v):
    import numpy as np

    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def draw_controls(exact, data, draw) -> None:
    for k in range(exact.nu):
        low, high = exact.actuator_ctrlrange[k] if exact.actuator_ctrllimited[k] else (-1, 1)
        data.ctrl[k] = draw.uniform(low - 0.1, high + 0.1)
    data.act[:] = draw.uniform(-1, 1, exact.na)


def pairs_of_mujoco(m):
    """Return the pairs of geoms that MuJoCo's filters allow, or None for too many pairs."""
    if m.ngeom > 1500:
        return None
    import mujoco

    keep = not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    excluded = {int(s) for s in m.exclude_signature}
    pairs = set()
    bits = mujoco.mjtDisableBit
    if m.opt.disableflags & (bits.mjDSBL_CONTACT | bits.mjDSBL_CONSTRAINT):
        return pairs
    bodies, weld, parent = m.geom_bodyid, m.body_weldid, m.body_parentid
    welds = [int(weld[b]) for b in bodies]
    ups = [int(weld[parent[w]]) for w in welds]
    types, affinities = m.geom_contype.tolist(), m.geom_conaffinity.tolist()
    # Contacts between bodies without degrees of freedom have no effect.
    still = {0} | {b for b in range(m.nbody) if m.body_mocapid[b] >= 0}
    some = [g for g in range(m.ngeom) if types[g] or affinities[g]]
    for i, a in enumerate(some):
        for b in some[i + 1 :]:
            if welds[a] == welds[b] or {welds[a], welds[b]} <= still:
                continue
            if keep and welds[a] and welds[b] and (welds[a] == ups[b] or welds[b] == ups[a]):
                continue
            if not (types[a] & affinities[b] or types[b] & affinities[a]):
                continue
            first, second = sorted((int(bodies[a]), int(bodies[b])))
            if (first << 16) + second in excluded:
                continue
            pairs.add((a, b))
    for k in range(m.npair):
        pairs.add(tuple(sorted((int(m.pair_geom1[k]), int(m.pair_geom2[k])))))
    return pairs


def pairs_of(model, bodies, exact):
    """Return NovaPhy's pairs as geoms of MuJoCo, matched by name or by position in their body."""
    names = {exact.geom(g).name: g for g in range(exact.ngeom) if exact.geom(g).name}
    owner = {b: k for k, b in enumerate(bodies, 1)}
    owner["world"] = 0

    def geom(label: str) -> int:
        if label in names:
            return names[label]
        body, _, k = label.rpartition("/geom_")
        return int(exact.body_geomadr[owner[body]]) + int(k)

    labels = model.shape_label
    return {
        tuple(sorted((geom(labels[a]), geom(labels[b]))))
        for a, b in model.shape_contact_pairs.numpy().tolist()
    }


def worker() -> None:
    for line in sys.stdin:
        task = json.loads(line)
        print("\0" + json.dumps(work(task)), flush=True)


# The main program.


def reason(text: str) -> str:
    """Return an error message without names and numbers, to group messages."""
    text = re.sub(r"^\w+: (add_\w+: )?", "", text)
    text = re.sub(r"^\S*:\d+: ", "", text)
    text = re.sub(r'name="[^"]*"|"[^"]*"|/\S+', "…", text)
    return re.sub(r"[-+]?\d[\d.e+-]*", "#", text)[:110]


def main() -> None:
    args = read_options(__doc__.splitlines()[0])
    if args.worker:
        return worker()
    rows = []
    for collection, path, result in run_files(args, Worker(__file__)):
        rows.append({
            "collection": collection,
            "file": str(path.relative_to(args.folder)),
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
            **result,
        })  # fmt: skip
    finish(args, rows, table)


def table(rows: list[dict], kind: str) -> None:
    oracle = "MuJoCo" if kind == "mjcf" else "Pinocchio"
    print(
        f"| collection | files | {oracle} | NovaPhy of these | left out listed | NovaPhy of all |"
    )
    print("|---|---|---|---|---|---|")
    names = sorted({r["collection"] for r in rows})
    for name in [*names, "all"]:
        mine = [r for r in rows if name in ("all", r["collection"])]
        both = [r for r in mine if not r["oracle"]]
        read = sum(not r["novaphy"] for r in both)
        warn = sum(not r["novaphy"] or not r["warn"] for r in both)
        print(
            f"| {name} | {len(mine)} | {len(both)} | {read} | {warn} "
            f"| {sum(not r['novaphy'] for r in mine)} |"
        )
    for key, title in (("novaphy", f"Refused, of those that {oracle} reads"),
                       ("warn", 'Refused with unsupported="warn"')):  # fmt: skip
        ranks = collections.Counter(reason(r[key]) for r in rows if r[key] and not r["oracle"])
        print(f"\n{title}:")
        for text, count in ranks.most_common(25):
            print(f"{count:5d}  {text}")
    compared = [r for r in rows if r["difference"] and not (r["mended"] and kind == "urdf")]
    names = sorted({k for r in compared for k in r["difference"]})
    print(f"\nCompared: {len(compared)}. Largest difference, of the largest entry:")
    for name in names:
        values = [(r["difference"].get(name, 0.0), r["file"]) for r in compared]
        bad = sum(v > (0 if name == "pairs" else TOLERANCE) for v, _ in values)
        print(f"{name:18s} worst {max(values)[0]:9.2e}, {bad} files above: {max(values)[1]}")


if __name__ == "__main__":
    main()
