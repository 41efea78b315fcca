"""Cameras, lights and sensors of MJCF files, and links that are kept."""

from __future__ import annotations

import numpy as np
import pytest
from test_mjcf_features import GEOM, loaded, mjcf

import novaphy
from novaphy.testing import assert_allclose

pytestmark = pytest.mark.skipif(
    not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it"
)


VIEWS = mjcf(
    '<camera name="far" pos="1 2 3" euler="30 0 20"/><light name="sun" pos="0 0 3" dir="1 0 -1"/>'
    '<body pos="0 0 1" euler="0 20 0"><joint name="j"/>' + GEOM
    + '<frame pos=".1 0 0" euler="10 0 0"><camera pos="0 .1 0" xyaxes="0 1 0 0 0 1" fovy="30"/>'
    '</frame><body pos="0 .2 0"><light pos="0 0 .1" dir="0 2 1"/></body></body>',
    after='<sensor><jointpos name="angle" joint="j"/><framepos objtype="body" objname="x"/>'
    "</sensor>",
)  # fmt: skip


@pytest.mark.parametrize("collapse", [False, True])
def test_cameras_and_lights_are_where_mujoco_has_them(collapse):
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    exact = mujoco.MjModel.from_xml_string(VIEWS.replace('objname="x"', 'objname="world"'))
    data = mujoco.MjData(exact)
    data.qpos[:] = 0.7
    mujoco.mj_forward(exact, data)
    model, robot = loaded(VIEWS, collapse_fixed_joints=collapse)
    state = model.state()
    state.joint_q.assign([0.7])
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    poses = [*state.body_q.numpy(), (0, 0, 0, 0, 0, 0, 1)]

    def in_world(body, pose):
        turns = []
        for q in (poses[body][3:], pose[3:]):
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, np.roll(np.float64(q), 1))
            turns.append(turn.reshape(3, 3))
        return poses[body][:3] + turns[0] @ pose[:3], turns[0] @ turns[1]

    assert list(robot.cameras) == ["camera_1", "far"] and list(robot.lights) == ["light_1", "sun"]
    for index, name in ((0, "far"), (1, "camera_1")):
        body, pose, fovy = robot.cameras[name]
        place, turn = in_world(body, pose)
        assert_allclose(place, data.cam_xpos[index], atol=1e-6)
        assert_allclose(turn, data.cam_xmat[index].reshape(3, 3), atol=1e-6)
        assert_allclose(fovy, np.radians(exact.cam_fovy[index]), rtol=1e-6)
    for index, name in ((0, "sun"), (1, "light_1")):
        place, turn = in_world(*robot.lights[name])
        assert_allclose(place, data.light_xpos[index], atol=1e-6)
        assert_allclose(-turn[:, 2], data.light_xdir[index], atol=1e-6)


def test_sensors_are_read_and_refuse_no_file():
    _, robot = loaded(VIEWS)
    angle, place = robot.sensors
    assert (angle.kind, angle.name, dict(angle.names)) == ("jointpos", "angle", {"joint": "j"})
    assert dict(place.names) == {"objtype": "body", "objname": "x"}
    assert robot.report.read["sensor"] == 2


def test_kept_links_are_not_merged():
    inner = f'<body name="b">{GEOM}<body name="c">{GEOM}</body></body>'
    text = mjcf(f'<body name="a"><joint/>{GEOM}{inner}</body>')
    for kept, names in ((["b"], ["a", "b"]), (["c"], ["a", "c"]), ([], ["a"])):
        model, robot = loaded(text, collapse_fixed_joints=True, links_to_keep=kept)
        assert list(model.body_label) == names
        assert robot.links["c"] == (1 if kept else 0)
    with pytest.raises(ValueError, match='links_to_keep: there is no link "x"'):
        loaded(text, collapse_fixed_joints=True, links_to_keep=["x"])
