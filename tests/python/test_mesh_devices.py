"""Triangle meshes on a CUDA device: the rows of random pairs have the bits of the CPU."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import CollisionPipeline, ModelBuilder
from novaphy.testing import assert_same_bits

pytestmark = pytest.mark.skipif(
    not novaphy.is_device_available("cuda:0"), reason="there is no CUDA device"
)

PAIRS, ROUNDS = 2000, 10
APART = 4.0  # m, between pairs


def grid(count: int, cell: float, height) -> tuple[np.ndarray, np.ndarray]:
    """Return a terrain of 2 count^2 triangles."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    at = cell * (np.stack([i, j], -1).reshape(-1, 2) - count / 2)
    first = (i[:-1, :-1] * (count + 1) + j[:-1, :-1]).ravel()
    right, behind = first + count + 1, first + 1
    faces = np.stack([first, right, right + 1, first, right + 1, behind], -1)
    return np.column_stack([at, height(len(at))]), faces.ravel()


def torus(around: int = 12, across: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Return a ring of 2 around across triangles."""
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = 2 * np.pi * i.ravel() / around, 2 * np.pi * j.ravel() / across
    radius = 0.5 + 0.2 * np.cos(b)
    vertices = np.column_stack([radius * np.cos(a), radius * np.sin(a), 0.2 * np.sin(b)])
    next_i, next_j = (i + 1) % around, (j + 1) % across
    corner = [i * across + j, next_i * across + j, next_i * across + next_j, i * across + next_j]
    return vertices, np.stack([corner[k].ravel() for k in (0, 1, 2, 0, 2, 3)], -1).ravel()


def pairs_with_meshes(random: np.random.Generator) -> ModelBuilder:
    """Return bodies 2 k with a mesh, and bodies 2 k + 1 with a shape of each type in turn."""
    meshes = [
        grid(8, 0.25, lambda n: random.uniform(-0.15, 0.15, n)),
        grid(16, 0.1, lambda n: random.uniform(-0.02, 0.02, n)),
        grid(4, 0.5, np.zeros),
        torus(),
        torus(5, 4),
    ]
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) - 0.5
    builder = ModelBuilder(gravity=(0, 0, 0))

    def add_mesh(body: int, which: int, scale: float) -> None:
        vertices, faces = meshes[which % len(meshes)]
        builder.add_shape_mesh(
            body, vertices=np.float32(vertices), indices=np.int32(faces), scale=scale
        )

    others = (
        lambda body, _: builder.add_shape_sphere(body, radius=0.2),
        lambda body, _: builder.add_shape_capsule(body, radius=0.15, half_height=0.3),
        lambda body, _: builder.add_shape_box(body, hx=0.2, hy=0.25, hz=0.15),
        lambda body, _: builder.add_shape_cylinder(body, radius=0.2, half_height=0.25),
        lambda body, _: builder.add_shape_cone(body, radius=0.25, half_height=0.25),
        lambda body, _: builder.add_shape_ellipsoid(body, rx=0.2, ry=0.3, rz=0.15),
        lambda body, _: builder.add_shape_convex_hull(body, vertices=np.float32(0.6 * corners)),
        lambda body, pair: add_mesh(body, pair // 7, 0.6),
    )
    inertia = np.eye(3, dtype=np.float32)
    for pair in range(PAIRS):
        first, second = (
            builder.add_body(mass=1.0, inertia=inertia, lock_inertia=True) for _ in range(2)
        )
        add_mesh(first, pair, 1.0)
        others[pair // len(meshes) % len(others)](second, pair)
    return builder


def random_poses(random: np.random.Generator) -> np.ndarray:
    """Return poses {2 PAIRS, 7}, for three tenths of the pairs without a rotation."""
    k = np.arange(PAIRS)
    poses = np.zeros((2, PAIRS, 7), np.float32)
    poses[..., :3] = APART * np.column_stack([k % 100, k // 100, 0 * k])
    away = random.normal(size=(PAIRS, 3))
    away *= random.uniform(0, 0.75, (PAIRS, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    poses[1, :, :3] += np.float32(away)
    turns = random.normal(size=(2, PAIRS, 4))
    turns[:, random.uniform(size=PAIRS) < 0.3] = (0, 0, 0, 1)
    poses[..., 3:] = turns / np.linalg.norm(turns, axis=-1, keepdims=True)
    return poses.transpose(1, 0, 2).reshape(-1, 7)


@pytest.mark.filterwarnings("ignore")
def test_random_pairs_have_the_rows_of_the_cpu():
    random = np.random.default_rng(0)
    builder = pairs_with_meshes(random)
    candidates = np.arange(2 * PAIRS, dtype=np.int32).reshape(-1, 2)
    sides = []
    for device in ("cpu", "cuda:0"):
        model = builder.finalize(device=device)
        pipeline = CollisionPipeline(model, shape_pairs_filtered=candidates)
        sides.append((model.state(), pipeline, pipeline.contacts()))
    rows = 0
    for _ in range(ROUNDS):
        poses, found = random_poses(random), []
        for state, pipeline, contacts in sides:
            state.body_q.assign(poses)
            pipeline.collide(state, contacts)
            names = ("count", "shape0", "shape1", "point0", "point1", "normal", "point_id")
            found.append([getattr(contacts, f"rigid_contact_{name}").numpy() for name in names])
        for on_cpu, on_device in zip(*found, strict=True):
            assert_same_bits(on_device, on_cpu)
        rows += int(found[0][0][0])
    assert rows > 5 * PAIRS * ROUNDS
