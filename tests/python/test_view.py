"""What `novaphy view` lets a user move, and what it tells: sliders, overlaps, inertias, names."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import _command, _view
from novaphy.viewer import Viewer
from novaphy.viewer._inertia import inertia_boxes
from novaphy.viewer._scene_viewer import SceneViewer


def arm(gap: float = 0.3) -> novaphy.Model:
    """Two balls of 0.1 m and 1 kg m^2, each on an axis in the middle between both."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    joints = []
    for sign, name in ((-1.0, "left"), (1.0, "right")):
        body = builder.add_link(mass=1.0, inertia=np.eye(3), label=name)
        at = ((0.5 * gap * sign, 0, 0), (0, 0, 0, 1))
        cfg = novaphy.ShapeConfig(density=0.0)
        builder.add_shape_sphere(body, xform=at, radius=0.1, cfg=cfg, label=f"{name} ball")
        limits = {"limit_lower": -1.0, "limit_upper": 2.0}
        joint = builder.add_joint_revolute(-1, body, axis=(0, 0, 1), label=f"{name} axis", **limits)
        builder.add_articulation([joint])
        joints.append(joint)
    builder.add_actuator(joints[0], label="motor", ctrl_range=(-3.0, 5.0), gear=2.0)
    builder.add_actuator(joints[1], label="free motor")
    return builder.finalize()


def test_sliders_pose_the_joints_and_controls_move_them():
    puppet = _view.Puppet(arm(), Viewer().add_slider)
    motor, free = puppet.controls
    assert (motor.name, motor.low, motor.high) == ("motor (control)", -3.0, 5.0)
    assert (free.name, free.low, free.high) == ("free motor (control)", -1.0, 1.0)
    left, right = puppet.joints.values()
    assert (left.name, left.low, left.high) == ("left axis (rad)", -1.0, 2.0)
    left.set(0.5)
    puppet.turn()
    assert puppet.state.joint_q.numpy().tolist() == [0.5, 0.0] and not puppet.moves
    motor.set(4.0)
    puppet.turn()
    assert puppet.control.ctrl.numpy().tolist() == [4.0, 0.0] and puppet.moves
    # 8 N m turn 1 kg m^2 for a frame.
    step = 1.0 / (_view.FPS * _view.STEPS)
    expected = [8.0 * step**2 * _view.STEPS * (_view.STEPS + 1) / 2, 0.0]
    turned = puppet.state.joint_q.numpy() - [0.5, 0.0]
    np.testing.assert_allclose(turned, expected, rtol=1e-3, atol=1e-9)
    right.set(1.0)  # a joint that is moved ends the motion
    puppet.turn()
    assert puppet.state.joint_q.numpy().tolist() == [0.5, 1.0] and not puppet.moves
    assert not puppet.state.joint_qd.numpy().any()
    puppet.reset()
    puppet.turn()
    assert puppet.state.joint_q.numpy().tolist() == [0.0, 0.0]
    assert puppet.control.ctrl.numpy().tolist() == [0.0, 0.0]


def test_sliders_turn_a_ball_by_its_rotation_vector():
    builder = novaphy.ModelBuilder(gravity=0.0)
    links = [builder.add_link(mass=1.0, inertia=np.eye(3)) for _ in range(2)]
    limits = {"limit_angle": 1.5}
    joints = [
        builder.add_joint_ball(-1, links[0], label="hip", **limits),
        builder.add_joint_ball(links[0], links[1], label="neck"),
    ]
    builder.add_articulation(joints)
    builder.joint_q[4:] = [0.0, -np.sin(0.3), 0.0, -np.cos(0.3)]  # 0.6 rad about y
    puppet = _view.Puppet(builder.finalize(), Viewer().add_slider)
    hip, neck = puppet.balls.values()
    assert [(s.name, s.low, s.high) for s in hip] == [
        (f"hip {axis} (rad)", -1.5, 1.5) for axis in "xyz"
    ]
    np.testing.assert_allclose([s.value for s in neck], [0.0, 0.6, 0.0], atol=1e-7)
    puppet.turn()
    hip[0].set(0.3)
    hip[2].set(-0.4)
    puppet.turn()
    half = np.sin(0.25)
    expected = [0.6 * half, 0.0, -0.8 * half, np.cos(0.25), 0.0, np.sin(0.3), 0.0, np.cos(0.3)]
    np.testing.assert_allclose(puppet.state.joint_q.numpy(), expected, atol=1e-6)
    assert not puppet.moves


@pytest.mark.parametrize(("gap", "depth"), [(0.15, 0.05), (0.3, None)])
def test_overlaps_are_named_with_their_depth(gap, depth):
    model = arm(gap)
    puppet = _view.Puppet(model, Viewer().add_slider)
    puppet.turn()
    found = puppet.overlaps()
    if depth is None:
        assert found == []
        return
    ((first, second, deep),) = found
    names = {'"left ball" of "left"', '"right ball" of "right"'}
    assert {first, second} == names and deep == pytest.approx(depth, rel=1e-4)


def test_boxes_have_the_inertia_of_the_bodies():
    half, mass = np.float64([[0.1, 0.2, 0.3], [0.5, 0.05, 0.4]]), np.float64([3.0, 7.0])
    squares = half**2
    principal = mass[:, None] / 3.0 * (squares.sum(axis=1, keepdims=True) - squares)
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(2, 3, 3)))
    inertia = np.einsum("nij,nj,nkj->nik", turn, principal, turn)
    found, axes = inertia_boxes(mass, inertia)
    np.testing.assert_allclose(np.sort(found), np.sort(half), rtol=1e-6)
    # The inertia of the boxes about their axes is the given inertia.
    squares = found**2
    again = mass[:, None] / 3.0 * (squares.sum(axis=1, keepdims=True) - squares)
    np.testing.assert_allclose(np.einsum("nij,nj,nkj->nik", axes, again, axes), inertia, rtol=1e-6)
    assert not inertia_boxes(np.zeros(1), np.eye(3)[None])[0].any()


def test_inertias_are_drawn_around_the_centers_of_mass():
    builder = novaphy.ModelBuilder()
    half, com, place = np.float64([0.1, 0.2, 0.3]), (0.5, 0.0, 0.0), (1.0, 2.0, 3.0)
    inertia = np.diag(2.0 / 3.0 * ((half**2).sum() - half**2))
    quarter = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))  # x becomes y
    builder.add_body(xform=(place, quarter), mass=2.0, com=com, inertia=inertia)
    model = builder.finalize()
    viewer = SceneViewer()
    viewer.set_model(model)
    viewer.show_inertia = True
    viewer.log_state(model.state())
    lines = viewer.scene.lines["model/inertia"]
    assert lines.count == 12
    ends = np.concatenate([lines.starts.values, lines.ends.values])
    middle, size = np.float64([1.0, 2.5, 3.0]), half[[1, 0, 2]]
    np.testing.assert_allclose(np.abs(ends - middle), np.tile(size, (24, 1)), atol=1e-6)
    lengths = np.linalg.norm(lines.ends.values - lines.starts.values, axis=1)
    np.testing.assert_allclose(np.sort(lengths), np.repeat(2 * half, 4), atol=1e-6)
    viewer.show_inertia = False
    viewer.log_state(model.state())
    assert "model/inertia" not in viewer.scene.lines


def test_what_is_under_the_pointer_has_a_name():
    model = arm()
    viewer = SceneViewer()
    viewer.set_model(model)
    names = {
        (0.15, 0.0): "right ball of right",
        (-0.15, 0.0): "left ball of left",
        (0.15, 0.097): "right ball of right",
        (0.24, 0.09): None,  # in the box of the ball, beside the ball
    }
    for (x, z), name in names.items():
        assert viewer.name_at((x, -5.0, z), (0.0, 1.0, 0.0)) == name


@pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it")
def test_a_robot_file_with_overlaps_and_controls_is_viewed(tmp_path, capsys):
    path = tmp_path / "arm.xml"
    geom = '<geom type="sphere" size=".1" pos="{} 0 0"/>'
    path.write_text(
        f"""<mujoco><worldbody><body name="a"><joint name="turn"/>{geom.format(0)}
<body name="b"><joint name="mid" axis="0 1 0"/>{geom.format(1)}<body name="c">
<joint name="end" axis="0 1 0"/>{geom.format(0.16)}</body></body></body></worldbody>
<actuator><motor name="push" joint="turn" ctrlrange="-2 2"/></actuator></mujoco>"""
    )
    words = ["view", str(path), "--headless", "1", "--viewer", "null", "--show", "inertia"]
    assert _command.main(words) == 0
    said = capsys.readouterr().out
    assert "3 joints to move, 1 controls" in said
    assert 'of "a" and ' in said and 'of "c" by 0.04 m' in said and said.count("overlap:") == 1


@pytest.mark.skipif(not novaphy.has_io(), reason="needs io")
def test_a_view_starts_at_a_camera_of_the_file(tmp_path, capsys):
    text = (
        '<mujoco><worldbody><camera name="still" pos="1 2 3"/><body pos="0 0 1" euler="0 0 90">'
        '<joint type="slide"/><geom size=".1"/><camera name="moved" pos="1 0 0" '
        'xyaxes="0 1 0 0 0 1"/>'
        "</body></worldbody></mujoco>"
    )
    builder = novaphy.ModelBuilder()
    robot = builder.add_mjcf(text)
    model = builder.finalize()
    for name, pos, ahead in (("still", (1, 2, 3), (0, 0, -1)), ("moved", (0, 1, 1), (0, -1, 0))):
        got, target = _view.camera_look(model, robot, name)
        np.testing.assert_allclose(got, pos, atol=1e-6)
        np.testing.assert_allclose(target - got, ahead, atol=1e-6)
    (tmp_path / "r.xml").write_text(text)
    assert _command.main(["view", str(tmp_path / "r.xml"), "--headless", "1", "--camera", "x"]) == 1
    assert "expected a camera of the file (moved, still), got x" in capsys.readouterr().err
    assert (
        _command.main(["view", str(tmp_path / "r.xml"), "--headless", "1", "--camera", "still"])
        == 0
    )
