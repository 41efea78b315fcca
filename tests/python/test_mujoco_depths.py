"""Depths and normals of overlapping shapes against MuJoCo.

MuJoCo is an oracle, not the measure: of two boxes or hulls that overlap deeply it often takes
another axis than the best (tests/collision/test_convex_pairs.cpp has exact values).
"""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

mujoco = pytest.importorskip("mujoco", reason="compares with MuJoCo, which is not installed")

POSES = 60
CORNERS = np.random.default_rng(8).normal(size=(2, 12, 3))
HULLS = (0.25 * CORNERS / np.linalg.norm(CORNERS, axis=2, keepdims=True)).astype(np.float32)
# For each type: its size in MuJoCo, and the method and arguments of the builder.
SHAPES = {
    "sphere": ("0.2", "sphere", {"radius": 0.2}),
    "capsule": ("0.1 0.2", "capsule", {"radius": 0.1, "half_height": 0.2}),
    "box": ("0.15 0.2 0.25", "box", {"hx": 0.15, "hy": 0.2, "hz": 0.25}),
    "ellipsoid": ("0.15 0.2 0.25", "ellipsoid", {"rx": 0.15, "ry": 0.2, "rz": 0.25}),
    "cylinder": ("0.15 0.2", "cylinder", {"radius": 0.15, "half_height": 0.2}),
}
PAIRS = [
    ("sphere", "sphere"),
    ("sphere", "capsule"),
    ("sphere", "box"),
    ("capsule", "capsule"),
    ("box", "box"),
    ("hull", "hull"),
    ("sphere", "hull"),
    ("box", "hull"),
    ("ellipsoid", "box"),
    ("ellipsoid", "hull"),
    ("cylinder", "box"),
]


def add(builder, body, name, which):
    if name == "hull":
        builder.add_shape_convex_hull(body, vertices=HULLS[which])
    else:
        _, kind, sizes = SHAPES[name]
        getattr(builder, f"add_shape_{kind}")(body, **sizes)


def geom(name, which):
    if name == "hull":
        return f'<geom type="mesh" mesh="hull{which}"/>'
    return f'<geom type="{name}" size="{SHAPES[name][0]}"/>'


def mujoco_model(pair):
    meshes = "".join(
        f'<mesh name="hull{k}" vertex="{" ".join(map(str, HULLS[k].ravel()))}" inertia="exact"/>'
        for k in range(2)
    )
    bodies = "".join(
        f"<body><freejoint/>{geom(name, which)}</body>" for which, name in enumerate(pair)
    )
    text = f"""<mujoco><option ccd_tolerance="1e-10" ccd_iterations="200"/>
        <asset>{meshes}</asset><worldbody>{bodies}</worldbody></mujoco>"""
    return mujoco.MjModel.from_xml_string(text)


def random_poses(random):
    q = random.normal(size=(2, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    away = random.normal(size=3)
    away *= random.uniform(0.15, 0.4) / np.linalg.norm(away)
    return np.concatenate([[(0, 0, 0), away], q], axis=1).astype(np.float32)


def turn(q, v):
    return v + 2 * np.cross(q[:3], np.cross(q[:3], v) + q[3] * v)


def reach(name, which, n):
    """How far a shape reaches along a unit vector of its own frame."""
    if name == "hull":
        return (HULLS[which].astype(float) @ n).max()
    size = [float(x) for x in SHAPES[name][0].split()]
    if name == "sphere":
        return size[0]
    if name == "box":
        return np.abs(n) @ size
    if name == "ellipsoid":
        return np.linalg.norm(n * size)
    side = 1.0 if name == "capsule" else np.hypot(n[0], n[1])
    return size[0] * side + size[1] * abs(n[2])


def separation(pair, poses, n):
    """Of two shapes along a unit vector from the first to the second, in double precision."""
    inward = [
        turn(np.append(-q[3:6], q[6]), sign * n) for q, sign in zip(poses, (1, -1), strict=True)
    ]
    reaches = [reach(name, k, inward[k]) for k, name in enumerate(pair)]
    return (poses[1, :3] - poses[0, :3]) @ n - sum(reaches)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_depths_and_normals_are_those_of_mujoco(pair):
    random = np.random.default_rng(11)
    builder = novaphy.ModelBuilder()
    poses = [random_poses(random) for _ in range(POSES)]
    for both in poses:
        builder.begin_world()
        for which, name in enumerate(pair):
            add(builder, builder.add_body(xform=tuple(map(float, both[which]))), name, which)
        builder.end_world()
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model)
    contacts, state = pipeline.contacts(), model.state()
    pipeline.collide(state, contacts)
    bodies, q = model.shape_body.numpy(), state.body_q.numpy().astype(float)
    found = {}
    for row in contacts.rigid_contacts():
        body = [bodies[row[f"shape{k}"]] for k in (0, 1)]
        ends = [
            q[b, :3] + turn(q[b, 3:], row[f"point{k}"].astype(float)) for k, b in enumerate(body)
        ]
        normal = row["normal"].astype(float)
        distance = (ends[1] - ends[0]) @ normal - row["margin0"] - row["margin1"]
        sign = 1 if body[0] < body[1] else -1
        if distance < found.get(body[0] // 2, (np.inf,))[0]:
            found[body[0] // 2] = (distance, sign * normal)

    oracle = mujoco_model(pair)
    data = mujoco.MjData(oracle)
    overlapping = mujoco_deeper = wrong_normal = 0
    for k, both in enumerate(poses):
        for which in range(2):
            p = both[which]
            data.qpos[7 * which : 7 * which + 7] = (*p[:3], p[6], *p[3:6])
        mujoco.mj_kinematics(oracle, data)
        mujoco.mj_collision(oracle, data)
        if data.ncon == 0:
            assert found.get(k, (1.0,))[0] > -1e-5, k
            continue
        deepest = int(np.argmin(data.contact.dist[: data.ncon]))
        depth, normal = data.contact.dist[deepest], data.contact.frame[deepest][:3]
        if depth > -1e-4:
            continue
        overlapping += 1
        # The depth along any direction is a bound of the smallest, that of MuJoCo's normal too.
        assert found[k][0] > separation(pair, both.astype(float), normal) - 2e-5, k
        if found[k][0] > depth + 2e-5:
            mujoco_deeper += 1
            continue
        wrong_normal += found[k][1] @ normal < np.cos(np.radians(1.0))
    assert overlapping > POSES / 3
    assert mujoco_deeper <= overlapping // 3
    assert wrong_normal <= max(1, overlapping // 10), "two directions may be equally good"
