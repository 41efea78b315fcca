"""Load a robot from a URDF or MJCF file and let it swing.

No motor turns: the robot starts in a pose of its own, falls under gravity, and swings. It hangs on
its base or, with --floating, falls freely. Printed is how much energy is left; without --floating
it may not grow. Contacts are left out.

    python demo_robot.py
    python demo_robot.py two_link_arm.urdf --headless 240 --plot arm.png --record arm.html
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


def build_model(args: argparse.Namespace) -> novaphy.Model:
    """The robot of the file, its hinges without limits."""
    path = Path(args.robot)
    if not path.exists() and args.robot in novaphy.assets.names():
        path = novaphy.assets.path(args.robot)
    builder = novaphy.ModelBuilder()
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        if path.suffix == ".urdf":
            packages = [Path(args.packages)] if args.packages else None
            builder.add_urdf(
                path, floating=args.floating, xform=(0, 0, args.height, 0, 0, 0, 1),
                collapse_fixed_joints=True, package_dirs=packages,
            )  # fmt: skip
        else:
            builder.add_mjcf(path)
    if not builder.joint_dof_count:
        raise ValueError(f"{path}: expected joints that move, got none")
    model = builder.finalize()
    # Hinges turn freely; slides, as those of fingers, stay where they may be.
    free, q = model.joint_velocity_limit.numpy(), model.joint_q.numpy()
    lower, upper = model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy()
    dofs, coords = model.joint_qd_start.numpy(), model.joint_q_start.numpy()
    for joint, kind in enumerate(model.joint_type.numpy()):
        if kind not in (novaphy.JointType.REVOLUTE, novaphy.JointType.D6):
            continue
        rows = slice(dofs[joint], dofs[joint + 1])
        lower[rows], upper[rows], free[rows] = -1e10, 1e10, 1e6
        if path.suffix == ".urdf" and not args.floating:
            q[coords[joint] : coords[joint + 1]] = 0.3 + 0.2 * (joint % 3)  # off balance
    model.joint_limit_lower.assign(lower)
    model.joint_limit_upper.assign(upper)
    model.joint_velocity_limit.assign(free)
    model.joint_q.assign(q)
    return model


def simulate(
    model: novaphy.Model, frames: int, stage: viewer.Stage
) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the bodies {frames + 1, bodies, 3} (m) and energies {frames + 1} (J)."""
    solver = novaphy.solvers.SolverFeatherstone(model)
    state, after = model.state(), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    places, energies = [state.body_q.numpy()[:, :3]], [energy(model, state)]
    for frame in stage.frames(frames):
        for _ in range(SUBSTEPS):
            state.clear_forces()
            solver.step(state, after, None, None, DT)
            state, after = after, state
        places.append(state.body_q.numpy()[:, :3])
        energies.append(energy(model, state))
        stage.show(frame / FPS, state)
    return np.array(places), np.array(energies)


def energy(model: novaphy.Model, state: novaphy.SimState) -> float:
    """Kinetic and potential energy (J) of all articulations."""
    return float(np.sum(novaphy.eval_energy(model, state)))


def plot(path: str, model: novaphy.Model, places: np.ndarray, energies: np.ndarray) -> None:
    """The bodies as sticks at ten times, from the side, and the energy."""
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
    left.set(xlabel="x (m)", ylabel="z (m)", title="Origins of the links", aspect="equal")
    right.plot(np.arange(len(energies)) / FPS, energies, color="#4f772d")
    right.set(xlabel="time (s)", ylabel="energy (J)", title="Kinetic and potential energy")
    figure.savefig(path, dpi=140)


def main() -> int:
    """Simulate, draw, and check the energy."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = ", ".join(novaphy.assets.names())
    parser.add_argument("robot", nargs="?", default="fr3.urdf", help=f"a file, or one of: {known}")
    parser.add_argument("--packages", metavar="FOLDER", help="where package:// is")
    parser.add_argument("--floating", action="store_true", default=None, help="free base (URDF)")
    parser.add_argument("--height", type=float, default=0.0, help="of the root, in m (URDF)")
    viewer.add_arguments(parser, 180, "frames of 1/60 s")
    parser.add_argument("--plot", metavar="PATH.png", help="draw the links and the energy")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)
    if args.plot and not Path(args.plot).parent.is_dir():
        parser.error(f"the folder of {args.plot} does not exist")

    try:
        model = build_model(args)
    except (ValueError, OSError, ImportError, NotImplementedError) as error:
        parser.error(str(error))
    look = ((1.0, -1.4, 0.8), (0.0, 0.0, 0.4))
    with viewer.Stage(args, model, fps=FPS, look=look) as stage:
        places, energies = simulate(model, args.headless, stage)
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
