"""eval_fk, and where steps of articulations leave the bodies."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

SOLVERS = ["SolverFeatherstone", *(["DiffFeatherstoneSolver"] if novaphy.has_diff() else [])]


def everything() -> novaphy.ModelBuilder:
    """A tree with a joint of each type, turned and moved, far from the origin."""
    draw = np.random.default_rng(5)

    def pose() -> tuple[list[float], list[float]]:
        turn = draw.normal(size=4)
        return [*draw.normal(size=3)], [*(turn / np.linalg.norm(turn))]

    def axis() -> novaphy.ModelBuilder.JointDofConfig:
        return novaphy.ModelBuilder.JointDofConfig(axis=tuple(draw.normal(size=3)))

    builder = novaphy.ModelBuilder()
    inertia = np.diag([0.02, 0.03, 0.04])
    links = [
        builder.add_link(mass=1.0, inertia=inertia, com=tuple(0.1 * draw.normal(size=3)))
        for _ in range(7)
    ]
    at = [{"parent_xform": pose(), "child_xform": pose()} for _ in links]
    joints = [
        builder.add_joint_free(links[0], **at[0]),
        builder.add_joint_revolute(links[0], links[1], axis=(0.6, 0.0, 0.8), **at[1]),
        builder.add_joint_ball(links[1], links[2], **at[2]),
        builder.add_joint_d6(
            links[0],
            links[3],
            linear_axes=[axis(), axis()],
            angular_axes=[axis(), axis(), axis()],
            **at[3],
        ),
        builder.add_joint_prismatic(links[3], links[4], axis=(0.0, 1.0, 0.0), **at[4]),
        builder.add_joint_fixed(links[4], links[5], **at[5]),
        builder.add_joint_free(child=links[6], parent=links[2], **at[6]),
    ]
    builder.add_articulation(joints)
    builder.joint_q[0:3] = [100.0, -200.0, 50.0]
    builder.joint_qd[:] = list(draw.normal(size=builder.joint_dof_count))
    return builder


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("worlds", [1, 5])
def test_a_step_leaves_the_bodies_where_eval_fk_has_them_to_the_bit(
    solver: str, worlds: int
) -> None:
    builder = novaphy.ModelBuilder()
    builder.replicate(everything(), worlds)
    model = builder.finalize()
    made = getattr(novaphy.solvers, solver)(model)
    state, after, again = model.state(), model.state(), model.state()
    for _ in range(20):
        made.step(state, after, None, None, 1 / 240)
        novaphy.eval_fk(model, after.joint_q, after.joint_qd, again)
        for name in ("body_q", "body_qd"):
            np.testing.assert_array_equal(
                getattr(again, name).numpy(), getattr(after, name).numpy(), err_msg=name
            )
        state, after = after, state
