"""Load a robot from a URDF or MJCF file and let it swing, or fall to the ground.

The joints are not driven. A URDF robot hangs on its fixed base, starts off balance, and swings
without contacts and joint limits. With --floating, and from MJCF files, the robot falls to the
ground. Contacts are then found in every step, and solved by projected Gauss-Seidel. The demo prints
the part of the initial energy that is left, and checks that the energy does not grow.

    python demo_robot.py
    python demo_robot.py two_link_arm.urdf --headless 240 --plot arm.png --record arm.html
    python demo_robot.py quadruped.urdf --floating --height 0.5
    python demo_robot.py ant.xml
    python demo_robot.py path/to/robot.urdf --packages path/to/packages
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np

import novaphy
from novaphy import viewer

FPS, SUBSTEPS = 60, 32
DT = 1.0 / (FPS * SUBSTEPS)


def build_model(args: argparse.Namespace) -> tuple[novaphy.Model, bool]:
    """Build the robot of the file.

    Return the model, and whether the robot swings on a fixed base. Hinges of such a robot have no
    limits.
    """
    path = Path(args.robot)
    if not path.exists() and args.robot in novaphy.assets.names():
        path = novaphy.assets.path(args.robot)
    is_urdf = path.suffix == ".urdf"
    if not is_urdf:
        for flag, given in (("--floating", args.floating), ("--height", args.height is not None)):
            if given:
                raise ValueError(f"{flag}: expected with URDF files only, got {path.name}")
    swings = is_urdf and not args.floating
    height = args.height if args.height is not None else 0.0 if swings else 0.5
    builder = novaphy.ModelBuilder()
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        if is_urdf:
            packages = [Path(args.packages)] if args.packages else None
            builder.add_urdf(
                path, floating=args.floating, xform=(0, 0, height, 0, 0, 0, 1),
                collapse_fixed_joints=True, package_dirs=packages,
            )  # fmt: skip
        else:
            builder.add_mjcf(path)
    if not builder.joint_dof_count:
        raise ValueError(f"{path}: expected joints that move, got none")
    model = builder.finalize()
    if not swings:
        if novaphy.GeoType.PLANE not in model.shape_type.numpy():
            builder.add_ground_plane()
            model = builder.finalize()
        return model, swings
    # Remove the limits of hinges. Prismatic joints, such as fingers, keep their limits.
    free, q = model.joint_velocity_limit.numpy(), model.joint_q.numpy()
    lower, upper = model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy()
    dofs, coords = model.joint_qd_start.numpy(), model.joint_q_start.numpy()
    for joint, kind in enumerate(model.joint_type.numpy()):
        if kind not in (novaphy.JointType.REVOLUTE, novaphy.JointType.D6):
            continue
        rows = slice(dofs[joint], dofs[joint + 1])
        lower[rows], upper[rows], free[rows] = -1e10, 1e10, 1e6
        q[coords[joint] : coords[joint + 1]] = 0.3 + 0.2 * (joint % 3)  # off balance
    model.joint_limit_lower.assign(lower)
    model.joint_limit_upper.assign(upper)
    model.joint_velocity_limit.assign(free)
    model.joint_q.assign(q)
    return model, swings


def simulate(
    model: novaphy.Model, swings: bool, frames: int, stage: viewer.Stage
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions of the bodies {frames + 1, bodies, 3} (m) and energies {frames + 1} (J)."""
    for run in stage.runs(frames):
        solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.05)
        pipeline = None if swings else novaphy.CollisionPipeline(model)
        contacts = None if pipeline is None else pipeline.contacts()
        state, after = model.state(), model.state()
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        places, energies = [state.body_q.numpy()[:, :3]], [energy(model, state)]
        stage.show(0.0, state)
        for frame in run:
            for _ in range(SUBSTEPS):
                state.clear_forces()
                stage.apply_forces(state)
                if pipeline is not None and contacts is not None:
                    pipeline.collide(state, contacts)
                solver.step(state, after, None, contacts, DT)
                state, after = after, state
            places.append(state.body_q.numpy()[:, :3])
            energies.append(energy(model, state))
            stage.show(frame / FPS, state)
    return np.array(places), np.array(energies)


def energy(model: novaphy.Model, state: novaphy.SimState) -> float:
    """Return the kinetic plus potential energy (J) of all articulations."""
    return float(np.sum(novaphy.eval_energy(model, state)))


def camera(model: novaphy.Model, swings: bool) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return a position and a target (m) of a camera that shows the whole robot."""
    state = model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    lowest, highest = np.full(3, np.inf), np.full(3, -np.inf)
    bodies, poses, scales = (
        array.numpy() for array in (model.shape_body, state.body_q, model.shape_scale)
    )
    for shape, at in enumerate(model.shape_transform.numpy()):
        if bodies[shape] < 0:
            continue
        p, v = poses[bodies[shape], :3], poses[bodies[shape], 3:6]
        w = poses[bodies[shape], 6]
        turned = at[:3] + 2.0 * np.cross(v, np.cross(v, at[:3]) + w * at[:3])
        reach = min(float(scales[shape].max()), 0.3)  # bounded, because a mesh's scale is no size
        lowest = np.minimum(lowest, p + turned - reach)
        highest = np.maximum(highest, p + turned + reach)
    # The robot falls to the ground at height 0, or swings below its base.
    lowest[2] = min(lowest[2], -0.7 * highest[2] if swings else 0.0)
    center = 0.5 * (lowest + highest)
    size = float(np.linalg.norm(highest - lowest))
    eye = center + 1.5 * size * np.array([0.56, -0.78, 0.3])
    return tuple(map(float, eye)), tuple(map(float, center))


def plot(path: str, model: novaphy.Model, places: np.ndarray, energies: np.ndarray) -> None:
    """Draw the bodies as sticks at ten times, from the side, and the energy."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.6), layout="constrained")
    parents, children = model.joint_parent.numpy(), model.joint_child.numpy()
    for frame in np.linspace(0, len(places) - 1, 10).astype(int):
        alpha = 0.15 + 0.85 * frame / max(len(places) - 1, 1)
        for a, b in zip(parents, children, strict=True):
            if a >= 0:
                line = places[frame][[a, b]]
                left.plot(line[:, 0], line[:, 2], "o-", color="#2a6f97", alpha=alpha, lw=2, ms=3)
    tip = places[:, -1]
    left.plot(tip[:, 0], tip[:, 2], color="#c1666b", lw=0.8)
    left.set(xlabel="x (m)", ylabel="z (m)", title="Origins of the links")
    left.set_aspect("equal", adjustable="datalim")
    right.plot(np.arange(len(energies)) / FPS, energies, color="#4f772d")
    right.set(xlabel="time (s)", ylabel="energy (J)", title="Kinetic and potential energy")
    figure.savefig(path, dpi=140)


def main() -> int:
    """Simulate, draw, and check the energy. Return 0 if every check passed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = ", ".join(novaphy.assets.names())
    parser.add_argument("robot", nargs="?", default="fr3.urdf", help=f"a file, or one of: {known}")
    parser.add_argument("--packages", metavar="FOLDER", help="where package:// is")
    parser.add_argument("--floating", action="store_true", default=None, help="free base (URDF)")
    parser.add_argument(
        "--height", type=float, help="of the root (URDF), in m: 0, or 0.5 with --floating"
    )
    viewer.add_arguments(parser, 180, "frames of 1/60 s")
    parser.add_argument("--plot", metavar="PATH.png", help="draw the links and the energy")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)

    try:
        model, swings = build_model(args)
    except (ValueError, OSError, ImportError, NotImplementedError) as error:
        parser.error(str(error))
    with viewer.Stage(args, model, fps=FPS, look=camera(model, swings)) as stage:
        places, energies = simulate(model, swings, args.headless, stage)
    if args.plot:
        plot(args.plot, model, places, energies)
    scale = float(np.ptp(places[:, :, 2])) * 9.81 * float(model.body_mass.numpy().sum()) + 1e-6
    print(f"{model.body_count} bodies, {model.joint_dof_count} degrees of freedom")
    print(f"energy {energies[0]:.4f} J at the start, {energies[-1]:.4f} J at the end")
    checks = {
        "finite positions": bool(np.isfinite(places).all()),
        "energy that does not grow": energies.max() <= energies[0] + 0.01 * scale,
    }
    failed = [name for name, good in checks.items() if not good]
    print(f"CHECK FAILED: expected {'; '.join(failed)}" if failed else "ok")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
