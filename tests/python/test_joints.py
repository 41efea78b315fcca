"""Joints and articulations in Python."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import novaphy
from novaphy import Axis, JointDofConfig, JointTargetMode, JointType, ModelBuilder

INERTIA = np.eye(3) * 0.1


def arm() -> ModelBuilder:
    builder = ModelBuilder()
    for _ in range(2):
        builder.add_link(mass=1.0, inertia=INERTIA)
    first = builder.add_joint_revolute(
        -1,
        0,
        axis=Axis.Y,
        parent_xform=((0, 0, 1), (0, 0, 0, 1)),
        target_ke=5.0,
        target_q=0.5,
        limit_lower=-1.0,
        limit_upper=2.0,
        actuator_mode=JointTargetMode.POSITION,
        label="shoulder",
    )
    second = builder.add_joint_d6(
        0,
        1,
        linear_axes=[JointDofConfig("z", armature=0.25)],
        angular_axes=[JointDofConfig.create_unlimited((0, 3, 0))],
    )
    builder.add_articulation([first, second], label="arm")
    return builder


def test_a_model_has_the_joints_of_its_builder():
    builder = arm()
    assert (builder.joint_count, builder.joint_coord_count, builder.joint_dof_count) == (2, 3, 3)
    builder.joint_q[1] = 0.125
    model = builder.finalize()
    assert model.joint_type.numpy().tolist() == [JointType.REVOLUTE, JointType.D6]
    assert model.joint_axis.numpy().tolist() == [[0, 1, 0], [0, 0, 1], [0, 1, 0]]
    assert model.joint_q_start.numpy().tolist() == [0, 1, 3]
    assert model.joint_limit_upper.numpy().tolist() == pytest.approx([2.0, 1e10, 1e10])
    assert model.joint_armature.numpy().tolist() == [0.0, 0.25, 0.0]
    assert model.joint_target_mode.numpy().tolist() == [1, 3, 3]
    assert model.articulation_label == ["arm"] and model.joint_label[0] == "shoulder"
    assert (model.max_joints_per_articulation, model.max_dofs_per_articulation) == (2, 3)
    assert model.state().joint_q.numpy().tolist() == [0.0, 0.125, 0.0]


def test_a_control_starts_from_the_model_and_clear_keeps_quaternions():
    builder = ModelBuilder()
    builder.add_body(mass=1.0, inertia=INERTIA)
    builder.joint_f[2] = 3.0
    model = builder.finalize()
    control = model.control()
    assert control.joint_f.numpy().tolist() == [0, 0, 3, 0, 0, 0]
    control.clear(model)
    assert control.joint_f.numpy().tolist() == [0] * 6
    assert control.joint_target_q.numpy().tolist() == [0, 0, 0, 0, 0, 0, 1]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_copies_of_a_model_keep_joints(copied):
    model = arm().finalize()
    other = copied(model)
    assert other.joint_label == model.joint_label
    assert other.articulation_label == ["arm"] and other.max_dofs_per_articulation == 3
    np.testing.assert_array_equal(other.joint_X_p.numpy(), model.joint_X_p.numpy())
    np.testing.assert_array_equal(other.articulation_start.numpy(), [0, 2])


def test_defaults_come_from_the_builder():
    builder = ModelBuilder()
    builder.default_joint_cfg = JointDofConfig(damping=2.0)
    builder.add_link(mass=1.0, inertia=INERTIA)
    builder.add_joint_prismatic(-1, 0, axis=(1, 0, 0), armature=0.5)
    model = builder.finalize()
    assert model.joint_damping.numpy().tolist() == [2.0]
    assert model.joint_armature.numpy().tolist() == [0.5]
    config = pickle.loads(pickle.dumps(builder.default_joint_cfg))
    assert config.damping == 2.0 and config.axis == (1, 0, 0)


def test_bad_joints_name_what_is_wrong():
    builder = arm()
    with pytest.raises(ValueError, match="axis: expected a finite vector that is not zero"):
        builder.add_joint_revolute(0, 1, axis=(0, 0, 0))
    with pytest.raises(ValueError, match="limit_lower, limit_upper: expected the lower one first"):
        builder.add_joint_revolute(0, 1, limit_lower=1.0, limit_upper=0.0)
    with pytest.raises(IndexError, match="child: expected 0 to 1, got 2"):
        builder.add_joint_fixed(-1, 2)
    with pytest.raises(TypeError, match="linear_axes: expected JointDofConfig"):
        builder.add_joint_d6(0, 1, linear_axes=[(1, 0, 0)])
    with pytest.raises(ValueError, match=r"joint 0 \(\"shoulder\"\): expected one of no artic"):
        builder.add_articulation([0])
    builder.add_link()
    with pytest.raises(ValueError, match=r"body 2 \(\"body_2\"\): expected a joint"):
        builder.finalize()


def test_collapsed_joints_are_reported():
    builder = arm()
    builder.add_link(mass=0.5, inertia=INERTIA)
    builder.add_joint_fixed(1, 2, parent_xform=((0, 0, 1), (0, 0, 0, 1)))
    done = builder.collapse_fixed_joints()
    assert done["body_remap"] == {0: 0, 1: 1} and done["joint_remap"] == {0: 0, 1: 1}
    assert done["body_merged_parent"] == {2: 1}
    assert done["body_merged_transform"] == {2: (0, 0, 1, 0, 0, 0, 1)}
    np.testing.assert_allclose(builder.finalize().body_mass.numpy(), [1.0, 1.5])


def test_replicated_robots_have_shifted_joints():
    builder = ModelBuilder()
    builder.replicate(arm(), 3, spacing=(2, 0, 0))
    model = builder.finalize()
    assert model.joint_parent.numpy().tolist() == [-1, 0, -1, 2, -1, 4]
    assert model.joint_world.numpy().tolist() == [0, 0, 1, 1, 2, 2]
    assert model.joint_X_p.numpy()[::2, 0].tolist() == [-2.0, 0.0, 2.0]
    assert model.articulation_end.numpy().tolist() == [2, 4, 6]


def test_kinematics_go_both_ways():
    model = arm().finalize()
    state = model.state()
    state.joint_q.assign(np.array([0.3, 0.5, -0.2], np.float32))
    state.joint_qd.assign(np.array([1.0, -2.0, 0.5], np.float32))
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    np.testing.assert_allclose(
        state.body_q.numpy()[1, :3], [0.5 * np.sin(0.3), 0, 1 + 0.5 * np.cos(0.3)], atol=1e-6
    )
    other = model.state()
    novaphy.eval_ik(model, state, other.joint_q, other.joint_qd)
    np.testing.assert_allclose(other.joint_q.numpy(), [0.3, 0.5, -0.2], atol=1e-6)
    np.testing.assert_allclose(other.joint_qd.numpy(), [1.0, -2.0, 0.5], atol=1e-5)
    with pytest.raises(ValueError, match="eval_fk: joint_q: expected 3 rows"):
        novaphy.eval_fk(model, model.body_mass, state.joint_qd, state)


def test_collapsed_bodies_keep_their_motion():
    def build(collapsed):
        builder = novaphy.ModelBuilder(gravity=0)
        inertia = 0.1 * np.eye(3)
        root, tip = (builder.add_link(mass=1.0, inertia=inertia) for _ in range(2))
        builder.add_shape_box(root, hx=0.1, hy=0.1, hz=0.1, xform=((0, -0.5, 0), (0, 0, 0, 1)))
        free = builder.add_joint_free(root, child_xform=((0, 0, 0), (0, 0, 0.6, 0.8)))
        fixed = builder.add_joint_fixed(root, tip, parent_xform=((1, 0, 0), (0, 0, 0, 1)))
        builder.add_articulation([free, fixed])
        builder.joint_q[:7] = [0, 0, 0, 0, 0, 0.28, 0.96]
        builder.joint_qd[:6] = [0.1, 0.2, 0.3, 0, 0, 2]
        if collapsed:
            builder.collapse_fixed_joints()
        return builder.finalize()

    places = []
    for collapsed in (False, True):
        model = build(collapsed)
        state = model.state()
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        velocity, spin = np.split(state.body_qd.numpy()[0], 2)
        com = model.body_com.numpy()[0]
        z, w = state.body_q.numpy()[0, 5:]
        turn = 2 * np.arctan2(z, w)  # about z
        along, across = (np.cos(turn), np.sin(turn), 0), (-np.sin(turn), np.cos(turn), 0)
        arm = com[0] * np.array(along) + com[1] * np.array(across)
        places.append(
            np.concatenate([velocity - np.cross(spin, arm), spin])
        )  # velocity and spin at the origin
    np.testing.assert_allclose(places[0], places[1], atol=1e-6)
