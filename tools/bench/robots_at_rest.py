#!/usr/bin/env python3
"""Measure unwanted motions of robots: in the air, on their feet, at the limits of drives.

For every URDF and MJCF file below FOLDER, on the CPU, the program prints a row of a table. Meshes
of colliders become hulls of at most 32 vertices (--triangles: as in the file).
* rate, force: the largest |joint_qd| (rad/s, m/s) and contact force (N) within 1 s in the air, with
  the default self-collisions, steps of 2 ms and no drives. URDF robots are tested with a fixed root
  and with a free root, and the larger values count.
* creep: the largest displacement of a link (mm) within 60 s. The time begins 5 s after the robot
  was put on the ground, with its joints held by drives. thigh_joint and calf_joint start at 0.8 and
  -1.5 rad. A robot that falls within the 5 s has no value. A robot with fewer than two joints at
  its root (an arm) has a fixed root.
* torque: the largest torque of a drive relative to its effort limit, from inverse dynamics of the
  motion in steps of 0.5 ms. For 1 s stiff drives (2000 N m/rad) pull to new angles every 0.1 s, in
  free space, without limits, friction and damping of joints.

    python tools/bench/robots_at_rest.py robots/
    python tools/bench/robots_at_rest.py robots/ --skip creep
"""

from __future__ import annotations

import argparse
import multiprocessing
import re
import sys
import warnings
from pathlib import Path

import numpy as np

import novaphy

DT, TORQUE_DT = 2e-3, 5e-4  # s
HOME = {"thigh_joint": 0.8, "calf_joint": -1.5}  # rad, by the last part of a joint name
STIFF, STIFF_DAMPING = 2000.0, 20.0
MEASURES = ("air", "creep", "torque")
FREE = {
    "joint_friction": 0.0,
    "joint_damping": 0.0,
    "joint_velocity_limit": 1e9,
    "joint_limit_lower": -1e9,
    "joint_limit_upper": 1e9,
}
LARGEST = {"rate": 50.0, "torque": 1.001}  # upper bounds for a robot without a fault
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
TRIANGLES = "--triangles" in sys.argv


def find_files(folder: Path) -> list[Path]:
    """Return URDF files, and XML files with an element <mujoco>."""
    texts = ((path, path.read_bytes()) for path in folder.rglob("*.xml"))
    mjcf = [path for path, text in texts if b"<mujoco" in text and b"<worldbody" in text]
    return sorted([*folder.rglob("*.urdf"), *mjcf])


class Robot:
    """A robot from a file, at rest in the initial pose of its joints."""

    def __init__(self, path: Path, folder: Path, **options: object):
        self.builder = novaphy.ModelBuilder()
        self.is_urdf = path.suffix == ".urdf"
        if self.is_urdf:
            inside = [p for p in path.parents if p == folder or folder in p.parents]
            inside += folder.parents[:2]
            self.result = self.builder.add_urdf(
                path,
                hide_visuals=True,
                mesh_maxhullvert=None if TRIANGLES else 32,
                mimic="independent",
                package_dirs=inside,
                **options,
            )
        else:
            options.pop("floating", None)
            self.result = self.builder.add_mjcf(path, **options)

    def finalize(self) -> novaphy.Model:
        self.model = self.builder.finalize()
        self.model.actuator_gain.zero_()  # drives hold the joints
        self.model.actuator_bias.zero_()
        self.state, self.after = self.model.state(), self.model.state()
        novaphy.eval_fk(self.model, self.state.joint_q, self.state.joint_qd, self.state)
        return self.model

    def crouch(self) -> None:
        """Bend the legs of a quadruped, before finalize."""
        for name, coord in self.result.joint_coords.items():
            for end, angle in HOME.items():
                if name.endswith(end):
                    self.builder.joint_q[coord] = angle

    def step(self, solver, control=None, contacts=None, dt=DT) -> None:
        solver.step(self.state, self.after, control, contacts, dt)
        self.state, self.after = self.after, self.state

    def hinges(self) -> np.ndarray:
        """Return the dofs of joints with one degree of freedom."""
        starts, dims = self.model.joint_qd_start.numpy(), self.model.joint_dof_dim.numpy()
        return starts[:-1][dims.sum(axis=1) == 1]

    def links(self) -> np.ndarray:
        return self.state.body_q.numpy()[:, :3].astype(float)


def overlaps_of(pipeline, state, contacts) -> int:
    """Return the number of overlapping pairs in the warning of the first collide."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        pipeline.collide(state, contacts)
    found = (re.search(r"(\d+) pairs? of shapes overlap", str(w.message)) for w in said)
    return sum(int(match[1]) for match in found if match)


def in_the_air(path: Path, folder: Path) -> dict[str, float]:
    rate = force = 0.0
    overlaps = 0
    for floating in (False, True):
        robot = Robot(path, folder, floating=floating)
        model = robot.finalize()
        solver, pipeline = (
            novaphy.solvers.SolverFeatherstone(model),
            novaphy.CollisionPipeline(model),
        )
        contacts = pipeline.contacts()
        overlaps = max(overlaps, overlaps_of(pipeline, robot.state, contacts))
        try:
            robot.step(solver, contacts=contacts)
        except novaphy.Error:  # an invalid file, or a free root without mass
            if not floating:
                raise
            break
        try:
            for _ in range(round(1 / DT)):
                pipeline.collide(robot.state, contacts)
                robot.step(solver, contacts=contacts)
                forces = contacts.rigid_contact_force.numpy()
                force = max(force, float(np.linalg.norm(forces, axis=1).max(initial=0.0)))
                rate = max(rate, float(np.abs(robot.state.joint_qd.numpy()).max(initial=0.0)))
                if not (rate < 1e9 and force < 1e18):
                    break
        except (novaphy.Error, ValueError):  # the step fails
            rate = np.inf
        if not robot.is_urdf:
            break
    return {"rate": rate, "force": force, "overlaps": overlaps}


def is_arm(robot: Robot) -> bool:
    """Return whether fewer than two joints have a parent that is welded to the root."""
    model = robot.model
    parent, child = model.joint_parent.numpy(), model.joint_child.numpy()
    fixed = model.joint_type.numpy() == int(novaphy.JointType.FIXED)
    root = {-1} | {int(c) for p, c in zip(parent, child, strict=True) if p < 0}
    for p, c, f in zip(parent, child, fixed, strict=True):  # parents first
        if f and p in root:
            root.add(int(c))
    return sum(p in root and c not in root for p, c in zip(parent, child, strict=True)) < 2


def standing(path: Path, folder: Path) -> dict[str, float]:
    options = {"collapse_fixed_joints": True, "enable_self_collisions": False}
    robot = Robot(path, folder, **options)
    robot.crouch()
    robot.finalize()
    if robot.is_urdf and not is_arm(robot):
        low = lowest_point(robot)
        robot = Robot(path, folder, floating=True, xform=((0, 0, 1e-3 - low), UPRIGHT), **options)
        robot.crouch()
        robot.builder.add_ground_plane(cfg=novaphy.ShapeConfig(mu=0.8))
    model = robot.finalize()
    weight = 9.81 * float(model.body_mass.numpy().sum())
    size = float(np.ptp(robot.links(), axis=0).max(initial=0.0)) + 0.1
    hinges = robot.hinges()
    ke = np.zeros(model.joint_dof_count, np.float32)
    ke[hinges] = 5.0 * weight * size  # sags by about 0.05 rad
    model.joint_target_ke.assign(ke)
    model.joint_target_kd.assign(0.05 * ke)
    mode = model.joint_target_mode.numpy()
    mode[hinges] = int(novaphy.JointTargetMode.POSITION)
    model.joint_target_mode.assign(mode)
    model.joint_target_q.assign(model.joint_q.numpy())
    solver, pipeline = novaphy.solvers.SolverFeatherstone(model), novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()

    def run(seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            pipeline.collide(robot.state, contacts)
            robot.step(solver, contacts=contacts)

    start = robot.state.body_q.numpy()[0].astype(float)
    try:
        run(5.0)
        now = robot.state.body_q.numpy()[0].astype(float)
        turned = 2 * np.arccos(min(1.0, abs(float(start[3:] @ now[3:]))))
        if not turned < 0.3 or not now[2] - start[2] > -size:
            return {"creep": np.nan}
        before = robot.links()
        run(60.0)
    except (novaphy.Error, ValueError):
        return {"creep": np.inf}
    return {"creep": 1e3 * float(np.linalg.norm(robot.links() - before, axis=1).max())}


def lowest_point(robot: Robot) -> float:
    """Return the lowest point of the boxes of colliding shapes (m)."""
    model, poses = robot.model, robot.state.body_q.numpy().astype(float)
    lowest = 0.0
    colliding = model.shape_flags.numpy() & int(novaphy.ShapeFlags.COLLIDE_SHAPES)
    at, lower, upper = (
        a.numpy().astype(float)
        for a in (model.shape_transform, model.shape_aabb_lower, model.shape_aabb_upper)
    )
    for s in np.flatnonzero(colliding):
        body = model.shape_body.numpy()[s]
        corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        points = turn(at[s], lower[s] + corners * (upper[s] - lower[s]))
        lowest = min(lowest, float(turn(poses[body], points)[:, 2].min()))
    return lowest


def turn(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    v, w = pose[3:6], pose[6]
    return pose[:3] + points + 2 * np.cross(v, np.cross(v, points) + w * points)


def at_the_limit(path: Path, folder: Path) -> dict[str, float]:
    robot = Robot(path, folder, collapse_fixed_joints=True, enable_self_collisions=False)
    model = robot.finalize()
    dofs, hinges = model.joint_dof_count, robot.hinges()
    lower, upper = model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy()
    for name, value in FREE.items():
        values = getattr(model, name).numpy()
        values[hinges] = value
        getattr(model, name).assign(values)
    effort = model.joint_effort_limit.numpy()[hinges].astype(float)
    hinges, effort = hinges[effort > 0], effort[effort > 0]
    if len(hinges) == 0:
        return {"torque": np.nan}
    coords = {int(d): int(c) for d, c in zip(
        model.joint_qd_start.numpy()[:-1], model.joint_q_start.numpy()[:-1], strict=True
    )}  # fmt: skip
    rows = [coords[int(d)] for d in hinges]
    gains = np.zeros(dofs, np.float32)
    gains[hinges] = 1.0
    model.joint_target_ke.assign(STIFF * gains)
    model.joint_target_kd.assign(STIFF_DAMPING * gains)
    mode = model.joint_target_mode.numpy()
    mode[hinges] = int(novaphy.JointTargetMode.POSITION)
    model.joint_target_mode.assign(mode)
    solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.0)
    control, draw = model.control(), np.random.default_rng(0)
    low, high = np.clip(lower[hinges], -1.0, 1.0), np.clip(upper[hinges], -1.0, 1.0)
    worst = 0.0
    try:
        for step in range(round(1 / TORQUE_DT)):
            if step % round(0.1 / TORQUE_DT) == 0:
                target = control.joint_target_q.numpy()
                target[rows] = draw.uniform(low, high)
                control.joint_target_q.assign(target)
            before = robot.state.joint_qd.numpy().astype(float)
            robot.step(solver, control, dt=TORQUE_DT)
            change = (robot.state.joint_qd.numpy() - before) / TORQUE_DT
            torque = np.asarray(
                novaphy.eval_inverse_dynamics(model, robot.after, change.astype(np.float32))
            ).ravel()
            worst = max(worst, float((np.abs(torque[hinges]) / effort).max()))
            if not worst < 1e9:
                break
    except (novaphy.Error, ValueError):
        worst = np.inf
    return {"torque": worst}


def measure(path: Path, folder: Path, names: list[str]) -> dict[str, object]:
    what = {"air": in_the_air, "creep": standing, "torque": at_the_limit}
    row: dict[str, object] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in names:
            try:
                row |= what[name](path, folder)
            except Exception as error:  # an invalid file
                row["note"] = str(error).replace("\n", " ").split(f"{path.name}:")[-1].strip()
                break
    return row


def in_a_process(path: Path, folder: Path, names: list[str], seconds: float) -> dict[str, object]:
    """Measure a robot in a separate process. A timeout or crash becomes a note in the row."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    worker = context.Process(target=lambda: there.send(measure(path, folder, names)))
    worker.start()
    there.close()
    try:
        row = here.recv() if here.poll(seconds) else {"note": f"more than {seconds:.0f} s"}
    except EOFError:
        row = {"note": "the process ended"}
    worker.kill()
    worker.join()
    return row


def number(value: object) -> str:
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--skip", nargs="+", choices=MEASURES, default=[])
    parser.add_argument("--triangles", action="store_true", help="meshes do not become hulls")
    parser.add_argument("--seconds", type=float, default=300.0, help="most time for a robot")
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    names = [name for name in MEASURES if name not in arguments.skip]
    columns = ("rate", "force", "overlaps", "creep", "torque", "note")
    print("| file | rate | force (N) | pairs that overlap | creep (mm) | torque by limit | |")
    print("|---|" + "---|" * len(columns))
    rows = []
    for path in find_files(folder):
        row = in_a_process(path, folder, names, arguments.seconds)
        rows.append(row)
        shown = [number(row.get(c)) if c != "note" else str(row.get(c, ""))[:90] for c in columns]
        print(f"| {path.relative_to(folder)} | " + " | ".join(shown) + " |", flush=True)
    counts = [f"{len(rows)} files, {sum('note' not in row for row in rows)} in full"]
    for name, limit in LARGEST.items():
        values = [row[name] for row in rows if name in row]
        counts.append(f"{name} above {limit}: {sum(not v <= limit for v in values if v == v)}")
    creeps = [row["creep"] for row in rows if "creep" in row]
    stands = [c for c in creeps if c == c]
    counts.append(f"{len(stands)} of {len(creeps)} stand, {sum(c > 0.1 for c in stands)} creep")
    print("\n" + "; ".join(counts), file=sys.stderr)


if __name__ == "__main__":
    main()
