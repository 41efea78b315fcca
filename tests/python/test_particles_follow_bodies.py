"""Contacts of particles with bodies that are found in every step: the gradient follows both."""

from __future__ import annotations

import numpy as np
import pytest
from test_body_contacts import TURNED, diff_solver, rotation, turned, weighted

import novaphy
from novaphy import diff, nova

SURFACE = novaphy.ShapeConfig(ke=1e3, kd=5.0, kf=20.0, mu=0.5)
CUBE = np.float32([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.1
SHAPES = {
    "box": {"hx": 0.1, "hy": 0.12, "hz": 0.1},
    "sphere": {"radius": 0.1},
    "capsule": {"radius": 0.08, "half_height": 0.1},
    "cylinder": {"radius": 0.09, "half_height": 0.1},
    "cone": {"radius": 0.12, "half_height": 0.1},
    "ellipsoid": {"rx": 0.12, "ry": 0.09, "rz": 0.1},
    "convex_hull": {"vertices": CUBE},
}
# The position of the particle in the frame of the shape: over a side, an edge or rim, or a corner.
PLACES = {
    "side": (0.02, 0.01, 0.13),
    "edge": (0.115, 0.02, 0.12),
    "corner": (0.12, 0.135, 0.12),
    "base": (0.13, 0.03, -0.12),
}
CASES = [
    *((shape, "side") for shape in SHAPES),
    ("box", "edge"),
    ("box", "corner"),
    ("capsule", "edge"),
    ("cylinder", "edge"),
    ("cone", "base"),
]
MOVES = {"particle_q": 3, "particle_qd": 3, "body_q": 6, "body_qd": 6}


class Scene:
    """One step of a particle that overlaps a shape of a moving body."""

    def __init__(self, shape, place):
        builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
        pose = np.float64((0.1, 0.2, 1.0, *TURNED))
        body = builder.add_body(xform=pose, mass=1.0, inertia=np.eye(3) * 0.01)
        builder.body_qd[body] = (0.1, -0.2, 0.1, 0.5, -0.3, 1.0)
        mount = ((0.02, -0.03, 0.01), (0.0, 0.0, np.sin(0.2), np.cos(0.2)))
        getattr(builder, f"add_shape_{shape}")(body, xform=mount, cfg=SURFACE, **SHAPES[shape])
        local = rotation(mount[1]) @ np.float64(place) + mount[0]
        x = rotation(pose[3:]) @ local + pose[:3]
        builder.add_particle(tuple(x), (0.1, 0.2, -0.6), 0.5, radius=0.05)
        self.model = builder.finalize(requires_grad=True)
        self.pipeline = novaphy.CollisionPipeline(self.model)
        self.solver = diff_solver(self.model)
        self.trajectory = diff.Trajectory(self.model, 1)

    def __call__(self):
        self.solver.rollout(self.trajectory, None, None, 1 / 100, pipeline=self.pipeline)
        end = self.trajectory[1]
        x, v = (getattr(diff, f"state_{n}_tensor")(end) for n in ("particle_q", "particle_qd"))
        weights = nova.tensor(np.float32([[0.3, -0.5, 0.8]]))
        return weighted(end, 1) + nova.sum(x * weights) + nova.sum(v * weights)

    def gradients(self):
        with nova.Tape() as tape:
            tape.backward(self())
        return {n: getattr(self.trajectory[0], n).grad.numpy()[0].astype(float) for n in MOVES}

    def differences(self, size=1e-3):
        """Of each number that moves along unit quaternions: the direction, ahead, behind."""
        start = self.trajectory[0]
        middle = self().item()
        for name, count in MOVES.items():
            values = getattr(start, name).numpy()
            for k in range(count):
                ends, ways = [], []
                for sign in (1, -1):
                    moved = values.astype(float)
                    d = np.eye(6)[k] * size * sign
                    if name == "body_q":
                        moved[0, :3] += d[:3]
                        moved[0, 3:] = turned(moved[0, 3:], d[3:])
                    else:
                        moved[0] += d[:count]
                    setattr(start, name, moved.astype(np.float32))
                    ways.append((moved[0] - values[0]) / (sign * size))
                    ends.append(self().item())
                setattr(start, name, values)
                yield name, ways[0], (ends[0] - middle) / size, (middle - ends[1]) / size


@pytest.mark.parametrize(("shape", "place"), CASES, ids=["-".join(c) for c in CASES])
def test_the_gradient_is_that_of_contacts_found_anew(shape, place):
    scene = Scene(shape, PLACES[place])
    contacts = scene.pipeline.contacts()
    scene.pipeline.collide(scene.model.state(), contacts)
    assert contacts.soft_contact_count.numpy()[0] == 1
    of = scene.gradients()
    found = [(n, of[n] @ way, ahead, behind) for n, way, ahead, behind in scene.differences()]
    got, ahead, behind = (np.array([f[k] for f in found]) for k in (1, 2, 3))
    middle = (ahead + behind) / 2
    largest = np.abs(middle).max()
    assert largest > 1.0
    np.testing.assert_allclose(got, middle, rtol=1e-2, atol=5e-3 * largest)


def test_a_particle_exactly_on_a_face_of_a_box_has_the_derivative_of_its_distance():
    """The distance is smooth there; static contacts and those that are found pass it."""
    builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
    builder.add_shape_box(-1, hx=1.0, hy=1.0, hz=0.5, cfg=SURFACE)
    builder.add_particle((0.25, 0.125, 0.5), (0, 0, 0), 0.5, radius=0.05)
    model = builder.finalize(requires_grad=True)
    q = nova.tensor(model.particle_q.numpy(), requires_grad=True)
    qd, f = nova.tensor(model.particle_qd.numpy()), nova.zeros((1, 3))
    with nova.Tape() as tape:
        force = diff.eval_static_particle_shape_contact_forces_generated(model, q, qd, f)
        tape.backward(nova.sum(force))
    ke = 0.5 * (1e3 + model.soft_contact_ke)
    np.testing.assert_allclose(q.grad.numpy(), [[0, 0, -ke]], rtol=1e-6)


@pytest.mark.parametrize("shape", ["box", "sphere", "capsule", "cylinder", "cone", "ellipsoid"])
def test_static_contacts_of_a_shape_beside_those_of_all_types_have_its_gradient(shape):
    """Sizes that another type does not have divide nothing by zero."""
    builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
    for k, (name, sizes) in enumerate(SHAPES.items()):
        if name == "convex_hull":
            continue
        at = 0.0 if name == shape else 5.0 + k
        pose = ((at, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        getattr(builder, f"add_shape_{name}")(-1, xform=pose, cfg=SURFACE, **sizes)
    builder.add_particle((0.03, 0.02, 0.11), (0.1, 0.2, -0.6), 0.5, radius=0.05)
    model = builder.finalize(requires_grad=True)
    q = nova.tensor(model.particle_q.numpy(), requires_grad=True)
    qd, f = nova.tensor(model.particle_qd.numpy()), nova.zeros((1, 3))

    def force():
        found = diff.eval_static_particle_shape_contact_forces_generated(model, q, qd, f)
        return nova.sum(found * nova.tensor(np.float32([[0.3, -0.5, 0.8]])))

    found = nova.gradcheck(lambda *_: force(), [q], epsilon=1e-3, rtol=2e-2, atol=2e-2)
    assert found.ok, found.worst
    assert abs(force().item()) > 1.0
