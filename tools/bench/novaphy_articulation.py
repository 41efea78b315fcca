#!/usr/bin/env python3
"""Time NovaPhy on articulations, and MuJoCo and Pinocchio, in one process on one thread.

The FR3 arm holds a pose with its drives. The Ant stands under random torques, with contacts that
are found in every step. A time is the processor time of the fastest of several rounds. Peers that
are not installed are left out.

    NOVAPHY_NUM_THREADS=1 python tools/bench/novaphy_articulation.py
    NOVAPHY_NUM_THREADS=1 python tools/bench/novaphy_articulation.py --page

With --humanoid, only Pinocchio's sample humanoid (34 dofs) runs: steps and dynamics functions.

    NOVAPHY_NUM_THREADS=1 python tools/bench/novaphy_articulation.py --humanoid

With --device, prints JSON lines with world-steps per second (wall time, captured) on the device, of
FR3 arms, and of Ants with contacts. A line has a hash of the last joint_q, which is the same as on
the CPU. A further line has a rollout of 20 steps of Ants and its adjoint through contacts, with a
hash of the gradient with respect to the first joint_qd, and the label of the gradient.

    python tools/bench/novaphy_articulation.py --device cuda:0 --worlds 1024 65536
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from run_peers import cpu_name

import novaphy

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "python" / "demos"))
import demo_articulated_scenes  # noqa: E402

DT = 1e-3
TURNS = 7
# The page from this heading on is written by hand.
BY_HAND = "## Goals"
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
POSE = (0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4)
KE, KD = (
    (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0),
    (50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0),
)
# Rounded values of franka_description (Apache-2.0) for each link: joint origin and roll (quarter
# turns), mass, center of mass, and inertia about the center of mass (xx yy zz xy xz yz).
FR3 = (
    (
        (0, 0, 0.333),
        0,
        2.92747,
        (0, -0.018125, -0.038604),
        (0.023927, 0.022482, 0.00635, 0.0000133, -0.000114, -0.001995),
    ),
    (
        (0, 0, 0),
        -1,
        2.93554,
        (0.003183, -0.074322, 0.008815),
        (0.041939, 0.025145, 0.061702, 0.000203, 0.004078, -0.004225),
    ),
    (
        (0, -0.316, 0),
        1,
        2.2449,
        (0.040702, -0.00482, -0.028973),
        (0.024101, 0.019741, 0.019044, 0.002405, -0.002856, -0.002104),
    ),
    (
        (0.0825, 0, 0),
        1,
        2.6156,
        (-0.04591, 0.063049, -0.008519),
        (0.03453, 0.028882, 0.041255, 0.013226, 0.010151, -0.00097),
    ),
    (
        (-0.0825, 0.384, 0),
        -1,
        2.32712,
        (-0.001604, 0.029254, -0.097297),
        (0.05161, 0.047877, 0.016424, -0.005715, -0.003567, 0.010674),
    ),
    (
        (0, 0, 0),
        1,
        1.81704,
        (0.059713, -0.041029, -0.010169),
        (0.005412, 0.014059, 0.016081, 0.006193, 0.001422, -0.001314),
    ),
    (
        (0.088, 0, 0),
        1,
        0.62714,
        (0.004523, 0.008626, -0.016163),
        (
            2.1092389150104718e-4,
            1.7718568002411474e-4,
            5.993190599659971e-5,
            -2.433299114461931e-5,
            4.564480393778983e-5,
            8.744070223226438e-5,
        ),
    ),
)


def matrix(inertia: tuple[float, ...]) -> np.ndarray:
    """Return the symmetric matrix of the inertia (xx, yy, zz, xy, xz, yz)."""
    xx, yy, zz, xy, xz, yz = inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def rolled(roll: int) -> tuple[float, ...]:
    """Return the quaternion of `roll` quarter turns about x."""
    return (np.sin(roll * np.pi / 4), 0.0, 0.0, np.cos(roll * np.pi / 4))


def fastest(run: Callable[[], None], units: int, turns: int = TURNS) -> float:
    """Return the least processor time for each unit of work (microseconds) over several rounds."""
    run()
    times = []
    for _ in range(turns):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return min(times) / units * 1e6


def arm() -> novaphy.ModelBuilder:
    """Build the FR3 with drives."""
    builder = novaphy.ModelBuilder()
    parent, joints = -1, []
    for k, (place, roll, mass, com, inertia) in enumerate(FR3):
        link = builder.add_link(mass=mass, com=com, inertia=matrix(inertia), lock_inertia=True)
        joints.append(
            builder.add_joint_revolute(
                parent,
                link,
                axis=(0.0, 0.0, 1.0),
                parent_xform=(place, rolled(roll)),
                target_ke=KE[k],
                target_kd=KD[k],
            )
        )
        parent = link
    builder.add_articulation(joints)
    builder.joint_q, builder.joint_target_q = list(POSE), list(POSE)
    return builder


def replicated(builder: novaphy.ModelBuilder, worlds: int, device: str = "cpu") -> novaphy.Model:
    """Return a model of `worlds` copies of a builder."""
    if worlds == 1:
        return builder.finalize(device)
    many = novaphy.ModelBuilder()
    many.replicate(builder, worlds, (3.0, 0.0, 0.0))
    return many.finalize(device)


def chain(joints: int) -> novaphy.ModelBuilder:
    """Build a chain of links on hinges."""
    builder = novaphy.ModelBuilder()
    parent, made = -1, []
    for k in range(joints):
        link = builder.add_link(mass=1.0, inertia=np.diag((0.02, 0.02, 0.01)), lock_inertia=True)
        axis = (0.0, 1.0, 0.0) if k % 2 else (1.0, 0.0, 0.0)
        made.append(
            builder.add_joint_revolute(
                parent,
                link,
                axis=axis,
                parent_xform=((0, 0, -0.2), UPRIGHT),
                target_ke=100.0,
                target_kd=10.0,
                armature=0.01,
            )
        )
        parent = link
    builder.add_articulation(made)
    return builder


def time_steps(builder: novaphy.ModelBuilder, worlds: int, steps: int) -> float:
    """Return the time (s) of a step of one world."""
    model = replicated(builder, worlds)
    solver = novaphy.solvers.SolverFeatherstone(model)
    state, after = model.state(), model.state()

    def run() -> None:
        for _ in range(steps // 2):
            solver.step(state, after, None, None, DT)
            solver.step(after, state, None, None, DT)

    return fastest(run, steps * worlds)


def replayed(device: str, pair: Callable[[], None]) -> Callable[[], None]:
    """Return a function that runs two steps. On a device it replays a capture of them."""
    if device == "cpu":
        return pair
    from novaphy import nova

    with nova.ScopedCapture() as capture:
        pair()
    return capture.graph.launch


def time_on(
    device: str, worlds: int, steps: int, reset: Callable[[], None], run: Callable[[], None]
) -> dict[str, object]:
    """Time steps after `reset`, where `run` runs two steps. Return the line of the result."""
    times = []
    for _ in range(TURNS):
        reset()
        novaphy.synchronize(device)
        begin = time.perf_counter()
        for _ in range(steps // 2):
            run()
        novaphy.synchronize(device)
        times.append(time.perf_counter() - begin)
    return {
        "device": novaphy.get_device(device).name,
        "worlds": worlds,
        "world_steps_per_second": round(worlds * steps / min(times)),
    }


def hash_of(state: novaphy.State) -> str:
    """Return the hash of the bits of joint_q."""
    return hashlib.sha256(state.joint_q.numpy().tobytes()).hexdigest()[:16]


def time_device(device: str, worlds: int, steps: int = 100) -> dict[str, object]:
    """Time steps of arms that move to their pose: replayed on devices, direct on the CPU."""
    model = replicated(arm(), worlds, device)
    solver = novaphy.solvers.SolverFeatherstone(model)
    state, after = model.state(), model.state()
    start = np.random.default_rng(0).uniform(-0.1, 0.1, (worlds, 7)) + POSE

    def pair() -> None:
        solver.step(state, after, None, None, DT)
        solver.step(after, state, None, None, DT)

    def reset() -> None:
        state.joint_q.assign(start.ravel().astype(np.float32))
        state.joint_qd.zero_()

    line = time_on(device, worlds, steps, reset, replayed(device, pair))
    solver.check_last_step()
    return {"scene": "FR3", **line, "hash": hash_of(state)}


def time_device_ants(device: str, worlds: int, steps: int = 100) -> dict[str, object]:
    """Time searches and steps of landed Ants under torques, as time_device does."""
    ants = Ants(worlds, device)
    line = time_on(device, worlds, steps, ants.land, ants.run_pair)
    ants.solver.check_last_step()
    assert not ants.contacts.overflowed
    count = {"contacts": round(ants.contact_count, 1)}
    return {"scene": "Ant, collide and step", **line, **count, "hash": hash_of(ants.state)}


def time_device_ant_gradients(device: str, worlds: int, steps: int = 20) -> dict[str, object]:
    """Time a rollout of landed Ants on a device, and its adjoint through contacts."""
    from novaphy import nova
    from novaphy.diff import (
        Trajectory,
        control_joint_f_tensor,
        state_joint_q_tensor,
        state_joint_qd_tensor,
    )

    ants = Ants(worlds, device)
    many = novaphy.ModelBuilder()
    many.replicate(demo_articulated_scenes.build_ant(), worlds, (3.0, 0.0, 0.0))
    model = many.finalize(device, requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, pgs_slop=0.0, pgs_erp=1.0)
    pipeline = novaphy.CollisionPipeline(model)
    trajectory, control = Trajectory(model, steps), model.control()
    control.joint_f.assign(ants.control.joint_f.numpy())
    start = trajectory[0]
    start.joint_q.assign(ants.landed[0])
    start.joint_qd.assign(ants.landed[1])
    novaphy.eval_fk(model, start.joint_q, start.joint_qd, start)
    leaves = (state_joint_qd_tensor(start, True), control_joint_f_tensor(control, True))

    def iteration() -> None:
        with nova.Tape() as tape:
            solver.rollout(trajectory, control, None, DT, pipeline=pipeline)
            end = state_joint_q_tensor(trajectory[steps])
            loss = nova.sum(nova.mul(end, end))
        tape.backward(loss)

    run = replayed(device, iteration)
    times = []
    for _ in range(TURNS):
        for leaf in leaves:
            leaf.zero_grad()
        novaphy.synchronize(device)
        begin = time.perf_counter()
        run()
        novaphy.synchronize(device)
        times.append(time.perf_counter() - begin)
    gradient = leaves[0].grad.numpy()
    assert np.isfinite(gradient).all()
    info = solver.gradient_info()
    return {
        "scene": "Ant, collide, step and exact gradient",
        "device": novaphy.get_device(device).name,
        "worlds": worlds,
        "world_steps_per_second": round(worlds * steps / min(times)),
        "label": info["label"],
        "exact_steps": f"{info['exact_steps']} of {info['contact_steps']}",
        "hash": hashlib.sha256(gradient.tobytes()).hexdigest()[:16],
    }


def planar_arm() -> novaphy.ModelBuilder:
    """Build the two-link arm."""
    builder = novaphy.ModelBuilder()
    inertia = np.diag((0.0025, 1 / 48, 1 / 48))
    parent, made = -1, []
    for x in (0.0, 0.25):
        link = builder.add_link(mass=1.0, inertia=inertia, lock_inertia=True)
        made.append(
            builder.add_joint_revolute(
                parent,
                link,
                axis=(0.0, 1.0, 0.0),
                parent_xform=((x, 0, 0), UPRIGHT),
                child_xform=((-0.25, 0, 0), UPRIGHT),
            )
        )
        parent = link
    builder.add_articulation(made)
    builder.joint_q, builder.joint_qd = [0.4, -0.6], [1.0, -0.5]
    return builder


def time_gradient(builder: novaphy.ModelBuilder, steps: int, worlds: int = 1) -> float:
    """Return the time (s) of a step of a rollout with its adjoint, for each world."""
    from novaphy import nova
    from novaphy.diff import Trajectory, state_joint_q_tensor

    many = builder
    if worlds > 1:
        many = novaphy.ModelBuilder()
        many.replicate(builder, worlds, (3.0, 0.0, 0.0))
    model = many.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model)
    trajectory = Trajectory(model, steps)

    def run() -> None:
        with nova.Tape() as tape:
            solver.rollout(trajectory, None, None, DT)
            loss = nova.sum(state_joint_q_tensor(trajectory[steps]))
        tape.backward(loss)

    return fastest(run, steps * worlds)


def time_ant_gradient(steps: int = 100) -> tuple[float, float]:
    """Return the times (s) of a step of a standing Ant with its adjoint, and of the adjoint."""
    from novaphy import nova
    from novaphy.diff import Trajectory, state_joint_q_tensor

    ants = Ants(1)
    model = demo_articulated_scenes.build_ant().finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, pgs_slop=0.0, pgs_erp=1.0)
    pipeline = novaphy.CollisionPipeline(model)
    trajectory = Trajectory(model, steps)
    trajectory[0].joint_q.assign(ants.state.joint_q.numpy())
    trajectory[0].joint_qd.assign(ants.state.joint_qd.numpy())
    novaphy.eval_fk(model, trajectory[0].joint_q, trajectory[0].joint_qd, trajectory[0])

    adjoint = []

    def run() -> None:
        with nova.Tape() as tape:
            solver.rollout(trajectory, None, None, DT, pipeline=pipeline)
            loss = nova.sum(state_joint_q_tensor(trajectory[steps]))
        start = time.process_time()
        tape.backward(loss)
        adjoint.append(time.process_time() - start)

    both = fastest(run, steps)
    return both, min(adjoint) / steps * 1e6


class Ants:
    """Ants that stand on their feet, and random torques."""

    def __init__(self, worlds: int, device: str = "cpu") -> None:
        """Let the Ants fall, and store the state in which they have landed."""
        self.model = replicated(demo_articulated_scenes.build_ant(), worlds, device)
        self.solver = novaphy.solvers.SolverFeatherstone(self.model)
        self.pipeline = novaphy.CollisionPipeline(self.model)
        self.contacts, self.control = self.pipeline.contacts(), self.model.control()
        self.state, self.after = self.model.state(), self.model.state()
        novaphy.eval_fk(self.model, self.state.joint_q, self.state.joint_qd, self.state)
        self.run_pair = replayed(device, self.pair)
        self.rng = np.random.default_rng(0)
        self.contact_count = 0.0
        self.worlds = worlds
        self.run(800)
        self.landed = [x.numpy().copy() for x in (self.state.joint_q, self.state.joint_qd)]

    def land(self) -> None:
        """Set the state in which the Ants have landed."""
        self.state.joint_q.assign(self.landed[0])
        self.state.joint_qd.assign(self.landed[1])
        novaphy.eval_fk(self.model, self.state.joint_q, self.state.joint_qd, self.state)

    def turn(self, steps: int) -> None:
        """Run steps from the landed state."""
        self.land()
        self.run(steps)

    def pair(self) -> None:
        """Run two steps, so that the state is again in the first object."""
        for now, then in ((self.state, self.after), (self.after, self.state)):
            self.pipeline.collide(now, self.contacts)
            self.solver.step(now, then, self.control, self.contacts, DT)

    def run(self, steps: int) -> None:
        """Run steps, with new torques every 50 steps."""
        found = 0
        for t in range(0, steps, 2):
            if t % 50 == 0:
                torques = self.rng.uniform(-60.0, 60.0, (self.worlds, 14))
                torques[:, :6] = 0.0
                self.control.joint_f.assign(torques.ravel().astype(np.float32))
                found += int(self.contacts.rigid_contact_count.numpy()[0])
            self.run_pair()
        self.contact_count = found / (steps / 50) / self.worlds


def mujoco_arm() -> str:
    """Return the FR3 as MJCF."""
    bodies, ends = "", ""
    for k, (place, roll, mass, com, inertia) in enumerate(FR3):
        x, _, _, w = rolled(roll)
        numbers = " ".join(map(str, inertia))
        bodies += (
            f'<body pos="{place[0]} {place[1]} {place[2]}" quat="{w} {x} 0 0">'
            f'<inertial pos="{com[0]} {com[1]} {com[2]}" mass="{mass}" fullinertia="{numbers}"/>'
            f'<joint name="j{k}" axis="0 0 1" damping="{KD[k]}" stiffness="{KE[k]}" '
            f'springref="{np.degrees(POSE[k])}"/>'
        )
        ends += "</body>"
    return (
        f'<mujoco><option timestep="{DT}" integrator="implicitfast"/>'
        f'<compiler boundmass="0" balanceinertia="true"/>'
        f"<worldbody>{bodies}{ends}</worldbody></mujoco>"
    )


def mujoco_ant() -> str:
    """Return the Ant as MJCF. Its shapes touch only the ground."""
    legs = ""
    for (x, y), ankle, (lower, upper) in demo_articulated_scenes.LEGS:
        size = 'type="capsule" size="0.08"'
        legs += (
            f'<geom {size} fromto="0 0 0 {x} {y} 0"/><body pos="{x} {y} 0">'
            f'<joint axis="0 0 1" range="-40 40"/><geom {size} fromto="0 0 0 {x} {y} 0"/>'
            f'<body pos="{x} {y} 0"><joint axis="{ankle[0]} {ankle[1]} 0" range="{lower} {upper}"/>'
            f'<geom {size} fromto="0 0 0 {2 * x} {2 * y} 0"/></body></body>'
        )
    return (
        f'<mujoco><option timestep="{DT}"/><default><joint armature="0.05" damping="1" '
        f'limited="true"/><geom contype="0" conaffinity="1" friction="0.75 0.1 0.1" '
        f'density="1000"/></default><worldbody><geom type="plane" size="40 40 1" contype="1" '
        f'conaffinity="0"/><body pos="0 0 0.75"><joint type="free" limited="false" armature="0" '
        f'damping="0"/><geom type="sphere" size="0.25"/>{legs}</body></worldbody></mujoco>'
    )


def time_mujoco(text: str, ant: bool, steps: int) -> float:
    """Return the time (s) of a step in MuJoCo."""
    mujoco = importlib.import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    if ant:
        data.qpos[7:] = [0, 1, 0, -1, 0, -1, 0, 1]
        mujoco.mj_step(model, data, nstep=800)
    else:
        data.qpos[:] = POSE

    def run() -> None:
        for _ in range(steps // 50):
            if ant:
                data.qfrc_applied[6:] = rng.uniform(-60.0, 60.0, 8)
            mujoco.mj_step(model, data, nstep=50)

    return fastest(run, steps)


def pinocchio_arm() -> object:
    """Return the FR3 as a model of Pinocchio."""
    pin = importlib.import_module("pinocchio")
    model, parent = pin.Model(), 0
    for k, (place, roll, mass, com, inertia) in enumerate(FR3):
        x, y, z, w = rolled(roll)
        at = pin.SE3(pin.Quaternion(w, x, y, z), np.array(place, float))
        parent = model.addJoint(parent, pin.JointModelRZ(), at, f"j{k}")
        body = pin.Inertia(mass, np.array(com, float), matrix(inertia))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    return model


def humanoid(pin: object) -> tuple[novaphy.ModelBuilder, object]:
    """Return Pinocchio's sample humanoid (28 hinges) for NovaPhy and for Pinocchio."""
    tree = pin.buildSampleModelHumanoid()
    builder = novaphy.ModelBuilder()
    joints = []
    for k in range(1, tree.njoints):
        body = tree.inertias[k]
        inertia = {"mass": body.mass, "com": tuple(body.lever), "inertia": body.inertia}
        link = builder.add_link(**inertia, lock_inertia=True)
        at = tree.jointPlacements[k]
        pose = (tuple(at.translation), tuple(pin.Quaternion(at.rotation).coeffs()))
        kind, parent = tree.joints[k].shortname(), tree.parents[k] - 1
        if kind == "JointModelFreeFlyer":
            joints.append(builder.add_joint_free(link))
            continue
        axis = {"X": (1, 0, 0), "Y": (0, 1, 0), "Z": (0, 0, 1)}[kind.removeprefix("JointModelR")]
        joints.append(builder.add_joint_revolute(parent, link, axis=axis, parent_xform=pose))
    builder.add_articulation(joints)
    return builder, tree


def time_functions(
    builder: novaphy.ModelBuilder, tree: object, calls: int = 2000
) -> dict[str, tuple[float, float | None]]:
    """Time functions of the dynamics from Python, in NovaPhy and Pinocchio (tree None: absent)."""
    model = builder.finalize()
    state = model.state()
    tau = np.zeros(model.joint_dof_count, np.float32)

    def repeat(call: Callable[[], object]) -> Callable[[], None]:
        def run() -> None:
            for _ in range(calls):
                call()

        return run

    ours = {
        "inverse dynamics": lambda: novaphy.eval_inverse_dynamics(model, state, tau),
        "forward dynamics": lambda: novaphy.eval_forward_dynamics(model, state, tau),
        "derivatives of forward dynamics": lambda: novaphy.eval_forward_dynamics_derivatives(
            model, state, tau
        ),
    }
    theirs: dict[str, Callable[[], object]] = {}
    if tree is not None:
        pin = importlib.import_module("pinocchio")
        data, q, v = tree.createData(), model.joint_q.numpy().astype(float), np.zeros(tree.nv)
        theirs = {
            "inverse dynamics": lambda: pin.rnea(tree, data, q, v, v),
            "forward dynamics": lambda: pin.aba(tree, data, q, v, v),
            "derivatives of forward dynamics": lambda: pin.computeABADerivatives(
                tree, data, q, v, v
            ),
        }
        # The same tree: the same torques. Rates of the root are in other axes, and 0 here.
        assert np.allclose(ours["inverse dynamics"](), pin.rnea(tree, data, q, v, v), atol=1e-3)
    return {
        name: (
            fastest(repeat(call), calls),
            fastest(repeat(theirs[name]), calls) if name in theirs else None,
        )
        for name, call in ours.items()
    }


def measure_humanoid() -> list[tuple[str, float, str, float | None]]:
    """Return rows like measure(), or none without Pinocchio, which has the model."""
    if importlib.util.find_spec("pinocchio") is None:
        return []
    builder, tree = humanoid(importlib.import_module("pinocchio"))
    rows = [
        ("humanoid, a step, one world, from Python", time_steps(builder, 1, 2000), "", None),
        ("humanoid, a step per world, 256 worlds", time_steps(builder, 256, 40), "", None),
    ]
    for name, (ours, theirs) in time_functions(builder, tree, 500).items():
        rows.append((f"humanoid, {name}, from Python", ours, "Pinocchio", theirs))
    return rows


def measure() -> list[tuple[str, float, str, float | None]]:
    """Return rows (name, time in NovaPhy, peer, time in the peer), with times in microseconds."""
    has_mujoco = importlib.util.find_spec("mujoco") is not None
    mujoco_fr3 = time_mujoco(mujoco_arm(), False, 20_000) if has_mujoco else None
    mujoco = time_mujoco(mujoco_ant(), True, 5_000) if has_mujoco else None
    rows = [
        ("FR3, a step, one world, from Python", time_steps(arm(), 1, 20_000), "MuJoCo", mujoco_fr3),
        ("FR3, a step per world, 1,024 worlds", time_steps(arm(), 1024, 60), "MuJoCo", mujoco_fr3),
    ]
    if novaphy.has_diff():
        gradient = "a step of a rollout and its exact adjoint"
        ant, ant_adjoint = time_ant_gradient()
        rows += [
            (f"FR3, {gradient}", time_gradient(arm(), 500), "", None),
            (f"FR3, {gradient}, per world, 256 worlds", time_gradient(arm(), 20, 256), "", None),
            (f"two-link arm, {gradient} (576 steps)", time_gradient(planar_arm(), 576), "", None),
            (f"Ant, collide and {gradient}", ant, "", None),
            ("the adjoint through contacts, a part of the row above", ant_adjoint, "", None),
        ]
    has_pinocchio = importlib.util.find_spec("pinocchio") is not None
    tree = pinocchio_arm() if has_pinocchio else None
    for name, (ours, theirs) in time_functions(arm(), tree).items():
        rows.append((f"FR3, {name}, from Python", ours, "Pinocchio", theirs))
    rows += measure_humanoid()
    for worlds, steps in ((1, 400), (256, 100)):
        ants = Ants(worlds)
        count = f"{ants.contact_count:.1f} contacts"
        many = "one world, from Python" if worlds == 1 else f"per world, {worlds} worlds"
        both = fastest(lambda a=ants, n=steps: a.turn(n), steps * worlds)
        rows.append((f"Ant, collide and a step, {many}, {count}", both, "MuJoCo", mujoco))

        def search(ants: Ants = ants, steps: int = steps) -> None:
            for _ in range(steps):
                ants.pipeline.collide(ants.state, ants.contacts)

        found = fastest(search, steps * worlds)
        rows.append((f"the search for contacts, a part of the row above, {many}", found, "", None))
    return rows


def lanes() -> str:
    """Return the instruction set of this process."""
    chosen = os.environ.get("NOVAPHY_CPU_ISA")
    if chosen:
        return chosen
    flags = Path("/proc/cpuinfo").read_text().split()
    return "AVX-512" if "avx512f" in flags else "AVX2" if "avx2" in flags else "4 floats"


def curves() -> list[str]:
    """Return the lines of tables of times over the number of joints and of worlds."""
    lines = [
        "",
        "A step per world, µs, of chains of hinges with drives:",
        "",
        "| hinges | one world, from Python | 256 worlds |",
        "|---|---|---|",
    ]
    for joints in (1, 2, 4, 8, 16, 32):
        one = time_steps(chain(joints), 1, 4000)
        many = time_steps(chain(joints), 256, 40)
        lines.append(f"| {joints} | {one:.2f} | {many:.3f} |")
    lines += [
        "",
        "And of the FR3, over the number of worlds:",
        "",
        "| worlds | µs per world and step | steps/s |",
        "|---|---|---|",
    ]
    for worlds in (1, 4, 16, 64, 256, 1024, 4096):
        each = time_steps(arm(), worlds, max(8, 16384 // worlds))
        lines.append(f"| {worlds:,} | {each:.3f} | {1e6 / each:,.0f} |")
    return lines


def write_page(rows: list[tuple[str, float, str, float | None]]) -> None:
    """Write the tables of docs/performance-articulations.md. The text below them stays."""
    page = ROOT / "docs" / "performance-articulations.md"
    by_hand = page.read_text("utf-8").partition(BY_HAND)[1:] if page.exists() else ()
    load = os.getloadavg()[0]
    lines = [
        "# Performance of articulations",
        "",
        "Written by `tools/bench/novaphy_articulation.py --page`, but for the last part.",
        "",
        f"One thread of {cpu_name()}, Python {platform.python_version()}. Times are those of the",
        f"processor, not of the clock, of the fastest of {TURNS} turns.",
        *(
            [
                f"The machine was loaded (load average {load:.0f}): caches were shared, and the",
                "times are upper bounds.",
            ]
            if load > 1.5
            else []
        ),
        "NovaPhy computes in float32, MuJoCo and Pinocchio in float64. MuJoCo's steps are taken 50",
        "at a time; its contacts are soft and solved by Newton's method, ours by projected",
        "Gauss-Seidel. Worlds that are alike are stepped several at a time, in lanes: here "
        f"{lanes()}.",
        "",
        "| work | NovaPhy, µs | peer, µs | steps/s |",
        "|---|---|---|---|",
    ]
    for what, ours, peer, theirs in rows:
        other = f"{peer} {theirs:.2f}" if theirs is not None else ""
        lines.append(f"| {what} | {ours:.2f} | {other} | {1e6 / ours:,.0f} |")
    lines += curves()
    text = "\n".join(lines) + "\n"
    if any(by_hand):
        text += "\n" + "".join(by_hand)
    page.write_text(text, "utf-8")


def main() -> None:
    """Measure, then print or write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", action="store_true", help="write the page of the results")
    parser.add_argument("--humanoid", action="store_true", help="measure that alone")
    parser.add_argument("--device", help="measure there, and nothing else")
    parser.add_argument("--worlds", type=int, nargs="+", default=[1024, 8192, 65536])
    parser.add_argument("--gradients", action="store_true", help="with --device: those alone")
    args = parser.parse_args()
    if args.device:
        for worlds in args.worlds:
            forward = (time_device, time_device_ants)
            for timed in (time_device_ant_gradients,) if args.gradients else forward:
                print(json.dumps(timed(args.device, worlds)), flush=True)
        return
    if os.environ.get("NOVAPHY_NUM_THREADS") != "1":
        parser.error("set NOVAPHY_NUM_THREADS=1")
    if args.humanoid and args.page:
        parser.error("--page: expected all rows, got --humanoid")
    rows = measure_humanoid() if args.humanoid else measure()
    for what, ours, peer, theirs in rows:
        print(f"{ours:9.3f} us  {what}" + (f"   {peer} {theirs:.3f}" if theirs else ""))
    if args.page:
        write_page(rows)


if __name__ == "__main__":
    main()
