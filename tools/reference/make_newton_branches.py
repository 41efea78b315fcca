#!/usr/bin/env python3
"""Make the golden files `tests/golden/newton_<scene>.npz` by running Newton.

The ball of Newton's `diffsim_ball` example covers few branches of the semi-implicit particle code.
The scenes of this program cover the other branches: friction, tilted shapes with margins, the
inside of a box, several shapes on one particle, the velocity limit, particles without mass or
without the active flag, finite planes, shapes that particles pass through, and spheres and capsules
down to their center and axis.

Newton runs on its CPU device. This device contracts no product and sum, and runs the threads of a
launch in index order, so the files have the same bits in every run. The versions were newton
1.8.0, warp-lang 1.19.0 and numpy 2.4.6 on x86-64. To make the files again, or to compare them:

    pip install newton==1.8.0 warp-lang==1.19.0 numpy
    python tools/reference/make_newton_branches.py
    python tools/reference/make_newton_branches.py --check

All shapes are world-owned. Particle-particle contact is off (`model.particle_grid = None`). An
iteration finds contacts of state 0, runs `sim_steps` semi-implicit substeps, the loss, and the
tape's backward pass. If `regenerate` is 1, every substep finds new contacts, on the tape.

Every file has the same keys, with float32 or int32 values (n particles, s shapes, c contacts):

| key | shape | meaning |
| --- | --- | --- |
| `newton_version`, `warp_version` | {3} | versions that made the file |
| `model_particle_q`, `_qd` | {n,3} | initial position and velocity |
| `model_particle_mass`, `_inv_mass`, `_radius`, `_flags` | {n} | particle properties |
| `model_particle_max_velocity` | {} | velocity limit |
| `model_gravity` | {3} | gravity |
| `model_shape_type`, `_body`, `_flags`, `_margin` | {s} | shape properties |
| `model_shape_transform` | {s,7} | pose in the world, px py pz qx qy qz qw |
| `model_shape_scale` | {s,3} | size |
| `model_shape_material_ke`, `_kd`, `_kf`, `_mu` | {s} | contact material of the shape |
| `model_soft_contact_ke`, `_kd`, `_kf`, `_mu` | {} | contact material of the particles |
| `soft_contact_gap` | {} | detection distance |
| `sim_dt`, `sim_steps`, `regenerate` | {} | substep (s), number of them, 1: new contacts in each |
| `contact_count` | {1} | number of contacts of state 0 |
| `contact_particle`, `contact_shape` | {c} | particle, shape of each contact, in Newton's order |
| `contact_body_pos`, `contact_body_vel`, `contact_normal` | {c,3} | geometry of each contact |
| `contact_counts` | {sim_steps} | number of contacts used in every substep |
| `particle_q`, `particle_qd` | {sim_steps+1,n,3} | states |
| `particle_f` | {sim_steps+1,n,3} | forces of every substep; the last row is zero |
| `target` | {3} | target of the loss |
| `loss` | {1} | sum over the particles of |x_end - target|^2, in particle order |
| `grad_q`, `grad_qd` | {n,3} | gradient of the loss with respect to the initial state |
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import newton
import numpy as np
import warp as wp

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

OUT = Path(__file__).resolve().parents[2] / "tests" / "golden"
IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)
ORIGIN: Vector = (0.0, 0.0, 0.0)
PLANE = int(newton.GeoType.PLANE)
SPHERE = int(newton.GeoType.SPHERE)
CAPSULE = int(newton.GeoType.CAPSULE)
BOX = int(newton.GeoType.BOX)


@dataclass
class Particle:
    """One particle of a scene."""

    q: Vector
    qd: Vector = ORIGIN
    mass: float = 1.0
    radius: float = 0.1
    flags: int = 1


@dataclass
class Shape:
    """One world-owned shape of a scene."""

    type: int
    scale: Vector
    position: Vector = ORIGIN
    rotation: Quaternion = IDENTITY
    ke: float = 1.0e4
    kd: float = 10.0
    kf: float = 0.0
    mu: float = 0.2
    margin: float = 0.0
    collides: bool = True

    def world(self, point: Vector) -> Vector:
        """Return the world position of a point in the shape's frame."""
        q = np.array(self.rotation[:3])
        p = np.array(point)
        t = 2.0 * np.cross(q, p)
        return tuple(np.array(self.position) + p + self.rotation[3] * t + np.cross(q, t))


@dataclass
class Scene:
    """The data that build and run one scene."""

    particles: list[Particle]
    shapes: list[Shape]
    ke: float = 1.0e4
    kd: float = 10.0
    kf: float = 0.0
    mu: float = 0.2
    gap: float = 0.25
    dt: float = 1.0 / 480.0
    steps: int = 40
    max_velocity: float = 1.0e5
    gravity: Vector = (0.0, 0.0, -9.81)
    target: Vector = (0.25, -0.5, 0.75)
    regenerate: bool = False


def axis_angle(axis: Vector, degrees: float) -> Quaternion:
    """Return the unit quaternion of a rotation about an axis."""
    unit = np.array(axis) / np.linalg.norm(axis)
    half = math.radians(degrees) / 2
    x, y, z = (unit * math.sin(half)).tolist()
    return (x, y, z, math.cos(half))


def friction() -> Scene:
    """Return particles that slide on a plane, on both branches of the friction cap, none at rest.

    With the mean kf = 175 and mu = 0.45, the viscous branch holds up to about 0.3 m/s at a depth of
    1 cm. The last particles touch the plane with c = 0 exactly, while they approach and separate.
    """
    velocities: list[Vector] = [
        (0.0, 0.0, 0.0),
        (0.001, 0.0, 0.0),
        (0.1, -0.05, 0.0),
        (0.0, 0.25, -0.5),
        (0.3, 0.3, -0.2),
        (1.0, -2.0, -1.0),
        (-4.0, 0.5, -0.25),
        (3.0, 4.0, 0.5),
    ]
    depths = [0.01, 0.01, 0.012, 0.003, 0.02, 0.0075, 0.0, -0.002]
    particles = [
        Particle((0.4 * i - 1.3, 0.21 * i, 0.1 - depth), velocity, mass=0.6 + 0.2 * i)
        for i, (velocity, depth) in enumerate(zip(velocities, depths, strict=True))
    ]
    for normal_velocity in (-0.7, 0.7):
        particles.append(Particle((2.5, 0.125, 0.125), (0.5, 0.25, normal_velocity), radius=0.125))
    ground = Shape(PLANE, ORIGIN, ke=9.0e3, kd=12.0, kf=250.0, mu=0.6)
    return Scene(particles, [ground], ke=1.1e4, kd=7.0, kf=100.0, mu=0.3)


def tilted_shapes() -> list[Shape]:
    """Return a rotated box, plane, capsule and sphere, with margins and different materials."""
    return [
        Shape(
            BOX,
            (0.7, 0.3, 0.5),
            (-1.2, 0.4, 0.6),
            axis_angle((1.0, 2.0, -0.5), 37.0),
            ke=8.0e3,
            kd=11.0,
            kf=30.0,
            margin=0.03,
        ),
        Shape(
            PLANE,
            ORIGIN,
            (0.1, -0.2, -0.3),
            axis_angle((0.6, -0.3, 0.2), 21.0),
            ke=1.3e4,
            kd=9.0,
            kf=55.0,
            mu=0.7,
            margin=0.015,
        ),
        Shape(
            CAPSULE,
            (0.25, 0.6, 0.0),
            (1.3, 0.2, 0.7),
            axis_angle((-0.4, 1.0, 0.3), 118.0),
            ke=6.0e3,
            kd=5.0,
            kf=80.0,
            mu=0.35,
            margin=0.02,
        ),
        Shape(
            SPHERE,
            (0.45, 0.0, 0.0),
            (0.1, 1.4, 0.8),
            axis_angle((0.2, 0.1, 1.0), -75.0),
            ke=7.5e3,
            kd=8.0,
            kf=20.0,
            mu=0.5,
            margin=0.01,
        ),
    ]


def tilted() -> Scene:
    """Return a scene of rotated shapes with margins, approached from several sides."""
    shapes = tilted_shapes()
    box, plane, capsule, sphere = shapes
    near: list[tuple[Shape, Vector, Vector]] = [
        (box, (0.1, 0.38, -0.2), (0.3, -1.5, 0.2)),
        (box, (-0.78, 0.05, 0.3), (1.2, 0.4, 0.0)),
        (box, (0.75, 0.33, 0.1), (-0.8, -0.9, 0.3)),
        (box, (0.73, -0.34, -0.54), (-1.0, 1.0, 1.0)),
        (plane, (0.3, -0.6, 0.08), (0.4, 0.3, -1.0)),
        (plane, (-0.5, -0.9, 0.2), (-1.4, 0.2, -2.5)),
        (capsule, (0.3, 0.12, 0.2), (-1.1, -0.2, 0.5)),
        (capsule, (0.05, -0.12, 0.9), (0.2, 0.6, -1.7)),
        (capsule, (-0.15, 0.1, -0.87), (0.3, -0.1, 2.0)),
        (sphere, (0.3, -0.4, 0.15), (-0.9, 0.8, -0.1)),
        (sphere, (-0.1, 0.2, 0.49), (0.1, 0.2, -1.3)),
    ]
    particles = []
    for i, (shape, point, direction) in enumerate(near):
        turned = replace(shape, position=ORIGIN).world(direction)
        particles.append(Particle(shape.world(point), turned, 0.5 + 0.15 * i, 0.06 + 0.006 * i))
    return Scene(particles, shapes, ke=1.05e4, kf=45.0, mu=0.4, gap=0.3, gravity=(0.3, -0.4, -9.81))


def tilted_regenerated() -> Scene:
    """Return the scene `tilted` with contacts that are found in every substep."""
    return replace(tilted(), regenerate=True)


def box_interior() -> Scene:
    """Return particles inside a box, on its surface with ties between faces, and outside.

    Positions and half extents are multiples of 1/16, so that ties are exact. The soft material
    keeps the particles inside for some time.
    """
    center = (0.5, -0.25, 1.0)
    half = (0.5, 0.375, 0.5)
    points: list[Vector] = [
        (0.4375, 0.0625, -0.125),  # +x face
        (-0.4375, -0.0625, 0.25),  # -x face
        (0.125, 0.3125, 0.25),  # +y face
        (0.0625, -0.3125, -0.1875),  # -y face
        (0.0625, 0.0, 0.4375),  # +z face
        (-0.125, 0.0625, -0.4375),  # -z face
        (0.0, 0.0, 0.0),  # center
        (0.375, 0.25, 0.0),  # tie of x and y
        (0.4375, 0.0, 0.4375),  # tie of x and z
        (0.0, -0.25, -0.375),  # tie of y and z
        (0.375, -0.25, -0.375),  # tie of all three
        (0.5, 0.375, 0.5),  # corner
        (0.5, 0.375, 0.25),  # edge along z
        (0.125, -0.375, -0.5),  # edge along x
        (-0.5, 0.125, 0.5),  # edge along y
        (0.5, 0.0625, 0.125),  # on the +x face
        (0.0625, -0.375, 0.0),  # on the -y face
        (0.0625, 0.125, 0.5),  # on the +z face
        (0.5625, 0.4375, 0.5625),  # beyond a corner
        (0.5625, -0.4375, 0.125),  # beyond an edge
        (0.1875, 0.0625, 0.625),  # beyond a face
    ]
    particles = []
    for i, point in enumerate(points):
        q = (center[0] + point[0], center[1] + point[1], center[2] + point[2])
        qd = (0.5 - 0.05 * i, 0.03 * i - 0.25, 0.4 * (i % 3 - 1))
        particles.append(Particle(q, qd, mass=1.0 + 0.1 * i, radius=0.125))
    return Scene(
        particles, [Shape(BOX, half, center, ke=800.0, kd=6.0, kf=40.0)], ke=1200.0, kf=20.0, mu=0.5
    )


def box_interior_regenerated() -> Scene:
    """Return the scene `box_interior` with contacts that are found in every substep.

    The gradient follows Newton's rules. At ties and on the surface (particles 6 to 17) it differs
    from finite differences. For example, a length of zero has no gradient in Newton.
    """
    return replace(box_interior(), regenerate=True)


def walls() -> Scene:
    """Return a scene of particles in a corner of up to five shapes."""
    shapes = [
        Shape(PLANE, ORIGIN, kf=20.0),
        Shape(PLANE, ORIGIN, (-0.5, 0.0, 0.0), axis_angle((0.0, 1.0, 0.0), 90.0), ke=7.0e3, mu=0.5),
        Shape(BOX, (2.0, 0.25, 1.0), (0.0, -0.75, 0.5), kd=25.0, kf=60.0),
        Shape(PLANE, ORIGIN, (0.1, 0.1, 0.4), axis_angle((1.0, 1.0, 0.0), 163.0), ke=5.0e3),
        Shape(SPHERE, (0.3, 0.0, 0.0), (-0.1, -0.1, 0.2), ke=1.2e4, mu=0.9, kf=15.0),
    ]
    particles = [
        Particle((-0.42, -0.42, 0.08), (-1.0, -0.7, -0.4), radius=0.1),
        Particle((-0.38, -0.40, 0.14), (-0.3, -0.5, -1.0), radius=0.15, mass=0.7),
        Particle((-0.3, -0.32, 0.2), (0.2, 0.1, 0.3), radius=0.21, mass=2.5),
        Particle((-0.2, -0.42, 0.1), (-2.0, -1.0, -0.5), radius=0.12, mass=1.4),
        Particle((-0.41, 0.1, 0.09), (-0.5, -1.5, -0.2), radius=0.11),
    ]
    return Scene(particles, shapes, ke=1.1e4, kf=35.0, mu=0.3, gap=1.0)


def velocity_clamp() -> Scene:
    """Return particles at, above and below a velocity limit of 3 m/s, with and without contact."""
    velocities: list[Vector] = [
        (0.0, 0.0, -2.9),
        (4.0, 1.0, -2.0),
        (1.8, 2.4, 0.0),
        (0.5, -0.25, 0.1),
        (-3.0, 0.0, -6.0),
        (0.0, 10.0, 10.0),
    ]
    heights = [2.0, 1.0, 1.5, 0.5, 0.15, 0.08]
    particles = [
        Particle((0.5 * i, -0.3 * i, height), velocity, mass=0.8 + 0.3 * i)
        for i, (velocity, height) in enumerate(zip(velocities, heights, strict=True))
    ]
    return Scene(particles, [Shape(PLANE, ORIGIN, kf=25.0)], kf=10.0, gap=10.0, max_velocity=3.0)


def inactive() -> Scene:
    """Return particles without the active flag or without mass, in and out of contact."""
    particles = [
        Particle((0.0, 0.0, 0.08), (0.5, -0.25, -1.0), flags=0),
        Particle((0.5, 0.0, 0.09), (0.5, -0.25, -1.0), mass=0.0),
        Particle((1.0, 0.0, 0.09), (0.5, -0.25, -1.0)),
        Particle((1.5, 0.0, 1.0), (-0.5, 0.75, 2.0), mass=0.0),
        Particle((2.0, 0.0, 1.0), (-0.5, 0.75, 2.0), flags=0, mass=2.0),
        Particle((2.5, 0.0, 0.05), (0.0, 0.5, -0.5), flags=0, mass=0.0),
        Particle((3.0, 0.0, 1.0), (-0.5, 0.75, 2.0), mass=2.0),
    ]
    return Scene(particles, [Shape(PLANE, ORIGIN, kf=50.0)], kf=30.0, gap=10.0)


def finite_plane() -> Scene:
    """Return particles above, at the rim of, beside and below finite planes.

    One plane is tilted, one is finite only in x. Newton's unsigned distance gives contact points on
    the wrong side of particles below, and off the plane for particles beside. A program with a
    consistent rule differs for the particles beside (4, 5, 6 and 10) and below (7 and 11).
    """
    flat = Shape(PLANE, (2.0, 1.0, 0.0), (0.25, -0.5, 0.5), kf=20.0)
    tilt = Shape(
        PLANE,
        (1.5, 1.0, 0.0),
        (4.0, 0.0, 0.5),
        axis_angle((1.0, -0.5, 0.3), 28.0),
        ke=8e3,
        margin=0.02,
    )
    strip = Shape(PLANE, (1.0, 0.0, 0.0), (8.0, 0.0, 0.5), kf=40.0)
    places: list[tuple[Shape, Vector, Vector]] = [
        (flat, (0.3, -0.2, 0.09), (0.5, 0.2, -1.0)),
        (flat, (-0.9, 0.4, 0.2), (-0.3, 0.2, -2.0)),
        (flat, (0.99, 0.49, 0.05), (0.1, 0.1, -0.5)),
        (flat, (0.0, 0.0, 0.0), (0.3, 0.0, 0.2)),
        (flat, (1.05, 0.1, 0.02), (0.4, 0.0, -0.3)),
        (flat, (0.2, 0.58, 0.06), (0.0, 0.6, -0.3)),
        (flat, (1.3, 0.1, 0.02), (-2.0, 0.0, 0.0)),
        (flat, (0.4, 0.1, -0.05), (0.0, 0.2, 0.4)),
        (tilt, (0.2, 0.3, 0.08), (0.4, -0.3, -1.0)),
        (tilt, (-0.5, -0.4, 0.12), (0.0, 0.2, -1.5)),
        (tilt, (0.8, 0.1, 0.03), (0.1, 0.2, -0.5)),
        (tilt, (0.3, -0.2, -0.06), (0.1, 0.2, 0.3)),
        (strip, (0.3, 5.0, 0.08), (0.2, 0.3, -1.0)),
        (strip, (3.0, 0.0, 0.05), (0.2, 0.3, -1.0)),
        (strip, (0.1, 0.2, -0.05), (0.2, 0.3, -0.2)),
    ]
    particles = []
    for i, (shape, point, direction) in enumerate(places):
        turned = replace(shape, position=ORIGIN).world(direction)
        particles.append(Particle(shape.world(point), turned, mass=1.0 + 0.1 * i))
    return Scene(particles, [flat, tilt, strip], kf=15.0, gap=0.125)


def shape_flags() -> Scene:
    """Return shapes that particles pass through, between shapes that they touch."""
    shapes = [
        Shape(BOX, (1.0, 1.0, 0.25), (0.0, 0.0, 0.5), collides=False),
        Shape(PLANE, ORIGIN, (0.0, 0.0, -0.25), kf=30.0),
        Shape(SPHERE, (0.5, 0.0, 0.0), (0.0, 0.0, 0.25), collides=False),
        Shape(CAPSULE, (0.2, 0.4, 0.0), (0.5, 0.0, -0.1), axis_angle((1.0, 0.0, 0.0), 90.0)),
        Shape(PLANE, ORIGIN, collides=False),
    ]
    particles = [
        Particle((0.0, 0.0, 0.5), (0.1, 0.2, -3.0)),
        Particle((-0.5, 0.3, -0.17), (0.5, 0.0, -0.5)),
        Particle((0.45, 0.1, 0.18), (-0.2, 0.3, -1.0)),
        Particle((0.7, -0.2, 0.05), (-0.6, 0.1, -0.6)),
    ]
    return Scene(particles, shapes, kf=20.0, gap=0.5)


def sphere_capsule() -> Scene:
    """Return particles at many places in and around spheres and capsules.

    Positions are multiples of 1/32, so that the exact center and axis are reached. Within 1e-8 m of
    these, Newton takes the local z axis as the normal (-z below the lower cap's center).
    """
    sphere = Shape(SPHERE, (0.5, 0.0, 0.0), (0.25, -0.5, 1.0), ke=900.0, kd=6.0, kf=35.0)
    capsule = Shape(CAPSULE, (0.25, 0.5, 0.0), (3.0, 0.5, 1.0), ke=700.0, kd=8.0, kf=25.0, mu=0.6)
    places: list[tuple[Shape, Vector]] = [
        (sphere, (0.0, 0.0, 0.0)),
        (sphere, (0.0, 0.0, -0.5)),
        (sphere, (2.0**-20, 0.0, 0.0)),
        (sphere, (0.125, -0.0625, 0.03125)),
        (sphere, (0.375, 0.25, -0.25)),
        (sphere, (-0.3125, 0.40625, 0.28125)),
        (sphere, (0.0, -0.59375, 0.0)),
        (capsule, (0.0, 0.0, 0.125)),
        (capsule, (0.0, 0.0, 0.5)),
        (capsule, (0.0, 0.0, -0.5)),
        (capsule, (0.0, 0.0, 0.625)),
        (capsule, (0.0, 0.0, -0.625)),
        (capsule, (2.0**-20, 0.0, 0.5 + 2.0**-20)),
        (capsule, (0.0, -(2.0**-20), -0.25)),
        (capsule, (0.1875, 0.125, 0.5)),
        (capsule, (-0.15625, 0.21875, -0.3125)),
        (capsule, (0.09375, -0.0625, 0.6875)),
        (capsule, (-0.125, 0.15625, -0.71875)),
        (capsule, (0.3125, 0.0, 0.0)),
        (capsule, (0.0, 0.03125, 0.84375)),
    ]
    particles = []
    for i, (shape, point) in enumerate(places):
        qd = (0.3 - 0.04 * i, 0.05 * i - 0.4, 0.25 * (i % 4) - 0.5)
        particles.append(Particle(shape.world(point), qd, mass=0.8 + 0.05 * i, radius=0.125))
    return Scene(particles, [sphere, capsule], ke=1100.0, kf=15.0, mu=0.4)


def sphere_capsule_regenerated() -> Scene:
    """Return the scene `sphere_capsule` with contacts that are found in every substep.

    The gradient follows Newton's rules. At and near the center and the axis (particles 0, 2, 7 to 9
    and 12 to 14) it differs from finite differences.
    """
    return replace(sphere_capsule(), regenerate=True)


SCENES: dict[str, Callable[[], Scene]] = {
    scene.__name__: scene
    for scene in (
        friction,
        tilted,
        tilted_regenerated,
        box_interior,
        box_interior_regenerated,
        walls,
        velocity_clamp,
        inactive,
        finite_plane,
        shape_flags,
        sphere_capsule,
        sphere_capsule_regenerated,
    )
}


@wp.kernel
def loss_kernel(q: wp.array[wp.vec3], target: wp.vec3, loss: wp.array[float]):
    """Add the squared distance of one particle to the target."""
    delta = q[wp.tid()] - target
    wp.atomic_add(loss, 0, wp.dot(delta, delta))


def build(scene: Scene) -> newton.Model:
    """Return the finalized model of a scene."""
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    for p in scene.particles:
        builder.add_particle(p.q, p.qd, p.mass, p.radius, p.flags)
    for s in scene.shapes:
        config = newton.ModelBuilder.ShapeConfig(
            ke=s.ke,
            kd=s.kd,
            kf=s.kf,
            mu=s.mu,
            margin=s.margin,
            has_particle_collision=s.collides,
        )
        xform = wp.transform(s.position, s.rotation)
        builder.add_shape(body=-1, type=s.type, xform=xform, scale=s.scale, cfg=config)
    model = builder.finalize(device="cpu", requires_grad=True)
    model.set_gravity(scene.gravity)
    model.particle_grid = None
    model.particle_max_velocity = scene.max_velocity
    model.soft_contact_ke = scene.ke
    model.soft_contact_kd = scene.kd
    model.soft_contact_kf = scene.kf
    model.soft_contact_mu = scene.mu
    return model


def model_arrays(model: newton.Model) -> dict[str, np.ndarray]:
    """Return the arrays of a model from which its scene can be rebuilt."""
    arrays = {"model_gravity": model.gravity.numpy()[0]}
    particle = ["q", "qd", "mass", "inv_mass", "radius", "flags"]
    shape = ["type", "body", "flags", "margin", "transform", "scale"]
    material = ["ke", "kd", "kf", "mu"]
    names = [f"particle_{name}" for name in particle] + [f"shape_{name}" for name in shape]
    names += [f"shape_material_{name}" for name in material]
    for name in names:
        arrays[f"model_{name}"] = getattr(model, name).numpy()
    for name in ["particle_max_velocity"] + [f"soft_contact_{name}" for name in material]:
        arrays[f"model_{name}"] = np.float32(getattr(model, name))
    return arrays


def contact_arrays(contacts: newton.Contacts) -> dict[str, np.ndarray]:
    """Return the used rows of the contact buffers."""
    count = int(contacts.soft_contact_count.numpy()[0])
    arrays = {"contact_count": np.int32([count])}
    for name in ("particle", "shape", "body_pos", "body_vel", "normal"):
        arrays[f"contact_{name}"] = getattr(contacts, f"soft_contact_{name}").numpy()[:count]
    return arrays


def release(package: str) -> np.ndarray:
    """Return the version of an installed package as three numbers."""
    return np.int32([int(part) for part in version(package).split(".")[:3]])


def run(scene: Scene) -> dict[str, np.ndarray]:
    """Run a scene and return the content of its file."""
    model = build(scene)
    solver = newton.solvers.SolverSemiImplicit(model)
    pipeline = newton.CollisionPipeline(
        model, broad_phase="explicit", soft_contact_gap=scene.gap, requires_grad=True
    )
    states = [model.state() for _ in range(scene.steps + 1)]
    contacts = [pipeline.contacts() for _ in range(scene.steps if scene.regenerate else 1)]
    loss = wp.zeros(1, dtype=wp.float32, device="cpu", requires_grad=True)
    control = model.control()
    if not scene.regenerate:
        pipeline.collide(states[0], contacts[0])
        contacts *= scene.steps
    tape = wp.Tape()
    with tape:
        for before, after, buffer in zip(states[:-1], states[1:], contacts, strict=True):
            before.clear_forces()
            if scene.regenerate:
                pipeline.collide(before, buffer)
            solver.step(before, after, control, buffer, scene.dt)
        inputs = [states[-1].particle_q, wp.vec3(*scene.target), loss]
        wp.launch(loss_kernel, dim=len(scene.particles), inputs=inputs, device="cpu")
    tape.backward(loss)

    def stack(name: str) -> np.ndarray:
        return np.stack([getattr(state, name).numpy() for state in states])

    arrays = {"newton_version": release("newton"), "warp_version": release("warp-lang")}
    arrays |= model_arrays(model) | contact_arrays(contacts[0])
    counts = [buffer.soft_contact_count.numpy()[0] for buffer in contacts]
    arrays |= {
        "soft_contact_gap": np.float32(scene.gap),
        "sim_dt": np.float32(scene.dt),
        "sim_steps": np.int32(scene.steps),
        "regenerate": np.int32(scene.regenerate),
        "contact_counts": np.int32(counts),
        "particle_q": stack("particle_q"),
        "particle_qd": stack("particle_qd"),
        "particle_f": stack("particle_f"),
        "target": np.float32(scene.target),
        "loss": loss.numpy(),
        "grad_q": states[0].particle_q.grad.numpy(),
        "grad_qd": states[0].particle_qd.grad.numpy(),
    }
    return {name: np.asarray(value) for name, value in arrays.items()}


def validate(name: str, arrays: dict[str, np.ndarray]) -> None:
    """Raise an error for a wrong type or a value that is not finite."""
    for key, value in arrays.items():
        if value.dtype not in (np.float32, np.int32):
            raise TypeError(f"{name}: {key} has type {value.dtype}")
        if not np.isfinite(value).all():
            raise ValueError(f"{name}: {key} has values that are not finite")


def same(path: Path, arrays: dict[str, np.ndarray]) -> bool:
    """Return whether a file has exactly these arrays, bit for bit."""
    with np.load(path) as stored:
        return stored.keys() == arrays.keys() and all(
            stored[key].shape == value.shape and stored[key].tobytes() == value.tobytes()
            for key, value in arrays.items()
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Make or check the golden files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the files")
    parser.add_argument(
        "--check", action="store_true", help="compare with the files, write nothing"
    )
    options = parser.parse_args(arguments)
    wp.config.log_level = wp.LOG_WARNING

    failures = 0
    for name in options.scene:
        path = options.out / f"newton_{name}.npz"
        arrays = run(SCENES[name]())
        validate(name, arrays)
        if options.check:
            equal = path.exists() and same(path, arrays)
            failures += not equal
            print(f"{path.name}: {'same' if equal else 'DIFFERENT'}")
        else:
            options.out.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(path, **arrays)
            contacts = int(arrays["contact_count"][0])
            print(f"{path.name}: {path.stat().st_size} bytes, {contacts} contacts")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
