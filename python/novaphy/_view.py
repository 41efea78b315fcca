"""What `novaphy view` shows: a mesh, or a robot whose joints are moved by sliders."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from . import _core, io
from .viewer import Stage
from .viewer._model_scene import SURFACE_COLOR, boundary_triangles

FPS = 60.0
UNLIMITED = 1e6  # rad or m: a limit beyond is none
REACH = {"rad": math.pi, "m": 1.0}  # of the slider of a joint without limits


def show_robot(args: argparse.Namespace) -> str:
    """Show a .urdf or .xml (MJCF) file until the window is closed; returns what is in it."""
    builder = _core.ModelBuilder()
    is_urdf = Path(args.file).suffix.lower() == ".urdf"
    add = builder.add_urdf if is_urdf else builder.add_mjcf
    add(args.file, package_dirs=args.packages, unsupported="warn")
    model = builder.finalize()
    state, q = model.state(), model.joint_q.numpy()
    with Stage(args, model, fps=FPS) as stage:
        joints = {
            row: stage.add_slider(name, low, high, min(max(float(q[row]), low), high))
            for row, name, low, high in joint_ranges(model)
        }
        start = {row: slider.value for row, slider in joints.items()}
        for turn in stage.turns():
            for row, slider in joints.items():
                if turn == 0:  # also after a reset
                    slider.set(start[row])
                q[row] = slider.value
            if len(q):
                state.joint_q.assign(q)
                _core.eval_fk(model, state.joint_q, state.joint_qd, state)
            stage.show(turn / FPS, state)
    return f"{model.body_count} bodies, {model.shape_count} shapes, {len(joints)} joints to move"


def joint_ranges(model: _core.Model) -> Iterator[tuple[int, str, float, float]]:
    """Row of joint_q, name and range (rad, m) of every coordinate that a slider can move."""
    kinds, labels = model.joint_type.numpy(), model.joint_label
    rows, dofs = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
    lower, upper = model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy()
    turns = (_core.JointType.REVOLUTE, _core.JointType.D6)
    for joint, kind in enumerate(kinds):
        if kind not in (*turns, _core.JointType.PRISMATIC):
            continue
        unit = "rad" if kind in turns else "m"
        count = dofs[joint + 1] - dofs[joint]
        for k in range(count):
            low, high = float(lower[dofs[joint] + k]), float(upper[dofs[joint] + k])
            if not -UNLIMITED < low < high < UNLIMITED:
                low, high = -REACH[unit], REACH[unit]
            axis = f" {k + 1}" if count > 1 else ""
            yield int(rows[joint] + k), f"{labels[joint]}{axis} ({unit})", low, high


def show_mesh(args: argparse.Namespace) -> str:
    """Show the surface of a .msh, .obj, .stl, .ply, .dae or .glb file; returns what is in it."""
    if Path(args.file).suffix.lower() == ".msh":
        tets = io.load_tet_mesh(args.file)
        points, triangles = tets.vertices, boundary_triangles(np.asarray(tets.indices))
        what = f"{len(tets.indices)} tetrahedra"
    else:
        mesh = io.load_mesh(args.file)
        points, triangles = mesh.vertices, np.asarray(mesh.indices)
        what = f"{len(triangles)} triangles"
    with Stage(args, None) as stage:
        for viewer in stage.viewers:
            viewer.begin_frame(0.0)
            viewer.log_mesh("mesh", points, triangles, color=SURFACE_COLOR, backface_culling=False)
            viewer.end_frame()
    lower, upper = np.min(points, axis=0), np.max(points, axis=0)
    return f"{len(points)} points, {what}, from {lower} to {upper}"
