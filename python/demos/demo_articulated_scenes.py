"""Let articulations touch: a stack, a dropped quadruped, a chain, one Ant or 1,024 with torques.

python demo_articulated_scenes.py
python demo_articulated_scenes.py stack
python demo_articulated_scenes.py quadruped --headless 180 --plot quadruped.png
python demo_articulated_scenes.py chain --headless 240 --record chain.png
python demo_articulated_scenes.py ants --headless 120 --record ants.png
python demo_articulated_scenes.py ant --headless 600 --record ant.html
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

import novaphy
from novaphy import viewer

FPS, SUBSTEPS = 60, 8
DT = 1.0 / (FPS * SUBSTEPS)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
CUBE, CUBES, ASIDE = 0.1, 10, 0.003  # half an edge (m), number, sideways offset (m)
THIGH, CALF = 0.22, 0.22  # lengths (m)
STANCE = (0.0, 0.75, -1.5)  # rad, angles of hip, thigh and calf
LINKS, LINK = 24, 0.12  # number of links of the chain, length of a link (m)
ANTS, SPACING = 32, 1.8  # Ants in a row, distance of Ants (m)
TORQUE, FRAMES_PER_TORQUE = 60.0, 5  # largest torque (N m), frames with the same torque
# The Ant: leg, direction of its hip, axis of its ankle, and range of the ankle (degrees).
LEGS = (
    ((0.2, 0.2), (-1.0, 1.0), (30.0, 100.0)),
    ((-0.2, 0.2), (1.0, 1.0), (-100.0, -30.0)),
    ((-0.2, -0.2), (-1.0, 1.0), (-100.0, -30.0)),
    ((0.2, -0.2), (1.0, 1.0), (30.0, 100.0)),
)


def between(a: np.ndarray, b: np.ndarray) -> tuple[tuple, float]:
    """Return the pose of a capsule from point a to point b (m), and half its length (m)."""
    along = b - a
    length = float(np.linalg.norm(along))
    x, y, z = along / length  # the direction of the capsule, to which its z axis is rotated
    q = np.array([-y, x, 0.0, 1.0 + z])
    return (*((a + b) / 2), *(q / np.linalg.norm(q))), length / 2


def build_stack() -> novaphy.ModelBuilder:
    """Build a stack of ten cubes of 8 kg, each with a small offset."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5)
    builder.add_ground_plane(cfg=surface)
    for k in range(CUBES):
        x = ASIDE * (-1) ** k
        y = x if k % 3 == 0 else -x
        cube = builder.add_body(xform=((x, y, CUBE * (2 * k + 1)), UPRIGHT))
        builder.add_shape_box(cube, hx=CUBE, hy=CUBE, hz=CUBE, cfg=surface)
    return builder


def build_quadruped() -> novaphy.ModelBuilder:
    """Build a trunk with four legs of three hinges each, which drives hold in a stance."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(mu=0.8))
    body = novaphy.ShapeConfig(density=600.0, mu=0.8, collision_group=-1)
    trunk = builder.add_link(xform=((0.0, 0.0, 0.7), UPRIGHT))
    builder.add_shape_box(trunk, hx=0.22, hy=0.1, hz=0.06, cfg=body)
    joints, angles = [builder.add_joint_free(trunk)], []
    drive = {"target_ke": 120.0, "target_kd": 4.0, "effort_limit": 40.0, "armature": 0.01}
    for x in (0.19, -0.19):
        for y in (0.12, -0.12):
            hip, thigh, calf = (builder.add_link() for _ in range(3))
            builder.add_shape_sphere(hip, radius=0.045, cfg=body)
            builder.add_shape_capsule(
                thigh, xform=((0, 0, -THIGH / 2), UPRIGHT), radius=0.03, half_height=0.08, cfg=body
            )
            builder.add_shape_capsule(
                calf, xform=((0, 0, -CALF / 2), UPRIGHT), radius=0.018, half_height=0.09, cfg=body
            )
            builder.add_shape_sphere(calf, xform=((0, 0, -CALF), UPRIGHT), radius=0.025, cfg=body)
            out = np.sign(y) * 0.05
            for parent, child, axis, place, angle in (
                (trunk, hip, (1, 0, 0), (x, y, 0.0), STANCE[0]),
                (hip, thigh, (0, 1, 0), (0.0, out, 0.0), STANCE[1]),
                (thigh, calf, (0, 1, 0), (0.0, 0.0, -THIGH), STANCE[2]),
            ):
                joints.append(
                    builder.add_joint_revolute(
                        parent, child, axis=axis, parent_xform=(place, UPRIGHT), **drive
                    )
                )
                angles.append(angle)
    builder.add_articulation(joints)
    for k, angle in enumerate(angles):
        builder.joint_q[7 + k] = builder.joint_target_q[7 + k] = angle
    return builder


def build_ant(ground: bool = True) -> novaphy.ModelBuilder:
    """Build the Ant: a ball with four legs of two hinges, 182 kg. Its shapes touch only the
    ground.
    """
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.75, collision_group=-1)
    if ground:
        builder.add_ground_plane(cfg=novaphy.ShapeConfig(mu=0.75))
    torso = builder.add_link(xform=((0.0, 0.0, 0.75), UPRIGHT))
    builder.add_shape_sphere(torso, radius=0.25, cfg=surface)
    joints, angles = [builder.add_joint_free(torso)], []
    hinge = {"armature": 0.05, "damping": 1.0, "limit_ke": 1e3, "limit_kd": 10.0}
    for (x, y), ankle, (lower, upper) in LEGS:
        out = np.array([x, y, 0.0])
        leg, foot = builder.add_link(), builder.add_link()
        for link, end in ((torso, out), (leg, out), (foot, 2 * out)):
            pose, half = between(np.zeros(3), end)
            builder.add_shape_capsule(link, xform=pose, radius=0.08, half_height=half, cfg=surface)
        for parent, child, axis, low, high in (
            (torso, leg, (0.0, 0.0, 1.0), -40.0, 40.0),
            (leg, foot, (*(np.array(ankle) / np.sqrt(2)), 0.0), lower, upper),
        ):
            joints.append(
                builder.add_joint_revolute(
                    parent,
                    child,
                    axis=axis,
                    parent_xform=(tuple(out), UPRIGHT),
                    limit_lower=np.radians(low),
                    limit_upper=np.radians(high),
                    **hinge,
                )
            )
        angles += [0.0, 1.0 if upper > 0 else -1.0]
    builder.add_articulation(joints)
    builder.joint_q[7:] = angles
    return builder


def build_chain() -> novaphy.ModelBuilder:
    """Build capsules on ball joints. One end is fixed, and the other end drags along the ground."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5, collision_group=-1)
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(mu=0.5))
    joints, parent, place = [], -1, (0.0, 0.0, 2.0)
    for _ in range(LINKS):
        link = builder.add_link()
        pose, half = between(np.zeros(3), np.array([LINK, 0.0, 0.0]))
        builder.add_shape_capsule(link, xform=pose, radius=0.02, half_height=half, cfg=surface)
        joints.append(
            builder.add_joint_ball(parent, link, parent_xform=(place, UPRIGHT), damping=0.01)
        )
        parent, place = link, (LINK, 0.0, 0.0)
    builder.add_articulation(joints)
    return builder


def build_ants() -> novaphy.ModelBuilder:
    """Build 1,024 worlds with one Ant each, side by side on one ground."""
    builder, ant = novaphy.ModelBuilder(), build_ant(ground=False)
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(mu=0.75))
    for k in range(ANTS * ANTS):
        place = (SPACING * (k % ANTS), SPACING * (k // ANTS), 0.0)
        builder.add_world(ant, (place, UPRIGHT))
    return builder


SCENES = {
    "stack": build_stack,
    "quadruped": build_quadruped,
    "chain": build_chain,
    "ant": build_ant,
    "ants": build_ants,
}
LOOKS = {
    "stack": ((0.6, -3.6, 1.4), (0.0, 0.0, 1.0)),
    "quadruped": ((0.9, -1.3, 0.6), (0.0, 0.0, 0.25)),
    "chain": ((1.0, -3.4, 1.5), (0.5, 0.0, 0.95)),
    "ants": ((-9.0, -16.0, 13.0), (23.0, 22.0, -3.0)),
    "ant": ((1.8, -2.6, 1.5), (0.0, 0.0, 0.3)),
}


def simulate(
    scene: str, model: novaphy.Model, frames: int, stage: viewer.Stage
) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses {frames + 1, bodies, 7} and the last velocities {bodies, 6}."""
    for run in stage.runs(frames):
        pipeline = novaphy.CollisionPipeline(model)
        contacts, control = pipeline.contacts(), model.control()
        solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.05)
        state, after = model.state(), model.state()
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        rng = np.random.default_rng(1)
        poses = [state.body_q.numpy()]
        stage.show(0.0, state)
        for frame in run:
            if scene in ("ant", "ants") and frame % FRAMES_PER_TORQUE == 0:
                torques = np.zeros((max(model.world_count, 1), 14), np.float32)
                torques[:, 6:] = rng.uniform(-TORQUE, TORQUE, (len(torques), 8))
                control.joint_f.assign(torques.ravel())
            for _ in range(SUBSTEPS):
                state.clear_forces()
                stage.apply_forces(state)
                pipeline.collide(state, contacts)
                solver.step(state, after, control, contacts, DT)
                state, after = after, state
            poses.append(state.body_q.numpy())
            stage.show(frame / FPS, state)
    return np.array(poses), state.body_qd.numpy()


def check(scene: str, poses: np.ndarray, velocities: np.ndarray) -> str:
    """Return a text about the failed checks of a scene; "": all checks passed."""
    if not np.isfinite(poses).all():
        return "finite poses"
    if scene == "stack":
        moved = np.abs(poses[-1, :, :3] - poses[0, :, :3])
        stands = moved[:, :2].max() < 2e-3 and moved[:, 2].max() < 1e-3
        return "" if stands else f"cubes that stay, they moved by {moved.max() * 1e3:.2f} mm"
    height = poses[-1, 0, 2]
    if scene == "quadruped":
        stands = 0.25 < height < 0.4 and np.abs(velocities).max() < 0.05
        return "" if stands else f"a quadruped at rest on its legs, got {height:.2f} m"
    if scene == "chain":
        reach = np.linalg.norm(poses[:, :, :3] - [0.0, 0.0, 2.0], axis=2)
        holds = (reach < LINK * (np.arange(LINKS) + 1e-3)).all() and poses[..., 2].min() > 0.0
        return "" if holds else "a chain that holds together above the ground"
    torsos = poses[:, :: 9 if scene == "ants" else poses.shape[1], 2]
    stands = torsos.min() > 0.2 and torsos[-1].max() < 1.0
    return "" if stands else f"Ants above the ground, got {torsos.min():.2f} m"


def plot(path: str, model: novaphy.Model, poses: np.ndarray) -> None:
    """Draw the positions of the bodies over time, and their paths from the side."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (over, side) = plt.subplots(1, 2, figsize=(11.0, 4.0), layout="constrained")
    time = np.arange(len(poses)) / FPS
    over.plot(time, poses[..., 2], lw=1.0)
    over.set(xlabel="time (s)", ylabel="z of the bodies (m)")
    side.plot(poses[..., 0], poses[..., 2], lw=0.8)
    side.plot(poses[-1, :, 0], poses[-1, :, 2], "k.")
    side.axhline(0.0, color="0.3")
    side.set(xlabel="x (m)", ylabel="z (m)", title=f"{model.body_count} bodies")
    side.set_aspect("equal", adjustable="datalim")
    figure.savefig(path, dpi=140)


def main() -> int:
    """Simulate, draw and check a scene. Return 0 if every check passed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", choices=SCENES, nargs="?", default="quadruped")
    viewer.add_arguments(parser, 240, "frames of 1/60 s")
    parser.add_argument("--plot", metavar="PATH.png", help="draw the motion")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)

    model = SCENES[args.scene]().finalize()
    with viewer.Stage(args, model, fps=FPS, look=LOOKS[args.scene]) as stage:
        poses, velocities = simulate(args.scene, model, args.headless, stage)
    if args.plot:
        plot(args.plot, model, poses)
    missing = check(args.scene, poses, velocities) if args.headless >= 120 else ""
    if missing:
        print(f"CHECK FAILED: expected {missing}")
        return 1
    print(f"{args.scene}: {args.headless} frames, ok")
    return 0


if __name__ == "__main__":
    sys.exit(main())
