"""Bodies and joints in SolverVBD: a rope bridge, a seesaw, a motor, dominoes, a ragdoll.

Each scene has a check: joints stay together, and the motion is that of a law.

python demo_vbd_bodies.py
python demo_vbd_bodies.py bridge --headless 240 --plot bridge.png
python demo_vbd_bodies.py seesaw --headless 120 --record seesaw.html
python demo_vbd_bodies.py motor
python demo_vbd_bodies.py dominoes
python demo_vbd_bodies.py ragdoll
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import numpy as np

import novaphy
from novaphy import viewer
from novaphy.solvers import SolverVBD

FPS, SUBSTEPS = 60, 2
DT = 1.0 / (FPS * SUBSTEPS)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
SURFACE = novaphy.ShapeConfig(ke=1e5, kd=50.0, mu=0.5, density=500.0)
PLANKS, PLANK = 16, (0.1, 0.4, 0.02)  # number, half extents (m)
BEAM, PIVOT, LOADS = (1.0, 0.15, 0.02), 0.4, (0.1, 0.15)  # m: half extents, height, half cubes
ARM, SPEED = 0.4, 4.0  # half a length (m), speed of the motor (rad/s)
DOMINO, DOMINOES, SPACING = (0.02, 0.1, 0.2), 16, 0.2  # half extents (m), number, distance (m)
Joints = list[tuple[int, int, tuple, tuple]]  # bodies, and the point in the frame of each (m)


class Scene:
    """A builder, and the points of the bodies that its joints hold together."""

    def __init__(self) -> None:
        self.builder = novaphy.ModelBuilder()
        self.builder.default_shape_cfg = SURFACE
        self.joints: Joints = []
        self.links: list[int] = []

    def box(
        self, place: tuple, half: tuple[float, float, float], is_link: bool = False,
        tilt: float = 0.0,
    ) -> int:  # fmt: skip
        """Add a box with half extents (m) at a place (m), tilted about y (rad)."""
        add = self.builder.add_link if is_link else self.builder.add_body
        turn = (0.0, float(np.sin(0.5 * tilt)), 0.0, float(np.cos(0.5 * tilt)))
        body = add(xform=(place, turn))
        self.builder.add_shape_box(body, hx=half[0], hy=half[1], hz=half[2])
        return body

    def join(self, parent: int, child: int, at: tuple, to: tuple, **options: object) -> None:
        """Add a ball joint, or a hinge with the axis of the options, between points (m)."""
        self.joints.append((parent, child, at, to))
        kind = "add_joint_revolute" if "axis" in options else "add_joint_ball"
        joint = getattr(self.builder, kind)(
            parent, child, parent_xform=(at, UPRIGHT), child_xform=(to, UPRIGHT), **options
        )
        self.links.append(joint)

    def close(self, parent: int, child: int, at: tuple, to: tuple) -> None:
        """Add a ball joint that closes a loop, after all joints of the articulation."""
        self.joints.append((parent, child, at, to))
        self.builder.add_joint_ball(
            parent, child, parent_xform=(at, UPRIGHT), child_xform=(to, UPRIGHT)
        )

    def finalize(self) -> novaphy.Model:
        """Make the model. The joints of `join` are one articulation."""
        if self.links:
            self.builder.add_articulation(self.links)
        return self.builder.finalize()


def bridge() -> Scene:
    """Hang planks between two posts by two ropes, and let three boxes fall on them."""
    scene, (half, wide, _) = Scene(), PLANK
    tilts = 0.4 * np.linspace(1.0, -1.0, PLANKS)  # rad: the bridge starts as an arc
    steps = 2.0 * half * np.stack([np.cos(tilts), 0.0 * tilts, -np.sin(tilts)], axis=1)
    ends = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    ends += (-0.5 * ends[-1, 0], 0.0, 1.5)
    planks = [
        scene.box(tuple(place), PLANK, is_link=True, tilt=float(tilt))
        for place, tilt in zip(0.5 * (ends[:-1] + ends[1:]), tilts, strict=True)
    ]
    post, other = ends[0], ends[-1]
    for y, add in ((-wide, scene.join), (wide, scene.close)):
        add(-1, planks[0], (post[0], y, post[2]), (-half, y, 0.0))
        for before, plank in zip(planks[:-1], planks[1:], strict=True):
            add(before, plank, (half, y, 0.0), (-half, y, 0.0))
    for y in (-wide, wide):
        scene.close(-1, planks[-1], (other[0], y, other[2]), (half, y, 0.0))
    for k, x in enumerate((-0.6, 0.0, 0.6)):
        scene.box((x, 0.1 * (k - 1), 1.6 + 0.3 * k), (0.12, 0.12, 0.12))
    return scene


def seesaw() -> Scene:
    """Let a heavy box fall on one end of a beam, whose other end carries a light box."""
    scene, (light, heavy) = Scene(), LOADS
    scene.builder.add_ground_plane()
    beam = scene.box((0.0, 0.0, PIVOT), BEAM, is_link=True)
    scene.join(-1, beam, (0.0, 0.0, PIVOT), (0.0, 0.0, 0.0), axis=(0, 1, 0))
    scene.box((-0.8, 0.0, PIVOT + BEAM[2] + light), (light, light, light))
    scene.box((0.75, 0.0, PIVOT + 1.0), (heavy, heavy, heavy))
    return scene


def motor() -> Scene:
    """Turn an arm with a drive of velocity against its weight."""
    scene = Scene()
    arm = scene.box((ARM, 0.0, 1.0), (ARM, 0.04, 0.04), is_link=True)
    scene.join(
        -1, arm, (0.0, 0.0, 1.0), (-ARM, 0.0, 0.0), axis=(0, 1, 0), target_qd=SPEED, target_kd=1e3,
        target_ke=0.0,
    )  # fmt: skip
    return scene


def dominoes() -> Scene:
    """Stand dominoes in a row, and push the first."""
    scene = Scene()
    scene.builder.add_ground_plane()
    for k in range(DOMINOES):
        scene.box((SPACING * k, 0.0, DOMINO[2]), DOMINO)
    scene.builder.body_qd[0] = (0.6, 0.0, 0.0, 0.0, 3.0, 0.0)
    return scene


def ragdoll() -> Scene:
    """Let a figure of eleven parts fall down three steps."""
    scene = Scene()
    builder = scene.builder
    builder.add_ground_plane()
    for k in range(3):
        high = 0.2 * (3 - k)
        builder.add_shape_box(
            -1, xform=((0.4 * k, 0.0, 0.5 * high), UPRIGHT), hx=0.2, hy=1.0, hz=0.5 * high
        )
    z = 1.75
    torso = scene.box((0.0, 0.0, z), (0.1, 0.17, 0.28), is_link=True)
    scene.links.append(builder.add_joint_free(torso))

    def limb(parent: int, at: tuple, half: float, width: float, bend: float) -> int:
        """Hang a limb of a half length and width (m) from a point of its parent."""
        size = (width, width, half)
        pose = np.array(builder.body_q[parent])[:3] + at - (0.0, 0.0, half + 0.01)
        part = scene.box(tuple(float(v) for v in pose), size, is_link=True)
        scene.join(
            parent, part, at, (0.0, 0.0, half + 0.01), limit_angle=bend, limit_ke=200.0,
            limit_kd=5.0,
        )  # fmt: skip
        return part

    head = scene.box((0.0, 0.0, z + 0.42), (0.09, 0.08, 0.11), is_link=True)
    scene.join(
        torso, head, (0, 0, 0.295), (0, 0, -0.125), limit_angle=0.6, limit_ke=200.0, limit_kd=5.0
    )
    for side in (-1, 1):
        upper = limb(torso, (0.0, 0.24 * side, 0.24), 0.14, 0.045, 1.5)
        limb(upper, (0.0, 0.0, -0.15), 0.13, 0.04, 1.2)
        thigh = limb(torso, (0.0, 0.1 * side, -0.29), 0.2, 0.065, 1.0)
        limb(thigh, (0.0, 0.0, -0.21), 0.2, 0.055, 1.0)
    builder.body_qd[torso] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    return scene


def turned(poses: np.ndarray, point: tuple) -> np.ndarray:
    """Return a point of a body in the world (m), for poses {n, 7}."""
    q, v = poses[:, 3:6], np.array(point, float)
    t = 2.0 * np.cross(q, v)
    return poses[:, :3] + v + poses[:, 6:] * t + np.cross(q, t)


def largest_gap(scene: Scene, poses: np.ndarray) -> float:
    """Return the largest gap (m) of a joint in all frames."""
    gap = 0.0
    for parent, child, at, to in scene.joints:
        end = np.array(at, float) if parent < 0 else turned(poses[:, parent], at)
        gap = max(gap, float(np.linalg.norm(end - turned(poses[:, child], to), axis=1).max()))
    return gap


def check_bridge(poses: np.ndarray) -> dict[str, bool]:
    """Return the checks of the bridge."""
    planks, boxes = poses[-1, :PLANKS], poses[-1, PLANKS:]
    lies = [box[2] > planks[np.abs(planks[:, 0] - box[0]).argmin(), 2] + 0.1 for box in boxes]
    return {"boxes that lie on planks": all(lies)}


def check_seesaw(poses: np.ndarray) -> dict[str, bool]:
    """Return the checks of the seesaw. The height of the throw has the bound of the energy."""
    light, heavy = LOADS
    throw = poses[:, 1, 2].max() - poses[0, 1, 2]
    fall = poses[0, 2, 2] - poses[:, 2, 2].min()
    bound = fall * (heavy / light) ** 3
    print(f"the light box rises by {throw:.2f} m, the heavy box falls by {fall:.2f} m")
    return {"a throw of more than 0.3 m": throw > 0.3, "no energy from nothing": throw < bound}


def check_motor(poses: np.ndarray) -> dict[str, bool]:
    """Return the check of the motor: it turns by the angle of its speed."""
    q = poses[:, 0]
    angle = np.unwrap(2.0 * np.arctan2(q[:, 4], q[:, 6]))
    rate = float(angle[-1] - angle[30]) * FPS / (len(q) - 31)
    print(f"the motor turns with {rate:.3f} rad/s")
    return {"the speed of the drive to 1 %": abs(rate / SPEED - 1.0) < 0.01}


def check_dominoes(poses: np.ndarray) -> dict[str, bool]:
    """Return the check of the dominoes."""
    fallen = int((poses[-1, :, 2] < 0.75 * DOMINO[2]).sum())
    print(f"{fallen} of {DOMINOES} dominoes fell")
    return {"dominoes that all fall": fallen == DOMINOES}


def check_ragdoll(poses: np.ndarray) -> dict[str, bool]:
    """Return the checks of the ragdoll."""
    still = np.abs(poses[-1, :, :3] - poses[-7, :, :3]).max() < 0.02
    return {"a figure that lies": poses[-1, 0, 2] < 1.0, "a figure at rest": still}


# Scene -> its function, checks, frames that the checks need, position and target of the camera.
SCENES: dict[str, tuple[Callable, Callable, int, tuple]] = {
    "bridge": (bridge, check_bridge, 240, ((0.8, -4.2, 2.2), (0.0, 0.0, 1.2))),
    "seesaw": (seesaw, check_seesaw, 60, ((0.6, -4.5, 1.8), (0.0, 0.0, 0.7))),
    "motor": (motor, check_motor, 120, ((0.6, -3.5, 1.4), (0.0, 0.0, 1.0))),
    "dominoes": (dominoes, check_dominoes, 150, ((0.9, -4.0, 1.8), (1.5, 0.0, 0.2))),
    "ragdoll": (ragdoll, check_ragdoll, 240, ((1.6, -3.8, 1.9), (0.5, 0.0, 0.7))),
}


def simulate(model: novaphy.Model, frames: int, stage: viewer.Stage) -> np.ndarray:
    """Return the poses {frames + 1, bodies, 7} of every frame."""
    poses = []
    for run in stage.runs(frames):
        solver, pipeline = SolverVBD(model), novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        state, after = model.state(), model.state()
        poses = [state.body_q.numpy()]
        stage.show(0.0, state)
        for frame in run:
            for _ in range(SUBSTEPS):
                state.clear_forces()
                stage.apply_forces(state)
                pipeline.collide(state, contacts)
                solver.step(state, after, None, contacts, DT)
                state, after = after, state
            poses.append(state.body_q.numpy())
            stage.show(frame / FPS, state, contacts)
    return np.array(poses, float)


def plot(path: str, poses: np.ndarray) -> None:
    """Draw the paths of the centers of the bodies from the side."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8.0, 4.0), layout="constrained")
    for body in range(poses.shape[1]):
        axes.plot(poses[:, body, 0], poses[:, body, 2], lw=0.8, color="#adb5bd")
    axes.plot(poses[-1, :, 0], poses[-1, :, 2], "o", color="#2a6f97", markersize=4)
    axes.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", title="Centers of the bodies")
    figure.savefig(path, dpi=110)


def main() -> int:
    """Simulate a scene, draw and check. Return 0 if every check passed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", choices=sorted(SCENES), default="bridge")
    viewer.add_arguments(parser, 240, "frames of 1/60 s")
    parser.add_argument("--plot", metavar="PATH.png", help="draw the paths of the bodies")
    args = parser.parse_args()
    viewer.check_arguments(parser, args)
    build, check, least, look = SCENES[args.scene]
    scene = build()
    model = scene.finalize()
    with viewer.Stage(args, model, fps=FPS, look=look) as stage:
        poses = simulate(model, args.headless, stage)
    if args.plot:
        plot(args.plot, poses)
    gap = largest_gap(scene, poses)
    print(f"{args.scene}: largest gap of a joint {1e3 * gap:.3f} mm")
    checks = {"joints that stay together": gap < 5e-3}
    if args.headless >= least:
        checks |= check(poses)
    else:
        print(f"not checked: the motion, which needs {least} frames")
    faults = [name for name, passed in checks.items() if not passed]
    for fault in faults:
        print(f"CHECK FAILED: expected {fault}")
    if not faults:
        print("ok")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
