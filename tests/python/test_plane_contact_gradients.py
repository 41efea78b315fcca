"""Gradients through contacts that are found anew, of planes with what is round or has corners."""

from __future__ import annotations

import numpy as np
import pytest
from test_body_contacts import IDENTITY, SURFACE, TURNED, Step, along_unit_quaternions, rotation

import novaphy
from novaphy import diff

# Steps of 0.01 s, of which one at a time is taken.
pytestmark = pytest.mark.filterwarnings("ignore:DiffSemiImplicitSolver. dt")

TETRAHEDRON = np.float32([(0.1, 0.1, 0.1), (-0.1, -0.1, 0.1), (-0.1, 0.1, -0.1), (0.1, -0.1, -0.1)])
FACES = np.int32([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
MOVING = (0.5, 0.2, -0.3, 0.3, 0.4, 1.0)


def turned_about(axis, angle):
    return (*(np.sin(angle / 2) * np.float64(axis)), np.cos(angle / 2))


CYLINDER, CONE = {"radius": 0.1, "half_height": 0.15}, {"radius": 0.12, "half_height": 0.1}
ELLIPSOID = {"rx": 0.15, "ry": 0.1, "rz": 0.07}
# For each case: the shape, its pose and its number of rows.
ON_PLANE = {
    "a leaning cylinder": ("cylinder", CYLINDER, (0, 0, 0.16, *turned_about((0.6, 0.8, 0), 0.4))),
    "a cylinder that rolls": (
        "cylinder",
        CYLINDER,
        (0, 0, 0.095, *turned_about((0.28, 0.96, 0), 1.54)),
    ),
    "a cone on its rim": ("cone", CONE, (0, 0, 0.13, *turned_about((0.6, 0.8, 0), 0.5))),
    "a cone on its apex": ("cone", CONE, (0, 0, 0.09, *turned_about((0.6, 0.8, 0), 2.8))),
    "a rolling ellipsoid": ("ellipsoid", ELLIPSOID, (0, 0, 0.09, *TURNED)),
    "a hull on a corner": (
        "convex_hull",
        {"vertices": TETRAHEDRON},
        (0, 0, 0.12, *turned_about((0.6, 0.8, 0), 0.3)),
    ),
    "a mesh on a corner": (
        "mesh",
        {"mesh": novaphy.io.Mesh(TETRAHEDRON, FACES)},
        (0, 0, 0.12, *turned_about((0.6, 0.8, 0), 0.3)),
    ),
}


def add(builder, pose, shape, sizes, twist=MOVING):
    body = builder.add_body(xform=pose, mass=1.0, inertia=np.eye(3) * 0.02)
    builder.body_qd[body] = twist
    getattr(builder, f"add_shape_{shape}")(body, cfg=SURFACE, **sizes)


def labels_of(step):
    return diff.rigid_contact_gradient_labels(step.model, step.state, step.contacts)


def check_differences(step, tolerance):
    got, ahead, behind = along_unit_quaternions(step).T
    middle = (ahead + behind) / 2
    assert step.contacts.rigid_contacts()["force"].shape[0] > 0
    largest = np.abs(middle).max()
    assert largest > 1.0, "a step in which something touches"
    np.testing.assert_allclose(got, middle, rtol=tolerance, atol=tolerance * largest)


def on_plane(case, tilted, lift):
    shape, sizes, pose = case
    builder = novaphy.ModelBuilder()
    if tilted:
        builder.add_shape_plane(plane=(0.1, -0.2, 1.0, 0.0), width=0, length=0, cfg=SURFACE)
    else:
        builder.add_ground_plane(cfg=SURFACE)
    add(builder, np.add(pose, (0, 0, lift, 0, 0, 0, 0)), shape, sizes)
    return Step(builder.finalize(requires_grad=True), again=True)


def touching(case, tilted):
    """The step at a height at which something touches, and nothing is about to."""
    distance = depths(on_plane(case, tilted, 0.0))
    for depth in (0.012, 0.016, 0.02, 0.024):
        lift = -distance.min() - depth
        if np.abs(distance + lift).min() > 3e-3:
            return on_plane(case, tilted, lift)
    raise AssertionError("no such height")


def depths(step):
    """Heights of the points of the body above the plane of the rows."""
    q, found = step.state.body_q.numpy()[0].astype(float), []
    for row in step.contacts.rigid_contacts():
        at = rotation(q[3:]) @ row["point1"] + q[:3]
        found.append((at - row["point0"]) @ row["normal"])
    return np.array(found)


@pytest.mark.parametrize("tilted", [False, True], ids=["level", "tilted"])
@pytest.mark.parametrize("name", ON_PLANE)
def test_on_a_plane_the_gradient_is_that_of_contacts_found_anew(name, tilted):
    step = touching(ON_PLANE[name], tilted)
    labels = labels_of(step)
    assert labels and set(labels) == {"exact"}
    check_differences(step, 5e-3)


def test_the_gradient_of_a_pose_by_six_numbers_is_that_of_small_motions():
    shape, sizes, pose = ON_PLANE["a leaning cylinder"]
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=SURFACE)
    add(builder, pose, shape, sizes)
    step = Step(builder.finalize(requires_grad=True), again=True)
    expected = along_unit_quaternions(step)[:6, 0]
    q = step.leaves()[0]
    got = diff.pose_tangent_gradient(step.state.body_q.numpy(), q.grad.numpy())
    np.testing.assert_allclose(got[0], expected, rtol=5e-3, atol=5e-3)
    one = diff.pose_tangent_gradient(step.state.body_q.numpy()[0], q.grad.numpy()[0])
    np.testing.assert_array_equal(one, got[0])
    with pytest.raises(ValueError, match=r"gradient: expected \(1, 7\), as body_q, got \(1, 6\)"):
        diff.pose_tangent_gradient(step.state.body_q.numpy(), np.zeros((1, 6)))
    with pytest.raises(ValueError, match="quaternions of length 1"):
        diff.pose_tangent_gradient(np.zeros(7), np.zeros(7))


def test_a_rim_that_lies_flat_is_held():
    """Its deepest point jumps with the smallest tilt; the label says so."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=SURFACE)
    add(builder, (0, 0, 0.149, *IDENTITY), "cylinder", CYLINDER)
    step = Step(builder.finalize(requires_grad=True), again=True)
    assert set(labels_of(step)) == {"frozen"}
