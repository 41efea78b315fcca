"""A body on a board that tilts: hulls and meshes have the gradients of boxes."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

HALF = np.float32([0.5, 0.2, 0.02])
CORNERS = HALF * np.float32([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
TRIANGLES = np.int32(
    [
        [0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1],
        [2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3],
    ]
).reshape(-1, 3)


def board(builder: novaphy.ModelBuilder, kind: str, of: novaphy.ShapeConfig) -> None:
    link = builder.add_link(mass=1.0, inertia=np.diag([0.01, 0.08, 0.09]))
    hinge = builder.add_joint_revolute(-1, link, axis=(0, 1, 0))
    builder.add_articulation([hinge])
    if kind == "box":
        builder.add_shape_box(link, hx=HALF[0], hy=HALF[1], hz=HALF[2], cfg=of)
    elif kind == "hull":
        builder.add_shape_convex_hull(link, vertices=CORNERS, cfg=of)
    else:
        builder.add_shape_mesh(link, vertices=CORNERS, indices=TRIANGLES, cfg=of)


def gradient(
    kind: str, body: str = "sphere"
) -> tuple[float, np.ndarray, novaphy.solvers.GradientInfo]:
    """The end of a body along x (m), and its gradient by the start."""
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder(gravity=-9.81)
    of = novaphy.ShapeConfig(mu=0.8 if body == "sphere" else 0.2, density=0, gap=0.05)
    steps = 200
    board(builder, kind, of)
    ball = builder.add_body(
        xform=((0.1, 0.03, 0.1199), (0, 0, 0, 1)), mass=0.5, inertia=np.eye(3) * 0.002
    )
    if body == "sphere":
        builder.add_shape_sphere(ball, radius=0.1, cfg=of)
    elif body == "box":
        builder.add_shape_box(ball, hx=0.05, hy=0.05, hz=0.1, cfg=of)
    else:
        builder.add_shape_convex_hull(ball, vertices=CORNERS / HALF * [0.05, 0.05, 0.1], cfg=of)
    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, angular_damping=0.0, contact_gradient="motion"
    )
    path = diff.Trajectory(model, steps)
    with nova.Tape() as tape:
        pipeline = novaphy.CollisionPipeline(model)
        solver.rollout(path, None, None, 1 / 400, pipeline=pipeline)
        end = diff.state_joint_q_tensor(path[steps])[1:2]
        tape.backward(nova.sum(end))
    start = path[0]
    grads = np.concatenate([start.joint_q.grad.numpy(), start.joint_qd.grad.numpy()])
    return end.numpy()[0], grads, solver.gradient_info()


@pytest.mark.parametrize("kind", ["hull", "mesh"])
def test_a_ball_on_a_tilting_board_of_a_hull_has_the_gradient_of_a_box(kind: str) -> None:
    x, wanted, info = gradient("box")
    ours_x, ours, ours_info = gradient(kind)
    assert info.label == ours_info.label == "exact of the code"  # no contact begins
    assert x > 0.12  # rolls down as the board tilts
    assert abs(ours_x - x) < 1e-4
    np.testing.assert_allclose(ours, wanted, atol=1e-3 * np.abs(wanted).max())


@pytest.mark.parametrize(("kind", "body"), [("box", "box"), ("hull", "box"), ("hull", "hull")])
def test_a_box_that_slides_on_its_face_turns_with_the_board(kind: str, body: str) -> None:
    """The corners of the body lie on the inside of the board's face, which gives the normal."""
    x, wanted, _ = gradient("box", "hull")
    ours_x, ours, info = gradient(kind, body)
    assert info["frozen_contacts"] == 0 and abs(ours_x - x) < 1e-4
    np.testing.assert_allclose(ours[:2], wanted[:2], rtol=1e-3)
