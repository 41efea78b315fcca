"""Robots from URDF files: against Pinocchio's numbers, options, and what is refused."""

from __future__ import annotations

import random
import re
import sys
import warnings

import numpy as np
import pytest

import novaphy
from novaphy.testing import assert_allclose

pytestmark = pytest.mark.skipif(
    not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it"
)
FR3 = novaphy.assets.path("fr3.urdf")
REACH = [0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4]
INERTIAL = (
    '<inertial><origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/><mass value="2"/>'
    '<inertia ixx="0.03" iyy="0.04" izz="0.05" ixy="0.001" ixz="0.002" iyz="-0.003"/></inertial>'
)
SPHERE = '<geometry><sphere radius="0.1"/></geometry>'


def robot(*parts: str) -> str:
    return f'<robot name="r">{"".join(parts)}</robot>'


def link(name: str, inside: str = INERTIAL) -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, parent: str, child: str, inside: str = "", kind: str = "continuous") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}</joint>"
    )


TWO = (link("a"), link("b"), joint("j", "a", "b", '<axis xyz="0 0 1"/>'))


def loaded(source: object, **options: object):
    builder = novaphy.ModelBuilder()
    result = builder.add_urdf(source, **options)
    model = builder.finalize()
    return model, model.state(), result


def counts(builder: novaphy.ModelBuilder) -> list[int]:
    names = ("body", "shape", "joint", "joint_coord", "joint_dof", "articulation")
    return [getattr(builder, f"{name}_count") for name in names]


@pytest.mark.parametrize("collapse", [False, True])
def test_the_fr3_has_the_gravity_torques_and_the_tool_of_pinocchio(collapse):
    model, state, result = loaded(FR3, collapse_fixed_joints=collapse)
    state.joint_q.assign(np.float32([*REACH, 0, 0]))
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    bias = np.asarray(novaphy.eval_bias(model, state)).ravel()
    # Pinocchio 4.1, computeGeneralizedGravity of the same file.
    expected = [0, -3.85415002, -0.585383807, 22.2575440, 0.715423841, 2.20287493, 0, 0, 0]
    assert_allclose(bias, np.float32(expected), atol=2e-5, rtol=0)
    body = state.body_q.numpy()[result.links["fr3_hand_tcp"]].astype(float)
    offset = np.array(result.link_poses["fr3_hand_tcp"])
    tool = body[:3] + rotation(body[3:]) @ offset[:3]
    assert_allclose(tool, [0.30689, 0, 0.48688], atol=1e-5, rtol=0)
    assert model.articulation_count == 1 and model.body_count == (10 if collapse else 13)


def rotation(q: np.ndarray) -> np.ndarray:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


@pytest.mark.parametrize("collapse", [False, True])
def test_the_fr3_moves_as_in_pinocchio(collapse):
    pin = pytest.importorskip("pinocchio", reason="the oracle of this test: pip install pin")
    exact = pin.buildModelFromUrdf(str(FR3))
    data = exact.createData()
    model, state, _ = loaded(FR3, collapse_fixed_joints=collapse)
    draw = np.random.default_rng(0)
    for _ in range(20):
        q = draw.uniform(exact.lowerPositionLimit, exact.upperPositionLimit).astype(np.float32)
        qd, qdd = draw.uniform(-1, 1, (2, 9)).astype(np.float32)
        state.joint_q.assign(q)
        state.joint_qd.assign(qd)
        h = np.asarray(novaphy.eval_mass_matrix(model, state)).reshape(9, 9)
        pin.crba(exact, data, q.astype(float))
        h_exact = np.triu(data.M) + np.triu(data.M, 1).T
        assert_allclose(h, h_exact, atol=1e-5 * np.abs(h_exact).max(), rtol=0)
        tau = np.asarray(novaphy.eval_inverse_dynamics(model, state, qdd)).ravel()
        tau_exact = pin.rnea(exact, data, q.astype(float), qd.astype(float), qdd.astype(float))
        assert_allclose(tau, tau_exact, atol=1e-5 * np.abs(tau_exact).max(), rtol=0)


def test_collapsed_links_accelerate_as_before():
    accelerations = []
    for collapse in (False, True):
        model, state, _ = loaded(FR3, collapse_fixed_joints=collapse)
        state.joint_q.assign(np.float32([*REACH, 0.01, 0.02]))
        state.joint_qd.assign(np.linspace(-1, 1, 9).astype(np.float32))
        tau = np.linspace(3, -3, 9).astype(np.float32)
        accelerations.append(np.asarray(novaphy.eval_forward_dynamics(model, state, tau)).ravel())
    whole, merged = accelerations
    # The condition of the mass matrix is 1.7e4.
    assert_allclose(merged, whole, atol=2e-2 * 0.02 * np.abs(whole).max(), rtol=0)


def test_inertials_are_turned_and_scaled():
    model, _, result = loaded(robot(*TWO), scale=2.0)
    c, s = np.cos, np.sin
    roll, pitch, yaw = 0.4, -0.5, 0.6
    rx = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    ry = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
    rz = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
    r = rz @ ry @ rx
    i = np.array([[0.03, 0.001, 0.002], [0.001, 0.04, -0.003], [0.002, -0.003, 0.05]])
    b = result.links["b"]
    assert_allclose(model.body_inertia.numpy()[b], 4 * r @ i @ r.T, atol=1e-7, rtol=1e-6)
    assert_allclose(model.body_com.numpy()[b], [0.2, 0.4, 0.6], rtol=1e-6)
    assert model.body_mass.numpy()[b] == 2


def test_options_of_the_base():
    for floating, dofs in ((None, 1), (False, 1), (True, 7)):
        model, state, _ = loaded(robot(*TWO), floating=floating, xform=(1, 2, 3, 0, 0, 0, 1))
        assert model.joint_dof_count == dofs
        assert_allclose(state.body_q.numpy()[0, :3], [1, 2, 3])
    planar = {
        "joint_type": novaphy.JointType.D6,
        "linear_axes": [novaphy.JointDofConfig(axis="x"), novaphy.JointDofConfig(axis="y")],
    }
    assert loaded(robot(*TWO), base_joint=planar)[0].joint_dof_count == 3
    builder = novaphy.ModelBuilder(up_axis="y")
    builder.add_urdf(robot(*TWO), up_axis="z")
    turned = rotation(np.array(builder.body_q[0][3:]))
    assert_allclose(turned @ [0, 0, 1], [0, 1, 0], atol=1e-6)
    carrier = builder.add_body(mass=1.0, inertia=np.eye(3))
    result = builder.add_urdf(robot(*TWO), parent_body=carrier, xform=(0, 0, 1, 0, 0, 0, 1))
    assert result.articulations == [] and builder.articulation_count == 2
    assert_allclose(builder.body_q[result.links["a"]][:3], (0, 0, 1))
    for bad in ({"floating": True, "base_joint": planar}, {"floating": True, "parent_body": 0}):
        with pytest.raises(ValueError, match="floating"):
            builder.add_urdf(robot(*TWO), **bad)


TREE = robot(
    *(link(name) for name in "abcd"),
    joint("bd", "b", "d"), joint("ab", "a", "b"), joint("ac", "a", "c"),
)  # fmt: skip


@pytest.mark.parametrize(
    ("ordering", "follow", "joints", "links"),
    [
        ("dfs", True, ["ab", "bd", "ac"], "abdc"),
        ("bfs", True, ["ab", "ac", "bd"], "abcd"),
        ("dfs", False, ["ab", "bd", "ac"], "abcd"),
    ],
)
def test_orders(ordering, follow, joints, links):
    _, _, result = loaded(TREE, joint_ordering=ordering, bodies_follow_joint_ordering=follow)
    assert sorted(joints, key=result.joints.get) == joints
    assert "".join(sorted(links, key=result.links.get)) == links


def test_the_order_of_the_file_must_have_parents_first():
    with pytest.raises(ValueError, match="parents come first"):
        novaphy.ModelBuilder().add_urdf(TREE, joint_ordering=None)
    with pytest.raises(ValueError, match='joint_ordering: expected one of "dfs", "bfs", got "x"'):
        novaphy.ModelBuilder().add_urdf(TREE, joint_ordering="x")


def test_shapes_materials_and_what_is_shown():
    visual = (
        f'<visual>{SPHERE}<material name="red"><color rgba="1 0 0 0.5"/></material></visual>'
        f"<collision>{SPHERE}</collision>"
    )
    text = robot(link("a", INERTIAL + visual))
    flags, shapes = novaphy.ShapeFlags, []
    for options in ({}, {"hide_visuals": True}, {"force_show_colliders": True},
                    {"parse_visuals_as_colliders": True, "hide_visuals": True}):  # fmt: skip
        model, _, result = loaded(text, **options)
        shapes.append(model.shape_flags.numpy().tolist())
        if not options:
            assert result.shape_colors == {0: (1.0, 0.0, 0.0, 0.5)}
            assert_allclose(model.shape_color.numpy()[0], (1, 0, 0))
    meets = flags.COLLIDE_SHAPES | flags.COLLIDE_PARTICLES
    assert shapes == [[1, meets], [meets | 1], [1, meets | 1], [meets | 1]]
    model, _, _ = loaded(text, ignore_inertial_definitions=True)
    assert_allclose(model.body_mass.numpy(), [1000 * 4 / 3 * np.pi * 1e-3], rtol=1e-6)


def test_self_collisions():
    a, b, c = (link(n, INERTIAL + f"<collision>{SPHERE}</collision>") for n in "abc")
    text = robot(a, b, c, joint("ab", "a", "b"), joint("bc", "b", "c"))
    assert loaded(text)[0].shape_contact_pair_count == 1  # not neighbors
    assert loaded(text, enable_self_collisions=False)[0].shape_contact_pair_count == 0
    fixed = robot(a, b, c, joint("ab", "a", "b", kind="fixed"), joint("bc", "b", "c"))
    for collapse in (False, True):  # a and b are one
        assert loaded(fixed, collapse_fixed_joints=collapse)[0].shape_contact_pair_count == 0


BALL = (
    '<inertial><mass value="2"/>'  # with moments that the builder raises
    '<inertia ixx="0.03" iyy="0.04" izz="0.09" ixy="0" ixz="0" iyz="0"/></inertial>'
    f"<collision>{SPHERE}</collision>"
)


def three_balls(options: dict[str, bool], copies: int = 1) -> tuple[novaphy.Model, list[str]]:
    """The model, and what the first collides say. The third ball is 0.03 m in the first one."""
    at = '<origin xyz="{} 0 0"/>'.format  # neighbors do not meet
    text = robot(
        *(link(name, BALL) for name in "abc"),
        joint("i", "a", "b", at(0.1)),
        joint("j", "b", "c", at(0.07)),
    )
    builder = novaphy.ModelBuilder()
    builder.add_urdf(text, floating=True, **options)
    builder.add_shape_sphere(builder.add_body(), radius=0.1)  # another mechanism
    all_worlds = novaphy.ModelBuilder()
    for _ in range(copies):
        all_worlds.add_world(builder)
    all_worlds.add_ground_plane()
    model = all_worlds.finalize()
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for _ in range(3):
            pipeline.collide(model.state(), contacts)
    return model, [str(w.message) for w in said]


@pytest.mark.parametrize("copies", [1, 3])
def test_overlaps_at_the_start_are_named_once_or_left_out(copies: int):
    model, said = three_balls({}, copies)
    assert len(said) == 1
    assert said[0].startswith(
        "CollisionPipeline: 1 pair of shapes overlaps at the start: "
        '"a/collision_0" and "c/collision_0" by 0.03'
    )
    assert said[0].endswith("; filter_overlaps of add_urdf and add_mjcf leaves them out")
    apart, said = three_balls({"filter_overlaps": True}, copies)
    assert said == []
    pairs = [m.shape_contact_pair_count for m in (model, apart)]
    assert pairs[1] == pairs[0] - copies


def test_overlaps_away_from_the_start_are_not_named():
    at = '<origin xyz="{} 0 0"/>'.format
    axis = '<axis xyz="1 0 0"/>'
    text = robot(
        *(link(name, BALL) for name in "abc"),
        joint("i", "a", "b", at(0.1)),
        joint("j", "b", "c", at(0.2) + axis + '<limit effort="1" velocity="1"/>', kind="prismatic"),
    )
    model, state, result = loaded(text)
    q = model.joint_q.numpy()
    q[result.joint_coords["j"]] = -0.2
    state.joint_q.assign(q)
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pipeline.collide(state, contacts)
    assert contacts.active_rigid_contact_count == 1


def test_links_without_mass_may_hang_on_joints_that_never_move():
    still = '<axis xyz="0 1 0"/><limit effort="0" velocity="0" lower="-1" upper="1"/>'
    swings = '<axis xyz="0 1 0"/><limit effort="9" velocity="9" lower="-3" upper="3"/>'
    text = robot(
        *(link(name) for name in "ab"),
        link("c", ""),
        link("d", ""),
        joint("i", "a", "b", swings, kind="revolute"),
        joint("j", "b", "c", still, kind="revolute"),
        joint("k", "c", "d", still, kind="revolute"),
    )
    model, state, _ = loaded(text, xform=((0, 0, 0), (0.6, 0, 0, 0.8)))
    after = model.state()
    bare, rest, _ = loaded(
        robot(link("a"), link("b"), joint("i", "a", "b", swings, kind="revolute")),
        xform=((0, 0, 0), (0.6, 0, 0, 0.8)),
    )
    then = bare.state()
    solvers = [novaphy.solvers.SolverFeatherstone(m) for m in (model, bare)]
    for _ in range(20):
        solvers[0].step(state, after, None, None, 2e-3)
        solvers[1].step(rest, then, None, None, 2e-3)
        state, after, rest, then = after, state, then, rest
    np.testing.assert_array_equal(state.joint_qd.numpy(), [rest.joint_qd.numpy()[0], 0, 0])


def test_joints_start_within_their_limits():
    model, state, result = loaded(FR3)
    q, rows = model.joint_q.numpy(), result.joint_coords
    lower, upper = model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy()
    assert (lower <= q).all() and (q <= upper).all()
    assert q[rows["fr3_joint4"]] == upper[rows["fr3_joint4"]] < 0
    assert q[rows["fr3_joint6"]] == lower[rows["fr3_joint6"]] > 0
    assert q[rows["fr3_joint1"]] == 0
    start = state.body_q.numpy().copy()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    assert_allclose(state.body_q.numpy(), start, atol=2e-6, rtol=0)


@pytest.mark.parametrize(
    ("limit", "message"),
    [
        ('effort="1" velocity="0"', r'<joint name="j">: velocity="0" .* it never moves'),
        ('effort="0" velocity="1"', r'<joint name="j">: effort="0" .* its drive has no force'),
    ],
)
def test_limits_that_hold_a_joint_still_are_said(limit, message):
    axis = f'<axis xyz="0 0 1"/><limit lower="-1" upper="1" {limit}/>'
    with pytest.warns(UserWarning, match=message):
        loaded(robot(link("a"), link("b"), joint("j", "a", "b", axis, "revolute")))


LIMIT = '<limit lower="-1" upper="2" effort="3" velocity="4"/><dynamics damping="5"/>'


def test_limits_and_damping():
    text = robot(link("a"), link("b"), joint("j", "a", "b", LIMIT, "revolute"))
    model, _, _ = loaded(text)
    got = [
        getattr(model, f"joint_{name}").numpy()[0]
        for name in ("limit_lower", "limit_upper", "effort_limit", "velocity_limit", "damping")
    ]
    assert got == [-1, 2, 3, 4, 5]
    model, _, _ = loaded(text, joint_damping_mode="drive")
    assert model.joint_damping.numpy()[0] == 0 and model.joint_target_kd.numpy()[0] == 5
    model, _, _ = loaded(text.replace("revolute", "prismatic"), scale=2.0)
    assert [model.joint_limit_lower.numpy()[0], model.joint_limit_upper.numpy()[0]] == [-2, 4]


def test_a_mimic_is_refused_fixed_or_freed_if_asked():
    mimic = '<mimic joint="j" multiplier="2" offset="0.5"/>'
    text = robot(*TWO, link("c"), joint("k", "b", "c", mimic))
    with pytest.raises(NotImplementedError, match=r'<text>:1: <joint name="k">: mimic'):
        novaphy.ModelBuilder().add_urdf(text, mimic="refuse")
    model, state, result = loaded(text, mimic="fixed")
    assert model.joint_dof_count == 1
    assert_allclose(
        rotation(state.body_q.numpy()[result.links["c"], 3:]) @ [0, 1, 0],
        [0, np.cos(0.5), np.sin(0.5)], atol=1e-6,
    )  # fmt: skip
    assert loaded(text, mimic="independent")[0].joint_dof_count == 2


TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def test_meshes_are_looked_for_in_packages_and_beside_the_file(tmp_path):
    (tmp_path / "pack" / "urdf").mkdir(parents=True)
    (tmp_path / "pack" / "t.obj").write_text(TETRAHEDRON)
    (tmp_path / "outside.obj").write_text(TETRAHEDRON)
    file = tmp_path / "pack" / "urdf" / "r.urdf"

    def text(name: str) -> str:
        mesh = f'<geometry><mesh filename="{name}" scale="2 2 2"/></geometry>'
        return robot(link("a", INERTIAL + f"<collision>{mesh}</collision>"))

    for name, options in (
        ("../t.obj", {}),
        ("package://pack/t.obj", {"package_dirs": [tmp_path]}),
        ("package://pack/t.obj", {"package_dirs": [tmp_path / "pack"]}),
        ("package://pack/t.obj", {}),  # found in a parent folder of the file
        ("package:///pack/t.obj", {}),
        ("model://pack/t.obj", {}),
        (str(tmp_path / "pack" / "t.obj"), {}),
    ):
        file.write_text(text(name))
        model, _, _ = loaded(file, **options)
        assert model.shape_scale.numpy()[0].tolist() == [2, 2, 2]
        hull, _, _ = loaded(file, mesh_maxhullvert=8, **options)
        assert hull.shape_type.numpy()[0] == novaphy.GeoType.CONVEX_MESH
    for name, options, message in (
        ("package://pact/t.obj", {}, "there is no package://pact/t.obj in package_dirs, ROS_PACK"),
        ("package://other/t.obj", {"package_dirs": [tmp_path]}, "there is no package://other"),
        ("package://pack/../outside.obj", {"package_dirs": [tmp_path]}, "inside of its package"),
        ("../../outside.obj", {}, "the one above it"),
        ("nothing.obj", {}, "there is no file nothing.obj"),
    ):
        file.write_text(text(name))
        with pytest.raises(ValueError, match=f"r.urdf:1: <collision>: .*{message}"):
            novaphy.ModelBuilder().add_urdf(file, **options)
    with pytest.raises(FileNotFoundError):
        novaphy.ModelBuilder().add_urdf(tmp_path / "nothing.urdf")


def test_a_hull_has_at_most_so_many_corners(tmp_path):
    """Of 200 points on a ball; the hull lies within it, and keeps most of the extent."""
    draw = np.random.default_rng(0).normal(size=(200, 3))
    points = draw / np.linalg.norm(draw, axis=1, keepdims=True)
    faces = "".join(f"f {k} {k + 1} {k + 2}\n" for k in range(1, 199))
    ball = tmp_path / "ball.obj"
    ball.write_text("".join("v {:.5f} {:.5f} {:.5f}\n".format(*p) for p in points) + faces)
    mesh = f'<geometry><mesh filename="{ball}"/></geometry>'
    text = robot(link("a", INERTIAL + f"<collision>{mesh}</collision>"))
    for corners in (8, 32):
        model, _, _ = loaded(text, mesh_maxhullvert=corners, package_dirs=[tmp_path])
        vertices = model.mesh_vertices.numpy()
        assert 4 <= len(vertices) <= corners
        assert np.ptp(vertices, axis=0).min() > 1.2
        assert np.linalg.norm(vertices, axis=1).max() < 1 + 1e-4


@pytest.mark.parametrize("variable", ["ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"])
def test_packages_are_where_ros_has_them(tmp_path, monkeypatch, variable):
    share = tmp_path / ("share" if variable.startswith("AMENT") else "")
    (share / "far").mkdir(parents=True)
    (share / "far" / "t.obj").write_text(TETRAHEDRON)
    (tmp_path / "src" / "near").mkdir(parents=True)
    (tmp_path / "src" / "near" / "package.xml").write_text("<package><name>near</name></package>")
    (tmp_path / "src" / "near" / "t.obj").write_text(TETRAHEDRON)
    (tmp_path / "src" / "of_robot").mkdir()
    file = tmp_path / "src" / "of_robot" / "r.urdf"
    monkeypatch.setenv(variable, f"/nothing:{tmp_path}")
    for name in ("far", "near"):  # "near" is a package beside that of the file
        mesh = f'<geometry><mesh filename="package://{name}/t.obj"/></geometry>'
        file.write_text(robot(link("a", INERTIAL + f"<collision>{mesh}</collision>")))
        assert loaded(file)[0].shape_count == 1


def test_a_package_may_lie_deeper_below_the_path_of_ros(tmp_path, monkeypatch):
    package = tmp_path / "src" / "stack" / "folder"
    (package / "m").mkdir(parents=True)
    (package / "package.xml").write_text("<package format='3'><name>\n deep </name></package>")
    (package / "m" / "t.obj").write_text(TETRAHEDRON)
    inner = package / "other" / "package.xml"  # not searched, because packages do not nest
    inner.parent.mkdir()
    inner.write_text("<package><name>inner</name></package>")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    text = robot(link("a", INERTIAL + '<collision><geometry><mesh filename="{}"/></geometry>'
                      "</collision>"))  # fmt: skip
    assert loaded(text.format("package://deep//m/t.obj"))[0].shape_count == 1
    with pytest.raises(ValueError, match="there is no package://inner/t.obj"):
        loaded(text.format("package://inner/t.obj"))
    with pytest.raises(ValueError, match="expected a file inside of its package"):
        loaded(text.format("package://deep/../folder2/../../stack/folder/../x/../../stack"))


def test_a_shape_of_an_unknown_kind_that_is_only_seen_is_left_out():
    plane = '<geometry><plane normal="0 0 1"/></geometry>'
    with pytest.warns(UserWarning, match="<plane>: left out: a shape other than <box>"):
        model, _, _ = loaded(robot(link("a", INERTIAL + f"<visual>{plane}</visual>")))
    assert model.shape_count == 0
    with pytest.raises(NotImplementedError, match="a shape other than <box>"):
        loaded(robot(link("a", INERTIAL + f"<collision>{plane}</collision>")))


def test_a_mesh_that_is_only_seen_may_be_missing():
    mesh = '<geometry><mesh filename="nothing.obj"/></geometry>'
    text = robot(link("a", INERTIAL + f"<visual>{mesh}</visual>"))
    with pytest.warns(
        UserWarning, match=r"<visual>: left out: its mesh is left out: .*nothing\.obj"
    ):
        model, _, result = loaded(text)
    assert model.shape_count == 0 and len(result.report.left_out) == 1
    assert loaded(text, hide_visuals=True)[2].warnings == []
    collider = text.replace("visual", "collision")
    with pytest.raises(ValueError, match=r"<collision>: nothing\.obj needs package_dirs"):
        loaded(collider)
    with pytest.warns(UserWarning, match=r"<collision>: left out: its mesh"):
        loaded(collider, unsupported="warn")
    with pytest.raises(ValueError, match='unsupported: expected one of "error", "warn"'):
        loaded(collider, unsupported="maybe")


def test_scale_is_of_places_and_sizes():
    box = '<collision><origin xyz="1 2 3"/><geometry><box size="2 4 6"/></geometry></collision>'
    text = robot(
        link("a", INERTIAL + box), link("b"), joint("j", "a", "b", '<origin xyz="1 2 3"/>')
    )
    model, _, _ = loaded(text, scale=2.0)
    assert_allclose(model.shape_scale.numpy()[0], [2, 4, 6])  # half extents
    assert_allclose(model.shape_transform.numpy()[0, :3], [2, 4, 6])
    assert_allclose(model.joint_X_p.numpy()[1, :3], [2, 4, 6])


def test_planar_and_floating_joints_have_the_dofs_of_their_names():
    axis = '<axis xyz="0 0 1"/>'
    for kind, dims, axes in (("planar", [2, 1], 3), ("floating", [3, 3], 6)):
        model, _, _ = loaded(robot(link("a"), link("b"), joint("j", "a", "b", axis, kind)))
        assert model.joint_dof_dim.numpy()[1].tolist() == dims
        assert model.joint_dof_count == axes
        if kind == "planar":  # two axes within the plane, and the normal
            assert_allclose(model.joint_axis.numpy() @ [0, 0, 1], [0, 0, 1])


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        *(({"scale": x}, ValueError, "scale: expected a finite number > 0") for x in (0, np.nan)),
        ({"parent_body": 3}, IndexError, r"parent_body: expected -1 \(the world\) to -1, got 3"),
        ({"up_axis": "w"}, ValueError, 'expected "x", "y" or "z", got "w"'),
        ({"joint_damping_mode": "x"}, ValueError, 'one of "passive", "drive", got "x"'),
        ({"mimic": "x"}, ValueError, 'mimic: expected one of "follow", .*got "x"'),
        ({"base_joint": 3}, TypeError, "base_joint: expected a dict, got int"),
        ({"base_joint": {}}, ValueError, "base_joint: expected a joint_type, got none"),
        ({"base_joint": {"type": 1}}, ValueError, "base_joint: expected joint_type, .*got type"),
        *(
            ({"mesh_maxhullvert": n}, ValueError, f"mesh_maxhullvert: expected 4 to 64, got {n}")
            for n in (3, 65)
        ),
        ({"package_dirs": "x"}, TypeError, "package_dirs: expected a list of folders, got str"),
        ({"package_dirs": [3]}, TypeError, r"package_dirs\[0\]: expected a folder"),
        ({"xform": (0,) * 7}, ValueError, "xform.q: expected a quaternion of length 1"),
        ({"xform": (0, 0, np.nan, 0, 0, 0, 1)}, ValueError, "xform.p: expected finite numbers"),
    ],
)
def test_a_bad_option_is_named(options, error, message):
    builder = novaphy.ModelBuilder()
    with pytest.raises(error, match=message):
        builder.add_urdf(robot(*TWO), **options)
    assert counts(builder) == [0] * 6


def test_what_is_not_read_is_said():
    with pytest.warns(UserWarning, match="<safety_controller>: not read"):
        safety = LIMIT + '<safety_controller k_velocity="1"/>'
        loaded(robot(link("a"), link("b"), joint("j", "a", "b", safety, "revolute")))
    with pytest.warns(UserWarning, match="<gazebo>"):
        loaded(robot(link("a"), "<gazebo/>"))
    with pytest.warns(UserWarning, match='<link name="b">: it moves and has no <iner'):
        novaphy.ModelBuilder().add_urdf(robot(link("a"), link("b", ""), joint("j", "a", "b")))


def nested(depth: int) -> str:
    return robot("<a>" * depth)


BAD = {
    "empty": ("", "expected a path or XML"),
    "no robot": ("<sdf/>", "expected the root element <robot>"),
    "two roots": (robot(link("a")) + "<b/>", "expected one root element"),
    "no link": (robot(), "expected a <link>"),
    "cut": (robot(link("a"))[:-9], "expected XML"),
    "deep": (nested(100_000), "expected XML"),
    "deeper": (nested(1_000_000), "expected XML"),
    "doctype": ('<!DOCTYPE r [<!ENTITY x "y">]>' + robot(link("a")), "entities are not read"),
    "xacro": (robot('<xacro:include filename="x"/>'), "with xacro first"),
    "macro": (robot(link("${a}")), "with xacro first"),
    "nameless": (robot("<link/>"), "name: expected a name"),
    "twice": (robot(link("a"), link("a")), "expected different names, got one of line 1"),
    "joint twice": (robot(*TWO, link("c"), joint("j", "a", "c")), "expected different names"),
    "two tops": (robot(link("a"), link("b")), 'expected one root.*got "a" and "b"'),
    "cycle": (robot(link("a"), link("b"), joint("x", "a", "b"), joint("y", "b", "a")),
              "the joints are a cycle"),
    "cycle aside": (robot(link("o"), link("a"), link("b"), joint("x", "a", "b"),
                          joint("y", "b", "a")), "it is in a cycle"),
    "itself": (robot(link("o"), link("a"), joint("x", "a", "a")), "it is in a cycle"),
    "two parents": (robot(link("a"), link("b"), link("c"), joint("x", "a", "c"),
                          joint("y", "b", "c")), 'expected one parent of the link "c"'),
    "no such link": (robot(link("a"), joint("x", "a", "b")), 'there is no link "b"'),
    "no such mimic": (robot(*TWO, link("c"), joint("k", "b", "c", '<mimic joint="?"/>')),
                      "mimics a joint that does not exist"),
    "mimic cycle": (robot(*TWO, link("c"), link("d"), joint("k", "b", "c", '<mimic joint="m"/>'),
                          joint("m", "c", "d", '<mimic joint="k"/>')), "that does not follow"),
    "mimics itself": (robot(*TWO, link("c"), joint("k", "b", "c", '<mimic joint="k"/>')),
                      "that does not follow"),
    "axis nan": (robot(link("a"), link("b"), joint("j", "a", "b", '<axis xyz="0 nan 1"/>')),
                 "xyz: expected finite numbers"),
    "type": (robot(link("a"), link("b"), joint("j", "a", "b", kind="screw")), 'got "screw"'),
    "axis": (robot(link("a"), link("b"), joint("j", "a", "b", '<axis xyz="0 0 0"/>')),
             "expected a vector that is not zero"),
    "damping": (robot(link("a"), link("b"), joint("j", "a", "b",
                LIMIT.replace('"5"', '"-5"'), "revolute")), "damping: expected >= 0"),
    "mass": (robot(link("a", INERTIAL.replace('"2"', '"-2"'))), "value: expected >= 0"),
    "radius": (robot(link("a", f"<collision>{SPHERE}</collision>".replace("0.1", "-1"))),
               "radius: expected > 0"),
    "rgba": (robot(link("a", f'<visual>{SPHERE}<material name="m"><color rgba="0 0 2 1"/>'
                   "</material></visual>")), "rgba: expected 0 to 1"),
    "no text": (robot(link("&#xD800;")), "expected UTF-8"),
    "cone": (robot(link("a", '<collision><geometry><cone radius="1"/></geometry></collision>')),
             "a shape other than <box>"),
    **{f"number {text}": (robot(link("a", INERTIAL.replace("0.04", text))), "iyy: expected")
       for text in ("nan", "inf", "1e999", "1,5", "0x10", "1.5abc", "", "1 2")},
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_and_the_builder_stays(name):
    text, message = BAD[name]
    builder = novaphy.ModelBuilder()
    builder.add_urdf(robot(*TWO))
    before = counts(builder)
    with pytest.raises((ValueError, NotImplementedError), match=re.compile(message, re.S)):
        builder.add_urdf(text)
    assert counts(builder) == before
    builder.finalize()


def test_an_inertia_of_a_file_is_balanced_unless_the_builder_refuses_it():
    text = robot(link("a", INERTIAL.replace('"0.03"', '"3"')))
    builder = novaphy.ModelBuilder()
    builder.add_urdf(text, floating=True)
    with pytest.warns(RuntimeWarning, match=r"finalize: body_inertia\[0\] \(.*a\): all principal"):
        model = builder.finalize()
    least, middle, largest = np.linalg.eigvalsh(model.body_inertia.numpy()[0].astype(float))
    assert least + middle == pytest.approx(largest, rel=1e-5)
    builder = novaphy.ModelBuilder()
    builder.balance_inertia = False
    with pytest.raises(ValueError, match=r"(?s)exceeds the sum"):
        builder.add_urdf(text)
    assert builder.body_count == 0


def test_many_links():
    names = [f"l{k}" for k in range(100_000)]
    chain = [joint(f"j{k}", f"l{k}", f"l{k + 1}") for k in range(9_999)]
    for count in (10_001, 100_000):
        builder = novaphy.ModelBuilder()
        with pytest.raises(ValueError, match="expected at most 10000 links"):
            builder.add_urdf(robot(*map(link, names[:count])))
        assert counts(builder) == [0] * 6
    builder = novaphy.ModelBuilder()
    builder.add_urdf(robot(*map(link, names[:2000]), *chain[:1999]))
    assert builder.body_count == 2000


def mutated(draw: random.Random, text: str) -> str:
    """The text with a few pieces changed, taken out, doubled or exchanged."""
    for _ in range(draw.randint(1, 4)):
        at, length = draw.randrange(len(text)), draw.choice([1, 1, 3, 20, 200])
        piece = text[at : at + length]
        to = draw.randrange(len(text))
        values = ["", piece * 2, draw.choice(["nan", "-1", "1e308", '"', "<", "/>", "&#0;", "0"])]
        text = text[:at] + draw.choice(values) + text[at + length :]
        if draw.random() < 0.3:
            text = text[:to] + piece + text[to:]
    return text


@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::RuntimeWarning")
def test_mutated_files_are_read_or_refused():
    draw = random.Random(1)
    base = re.sub(r"<!--.*?-->", "", FR3.read_text("utf-8"), flags=re.S)
    read = 0
    for _ in range(1500):
        builder = novaphy.ModelBuilder()
        text = mutated(draw, base)
        try:
            builder.add_urdf(text)
            builder.finalize()
            read += 1
        except (ValueError, NotImplementedError, OSError):
            if builder.body_count:  # finalize refused it
                continue
            assert counts(builder) == [0] * 6
    assert 20 < read < 1400


XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:property name="mass" value="${1 + 2}"/>
<xacro:macro name="ball" params="name"><link name="${name}"><inertial><mass value="${mass}"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry>
<mesh filename="mesh.obj"/></geometry></collision></link></xacro:macro>
<xacro:ball name="a"/></robot>"""
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def test_a_xacro_file_is_expanded_by_the_package(tmp_path):
    pytest.importorskip("xacro", reason="what this test is about: pip install xacro")
    (tmp_path / "arm.xacro").write_text(XACRO)
    (tmp_path / "mesh.obj").write_text(OBJ)
    model, _, result = loaded(tmp_path / "arm.xacro")
    assert model.body_mass.numpy().tolist() == [3.0] and result.links == {"a": 0}
    (tmp_path / "bad.xacro").write_text(XACRO.replace("1 + 2", "1 + nothing"))
    with pytest.raises(ValueError, match="bad.xacro: xacro: .*nothing"):
        loaded(tmp_path / "bad.xacro")


def test_a_xacro_file_needs_the_package(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacro", None)
    (tmp_path / "arm.xacro").write_text(XACRO)
    with pytest.raises(ValueError, match="arm.xacro: expected the Python package xacro"):
        loaded(tmp_path / "arm.xacro")


def test_the_package_gets_the_path_and_its_folder_may_be_read(tmp_path, monkeypatch):
    """With a stand-in of the package."""
    folder = tmp_path / "robot" / "urdf"
    folder.mkdir(parents=True)
    (tmp_path / "xacro.py").write_text(
        "from xml.dom.minidom import parseString\n"
        "def process_file(path):\n"
        "    return parseString(open(path).read().replace('MASS', '2'))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "xacro", raising=False)
    (folder.parent / "mesh.obj").write_text(OBJ)
    inside = INERTIAL.replace('mass value="2"', 'mass value="MASS"')
    shape = '<collision><geometry><mesh filename="../mesh.obj"/></geometry></collision>'
    (folder / "arm.xacro").write_text(robot(link("a", inside + shape)))
    model, _, _ = loaded(folder / "arm.xacro")
    assert model.body_mass.numpy().tolist() == [2.0] and model.shape_count == 1
    monkeypatch.delitem(sys.modules, "xacro")


def test_links_to_keep():
    text = robot(link("a"), link("b"), link("c"), joint("j", "a", "b", kind="fixed"),
                 joint("k", "b", "c", kind="fixed"))  # fmt: skip
    model, _, result = loaded(text, collapse_fixed_joints=True, links_to_keep=["c"])
    assert list(model.body_label) == ["a", "c"]
    assert result.joints["j"] == -1 and result.joints["k"] == 1
    assert_allclose(model.body_mass.numpy(), [4.0, 2.0])
    with pytest.raises(ValueError, match='add_urdf: links_to_keep: there is no link "d"'):
        loaded(text, links_to_keep=["d"])
