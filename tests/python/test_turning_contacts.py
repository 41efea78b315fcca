"""Contacts of two bodies of articulations: points and normals turn with both of them.

Against differences of a step that finds its contacts anew, against a closed form of an impact, and
the tangent against the adjoint.
"""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

DT = 0.01
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def turned(*axis_and_angle: float) -> tuple[float, ...]:
    """A quaternion (x, y, z, w) of an axis that need not be a unit vector, and an angle."""
    axis = np.float64(axis_and_angle[:3])
    axis *= np.sin(axis_and_angle[3] / 2) / np.linalg.norm(axis)
    return (*axis, np.cos(axis_and_angle[3] / 2))


CORNERS = np.float32([(x, y, z) for x in (-0.1, 0.1) for y in (-0.12, 0.12) for z in (-0.08, 0.08)])
TRIANGLES = np.int32(
    [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
)
# The planes of two faces that share a side pass near the middle of its edges.
ROUGHNESS = 1e-5 * np.float32(
    [
        [-2, 75, -8],
        [-36, 22, -14],
        [-15, -40, -8],
        [66, 81, 32],
        [-41, 16, -66],
        [6, 20, -32],
        [6, 20, -47],
        [-30, -18, 2],
    ]
)
SHAPES = {
    "sphere": {"radius": 0.1},
    "capsule": {"radius": 0.06, "half_height": 0.15},
    "box": {"hx": 0.1, "hy": 0.12, "hz": 0.08},
    "cylinder": {"radius": 0.1, "half_height": 0.12},
    "cone": {"radius": 0.1, "half_height": 0.12},
    "ellipsoid": {"rx": 0.15, "ry": 0.1, "rz": 0.07},
    "convex_hull": {"vertices": np.float32(np.concatenate([np.eye(3), -np.eye(3)]) * 0.1)},
    "hull of a box": {"vertices": CORNERS},  # the box above
    "mesh of a box": {"vertices": CORNERS, "indices": TRIANGLES},
    "rough hull": {"vertices": CORNERS + ROUGHNESS},
    "long box": {"hx": 0.0783, "hy": 0.1432, "hz": 0.0895},
}
METHODS = {"hull of a box": "convex_hull", "mesh of a box": "mesh", "rough hull": "convex_hull"}
METHODS["long box"] = "box"
# Pairs whose search is exact to rounding, because a step is compared with differences.
# tests/dynamics/test_witness_points.cpp has all pairs of features.
# The shapes of two free bodies with their poses, of which the second is above the first; "ground":
# the plane z = 0 of the world.
PAIRS = {
    "spheres": ("sphere", (0, 0, 0, *UPRIGHT), "sphere", (-0.05, 0.03, 0.18, *UPRIGHT)),
    "sphere on capsule": (
        "capsule",
        (0, 0, 0, *turned(0.2, 1, 0, 1.4)),
        "sphere",
        (0.03, 0.05, 0.15, *UPRIGHT),
    ),
    "sphere on a capsule's end": (
        "capsule",
        (0, 0, 0, *turned(1, 0.3, 0, 0.3)),
        "sphere",
        (0.0, -0.02, 0.295, *UPRIGHT),
    ),
    "crossing capsules": (
        "capsule",
        (0, 0, 0, *turned(0, 1, 0, 1.5)),
        "capsule",
        (0.02, 0.03, 0.117, *turned(1, 0.2, 0, 1.4)),
    ),
    "sphere on a face": (
        "box",
        (0, 0, 0, *turned(1, 2, 0, 0.3)),
        "sphere",
        (0.02, 0, 0.17, *UPRIGHT),
    ),
    "sphere on an edge": (
        "box",
        (0, 0, 0, *turned(0, 1, 0.1, 0.8)),
        "sphere",
        (0.005, 0.02, 0.217, *UPRIGHT),
    ),
    "corner on a face": (
        "box",
        (0, 0, 0, *turned(1, 2, 0, 0.1)),
        "box",
        (0.02, 0.01, 0.23, *turned(1, -1.3, 0.2, 0.7)),
    ),
    "crossing edges": (
        "box",
        (0, 0, 0, *turned(0, 1, 0.1, 0.75)),
        "box",
        (0.01, 0.02, 0.245, *turned(1, 0.1, 0, 0.8)),
    ),
    "capsule on an edge": (
        "box",
        (0, 0, 0, *turned(0, 1, 0.05, 0.8)),
        "capsule",
        (0.0, 0.01, 0.18, *turned(1, 0.1, 0, 1.5)),
    ),
    "leaning cylinder": (
        "ground",
        (),
        "cylinder",
        (0, 0, 0.145, *turned(0.6, 0.8, 0, 0.4)),
    ),
    "sphere on a cylinder's side": (
        "cylinder",
        (0, 0, 0, *turned(0.2, 1, 0, 1.4)),
        "sphere",
        (0.03, 0.05, 0.185, *UPRIGHT),
    ),
    "sphere on a rim": (
        "cylinder",
        (0, 0, 0, *turned(0.3, 1, 0, 0.6)),
        "sphere",
        (-0.02, 0.02, 0.254, *UPRIGHT),
    ),
    "sphere on a base": (
        "cylinder",
        (0, 0, 0, *turned(0.3, 1, 0, 0.2)),
        "sphere",
        (0.02, 0.01, 0.22, *UPRIGHT),
    ),
    "sphere on a cone": (
        "cone",
        (0, 0, 0, *turned(0.2, 1, 0, 1.0)),
        "sphere",
        (0.02, 0.02, 0.152, *UPRIGHT),
    ),
    "apex on a face": (
        "box",
        (0, 0, 0, *turned(1, 2, 0, 0.1)),
        "cone",
        (0.02, 0.01, 0.196, *turned(1, 0.2, 0, 2.9)),
    ),
    "rim on a face": (
        "box",
        (0, 0, 0, *turned(1, 2, 0, 0.1)),
        "cylinder",
        (0.02, 0.01, 0.22, *turned(0.6, 0.8, 0, 0.4)),
    ),
    "hull on a face": (
        "box",
        (0, 0, 0, *turned(1, 2, 0, 0.1)),
        "convex_hull",
        (0.02, 0.01, 0.175, *turned(1, -1.3, 0.2, 0.2)),
    ),
    "rolling ellipsoid": ("ground", (), "ellipsoid", (0, 0, 0.077, *turned(0.3, -0.2, 1, 0.5))),
}
# The same on a hull and on a mesh with the corners of the box. A mesh that meets edges and corners
# also has contacts at its diagonals, whose points are frozen.
OF_HULLS = {
    "sphere on a face": ("sphere",),
    "sphere on an edge": ("sphere",),
    "corner on a face": ("box", "hull of a box"),
    "crossing edges": ("box", "hull of a box"),
    "capsule on an edge": ("capsule",),
    "apex on a face": ("cone",),
    "hull on a face": ("convex_hull",),
}
OF_MESHES = ("sphere on a face", "sphere on an edge", "capsule on an edge", "apex on a face")
for of_box, shapes in OF_HULLS.items():
    for above in shapes:
        PAIRS[f"{of_box} of a hull: {above}"] = (
            "hull of a box",
            PAIRS[of_box][1],
            above,
            PAIRS[of_box][3],
        )
for of_box in OF_MESHES:
    PAIRS[f"{of_box} of a mesh"] = ("mesh of a box", *PAIRS[of_box][1:])
PAIRS["ball on a hull's corner"] = (
    "hull of a box",
    (0, 0, 0, *turned(1, 1, 0, 0.9)),
    "sphere",
    (0.0, 0.0, 0.26, *UPRIGHT),
)
PAIRS["crossing edges of a rough hull"] = (
    "rough hull",
    (0, 0, 0, -0.23988, 0.6449, -0.51068, -0.51552),
    "long box",
    (0.02116, -0.06086, 0.24096, -0.03827, 0.01868, -0.0054, 0.99908),
)
# The normal leans by 2 degrees from a face, whose outline cuts the edge above it. A second point of
# that edge is 7 mm above the face.
ALMOST_FLAT = "edge on an edge, almost flat"
NEAR_FACES = {
    ALMOST_FLAT: (
        "hull of a box",
        (0, 0, 0, *turned(0.1, 1, 0, 0.01)),
        "box",
        (0.01, 0.054, 0.2175, *turned(1, 0.08, 0, 0.6)),
    )
}
MOTIONS = {
    "sticking": (0.5, (0.02, 0.01, -0.6, 0.1, 0.2, 0.1), 0.0),
    "sliding": (0.3, (1.1, 0.4, -0.5, 0.3, -0.2, 0.6), 0.0),
    "bouncing": (0.2, (0.8, -0.3, -1.5, 0.2, 0.1, -0.4), 0.6),
}


def two_bodies(name: str, motion: str) -> novaphy.Model:
    mu, twist, restitution = MOTIONS[motion]
    builder = novaphy.ModelBuilder()
    of = novaphy.ShapeConfig(mu=mu, restitution=restitution, density=0, gap=0.03)
    below, place, above, at = {**PAIRS, **NEAR_FACES}[name]
    bodies = [(above, at, twist)]
    if below == "ground":
        builder.add_ground_plane(cfg=of)
    else:
        bodies.insert(0, (below, place, (0.1, -0.2, 0.1, 0.3, 0.1, -0.2)))
    for shape, pose, speed in bodies:
        body = builder.add_body(
            xform=(pose[:3], pose[3:]), mass=1.0, inertia=np.diag([0.01, 0.012, 0.008])
        )
        builder.body_qd[body] = speed
        add = getattr(builder, f"add_shape_{METHODS.get(shape, shape)}")
        add(body, cfg=of, **SHAPES[shape])
    return builder.finalize(requires_grad=True)


class Step:
    """A step from the start of a model, whose contacts are found from the state."""

    def __init__(self, model: novaphy.Model) -> None:
        self.model = model
        self.solver = novaphy.solvers.DiffFeatherstoneSolver(
            model,
            contact_gradient="code",
            angular_damping=0.0,
            pgs_iterations=4000,
            pgs_tolerance=1e-9,
            pgs_slop=0.0,
            pgs_erp=1.0,
        )
        self.pipeline = novaphy.CollisionPipeline(model)
        rng = np.random.default_rng(3)
        counts = (model.joint_coord_count, model.joint_dof_count)
        self.weights = [np.float32(rng.normal(size=n)) for n in counts]

    def start(self, q: np.ndarray, qd: np.ndarray) -> novaphy.SimState:
        before = self.model.state()
        before.joint_q.assign(np.float32(q))
        before.joint_qd.assign(np.float32(qd))
        novaphy.eval_fk(self.model, before.joint_q, before.joint_qd, before)
        return before

    def run(self, before: novaphy.SimState) -> novaphy.SimState:
        after, contacts = self.model.state(), self.pipeline.contacts()
        self.pipeline.collide(before, contacts)
        self.solver.step(before, after, None, contacts, DT)
        return after

    def value(self, q: np.ndarray, qd: np.ndarray) -> float:
        after = self.run(self.start(q, qd))
        ends = (after.joint_q.numpy(), after.joint_qd.numpy())
        return sum(
            float(np.float64(w) @ np.float64(x)) for w, x in zip(self.weights, ends, strict=True)
        )


def moved(q: np.ndarray, tangent: np.ndarray, eps: float) -> np.ndarray:
    """FREE coordinates of bodies moved along (linear, rotation vector), with unit quaternions."""
    to = np.float64(q).reshape(-1, 7).copy()
    for row, part in zip(to, tangent.reshape(-1, 6), strict=True):
        row[:3] += eps * part[:3]
        angle = eps * np.linalg.norm(part[3:])
        x, y, z, w = turned(*part[3:], angle) if angle else UPRIGHT
        a, b, c, d = row[3:].copy()
        row[3:] = [
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        ]
    return to.ravel()


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("name", PAIRS)
def test_a_step_has_the_gradient_of_contacts_found_anew(name: str, motion: str) -> None:
    from novaphy import diff, nova

    step = Step(two_bodies(name, motion))
    q, qd = step.model.joint_q.numpy(), step.model.joint_qd.numpy()
    rng = np.random.default_rng(5)
    along = (np.float32(rng.normal(size=q.size)), np.float32(rng.normal(size=qd.size)))
    before = step.start(q, qd)
    with nova.Tape() as tape:
        after = step.run(before)
        ends = (diff.state_joint_q_tensor(after), diff.state_joint_qd_tensor(after))
        loss = sum(nova.sum(x * nova.tensor(w)) for x, w in zip(ends, step.weights, strict=True))
        tape.backward(loss)
        start = [diff.state_joint_q_tensor(before), diff.state_joint_qd_tensor(before)]
        tangent = tape.jvp([loss], start, [nova.tensor(x) for x in along])[0].item()
    info = step.solver.gradient_info()
    assert info.label == "exact of the code" and info["frozen_contacts"] == 0, info.reason
    assert info["sticking"] + info["sliding"] > 0
    of_q, of_qd = before.joint_q.grad.numpy(), before.joint_qd.grad.numpy()
    parts = np.concatenate([of_q * along[0], of_qd * along[1]])
    assert abs(tangent - parts.sum()) < 1e-5 * np.abs(parts).sum()

    differences, ours = [], []
    for unit in np.eye(qd.size):
        eps = 4e-4
        there, back = (moved(q, unit, sign * eps) for sign in (1, -1))
        differences.append((step.value(there, qd) - step.value(back, qd)) / (2 * eps))
        ours.append(of_q @ (there - back) / (2 * eps))
    scale = np.abs(differences).max()
    np.testing.assert_allclose(ours, differences, atol=4e-3 * scale)
    for k in range(qd.size):
        d = 2e-3 * np.eye(qd.size)[k]
        difference = (step.value(q, qd + d) - step.value(q, qd - d)) / 4e-3
        assert abs(of_qd[k] - difference) < 4e-3 * max(1.0, abs(difference)), k


@pytest.mark.parametrize("motion", ["sticking", "sliding"])
def test_an_edge_is_cut_by_the_outline_of_an_almost_parallel_face(motion: str) -> None:
    test_a_step_has_the_gradient_of_contacts_found_anew(ALMOST_FLAT, motion)


def test_the_second_point_of_an_edge_over_a_face_is_frozen() -> None:
    """The normal is across the edges at the first point. It is that of no feature at the second."""
    from novaphy import nova

    step = Step(two_bodies(ALMOST_FLAT, "bouncing"))
    before = step.start(step.model.joint_q.numpy(), step.model.joint_qd.numpy())
    with nova.Tape():
        step.run(before)
    info = step.solver.gradient_info()
    assert info["sliding"] == 2 and info["frozen_contacts"] == 1 and info.label == "frozen"


RADIUS, MASSES, RESTITUTION = 0.1, (1.0, 2.0), 0.8
START = np.float64([0.0, 0.0, 0.5, 0.08, 1.0, 0.0, 0.0, 0.0])  # x, z of both, then their rates


def collide(start: np.ndarray, time: float) -> np.ndarray:
    """Two discs without friction after one impact."""
    x, v = start[:4].reshape(2, 2), start[4:].reshape(2, 2)
    apart, speed = x[1] - x[0], v[1] - v[0]
    a, b, c = speed @ speed, apart @ speed, apart @ apart - 4 * RADIUS**2
    at = (-b - np.sqrt(b * b - a * c)) / a
    x = x + at * v
    n = (x[1] - x[0]) / (2 * RADIUS)
    push = -(1 + RESTITUTION) * (n @ speed) / sum(1 / m for m in MASSES)
    v = v + np.outer([-push / MASSES[0], push / MASSES[1]], n)
    return np.concatenate([(x + (time - at) * v).ravel(), v.ravel()])


DISCS = {
    "sphere": {"radius": RADIUS},
    "ellipsoid": {"rx": RADIUS, "ry": RADIUS, "rz": RADIUS},
    "cylinder": {"radius": RADIUS, "half_height": 0.2, "xform": ((0, 0, 0), turned(1, 0, 0, 1.57))},
}


def discs_of_the_engine(
    mode: str, time: float, steps: int, shapes: tuple[str, str] = ("sphere", "sphere")
) -> np.ndarray:
    """{8, 8}: the derivative of the end by the start, of shapes that are round seen along y."""
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder(gravity=0.0)
    of = novaphy.ShapeConfig(mu=0.0, restitution=RESTITUTION, density=0, gap=0.1)
    for (x, z), mass, shape in zip(START[:4].reshape(2, 2), MASSES, shapes, strict=True):
        body = builder.add_body(xform=((x, 0, z), UPRIGHT), mass=mass, inertia=np.eye(3) * 0.004)
        getattr(builder, f"add_shape_{shape}")(body, cfg=of, **DISCS[shape])
    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, angular_damping=0.0, pgs_slop=0.0, pgs_erp=1.0, contact_gradient=mode
    )
    path = diff.Trajectory(model, steps)
    rates = np.zeros((2, 6), np.float32)
    rates[:, [0, 2]] = START[4:].reshape(2, 2)
    path[0].joint_qd.assign(rates.ravel())
    first, rows = path[0], []
    with nova.Tape() as tape:
        solver.rollout(path, None, None, time / steps, pipeline=novaphy.CollisionPipeline(model))
        end = [diff.state_joint_q_tensor(path[steps]), diff.state_joint_qd_tensor(path[steps])]
        places = [end[0][i : i + 1] for i in (0, 2, 7, 9)]
        speeds = [end[1][i : i + 1] for i in (0, 2, 6, 8)]
        for value in places + speeds:
            for array in (first.joint_q, first.joint_qd):
                if array.grad is not None:
                    array.grad.assign(np.zeros_like(array.grad.numpy()))
            tape.backward(nova.sum(value))
            q, qd = first.joint_q.grad.numpy(), first.joint_qd.grad.numpy()
            rows.append(np.concatenate([q[[0, 2, 7, 9]], qd[[0, 2, 6, 8]]]))
    if mode == "motion":
        assert solver.gradient_info().label == "exact of the motion"
    return np.array(rows)


def wanted_of_discs(time: float) -> np.ndarray:
    pairs = [(collide(START + d, time), collide(START - d, time)) for d in 1e-6 * np.eye(8)]
    return np.transpose([(there - back) / 2e-6 for there, back in pairs])


def test_two_discs_that_meet_askew_turn_their_normal() -> None:
    """The error is proportional to dt. The bounds are those of the law in float64, times 1.5."""
    time = 0.8
    wanted = wanted_of_discs(time)
    largest = np.abs(wanted).max()

    def error(mode: str, rate: int) -> float:
        found = [
            np.abs(discs_of_the_engine(mode, time, round(time * rate * slower)) - wanted).max()
            for slower in (1.0, 1.037)
        ]
        return float(np.sqrt(np.mean(np.square(found)))) / largest

    errors = [error("motion", rate) for rate in (120, 240, 480)]
    assert np.all(np.array(errors) < 1.5 * np.array([0.030, 0.020, 0.007])), errors
    assert error("code", 480) > 0.3


@pytest.mark.parametrize(
    "shapes", [("sphere", "cylinder"), ("ellipsoid", "ellipsoid"), ("ellipsoid", "cylinder")]
)
def test_curved_shapes_that_meet_askew_turn_their_normal(shapes: tuple[str, str]) -> None:
    time = 0.8
    wanted = wanted_of_discs(time)
    error = np.abs(discs_of_the_engine("motion", time, 384, shapes) - wanted).max()
    assert error < 1.5 * 0.007 * np.abs(wanted).max()
