"""What MJCF files say in many ways: numbers against MuJoCo's, and against closed forms."""

from __future__ import annotations

import importlib.util
import random
import struct
from pathlib import Path

import numpy as np
import pytest

import novaphy
from novaphy.testing import assert_allclose

pytestmark = pytest.mark.skipif(
    not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it"
)
BENCH = Path(__file__).parents[2] / "tools/bench/robot_files.py"
GEOM = '<geom type="box" size=".1 .2 .3" pos=".1 .05 .02"/>'
ARM = (
    '<body name="a" pos="0 0 1"><joint name="j" axis="0 1 0" range="-1 2" {joint}/>' + GEOM +
    '<body name="b" pos="0 0 .5"><joint name="k" axis="1 0 0"/>' + GEOM + "</body></body>"
)  # fmt: skip
# A wedge with a notch: neither convex nor symmetric.
NOTCH = (
    'vertex="0 0 0 .3 0 0 .3 .2 0 0 .2 0 0 0 .4 .3 0 .1 .3 .2 .1 0 .2 .4 .1 .1 .15" '
    'face="0 2 1 0 3 2 0 1 5 0 5 4 1 2 6 1 6 5 2 3 7 2 7 6 3 0 4 3 4 7 4 5 8 5 6 8 6 7 8 7 4 8"'
)


def mjcf(inside: str, before: str = "", after: str = "") -> str:
    return f"<mujoco>{before}<worldbody>{inside}</worldbody>{after}</mujoco>"


def actuated(actuators: str, joint: str = "", before: str = "") -> str:
    return mjcf(ARM.format(joint=joint), before, f"<actuator>{actuators}</actuator>")


def loaded(source: object, **options: object):
    builder = novaphy.ModelBuilder()
    robot = builder.add_mjcf(source, **options)
    return builder.finalize(), robot


def meshes(mesh: str, geom: str = "") -> str:
    asset = f'<asset><mesh name="m" {NOTCH} {mesh}/></asset>'
    return mjcf(
        f'<body><freejoint/><geom type="mesh" mesh="m" pos=".1 .2 .3" euler="10 20 30" {geom}/>'
        "</body>", asset)  # fmt: skip


FEATURES = {
    "eulerseq": mjcf('<body euler="10 20 30"><joint/>' + GEOM + "</body>",
                     '<compiler eulerseq="XzY" angle="radian"/>'),
    "frames": mjcf('<frame pos="1 0 0" euler="0 0 30"><body pos="0 1 0"><frame pos="0 0 .1" '
                   'zaxis="1 1 0"><joint axis="0 1 0" pos=".1 0 0"/>' + GEOM
                   + "</frame></body></frame>"),
    "copies": mjcf('<replicate count="12" offset="1 0 .1" euler="0 0 20" sep="-"><body name="a" '
                   'pos="0 .3 0"><joint name="j"/>' + GEOM + '<site name="s"/></body></replicate>'),
    "ref": mjcf('<body pos="0 0 1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 '
                '0 1" '
                'ref="1.25"/><joint axis="0 1 0" ref="20" pos="0 0 .2"/>' + GEOM + "</body>"),
    "hinges in several places": mjcf(
        '<body><joint axis="0 1 0" pos=".1 0 0" damping="1"/><joint axis="1 0 0" pos="0 .2 0"/>'
        '<joint type="slide" axis="0 0 1" armature=".1"/><joint axis="0 1 0"/>' + GEOM + "</body>"),
    "slide and ball": mjcf('<body><joint type="slide" axis="1 0 0"/><joint type="ball" pos=".1 0 '
                           '0" '
                           'damping=".3" armature=".2"/>' + GEOM + "</body>"),
    "free joint with damping": mjcf('<body pos="1 2 3"><joint type="free" damping=".3" '
                                    'armature=".2"/>'
                                    + GEOM + '<geom size=".1" pos="1 0 0"/></body>'),
    "springs of balls": mjcf(
        '<body euler="10 20 30"><joint type="ball" pos=".1 0 0" stiffness="3" damping=".2"/>' + GEOM
        + '<body pos="0 0 1" euler="40 0 10"><joint type="ball" stiffness=".7" range="0 50"/>'
        + GEOM + '</body></body><body pos="1 2 3" euler="0 50 20"><joint type="free" '
        'stiffness="2"/>' + GEOM + "</body>"),
    "springdamper": mjcf(
        '<body><joint axis="0 1 0" springdamper=".05 1"/><geom size=".1" pos="1 0 0"/><body '
        'pos="1 0 0"><joint axis="0 1 0" armature=".3" damping="7" stiffness="5" '
        'springdamper=".1 .7" springref="20"/>' + GEOM + "</body></body>"),
    "fixed point mass": mjcf('<body><joint/>' + GEOM + '<body pos="0 0 1"><inertial pos="0 0 .1" '
                             'mass="2" diaginertia="0 0 0"/></body></body>'),
    "groups": mjcf('<body><joint/>' + GEOM + '<geom size=".4" group="2"/></body>',
                   '<compiler inertiagrouprange="0 1"/>'),
    "total mass": mjcf(ARM.format(joint=""), '<compiler settotalmass="14"/>'),
    "bounds": mjcf('<body><joint/><geom size=".01"/><body><joint/>' + GEOM + "</body></body>",
                   '<compiler boundmass="2" boundinertia=".3"/>'),
    "balance": mjcf('<body><joint/><inertial pos="1 0 0" euler="0 9 0" mass="2" '
                    'diaginertia="1 2 9"/></body>', '<compiler balanceinertia="true"/>'),
    "masses of geoms": mjcf('<body><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
                            + GEOM + '<geom type="capsule" size=".1 .2" mass="3" pos="1 0 0"/>'
                            '<geom type='
                            '"ellipsoid" size=".1 .2 .3"/><geom type="cylinder" size=".1 '
                            '.2"/></body>',
                            '<compiler inertiafromgeom="true"/>'),
    "legacy mesh": meshes(""),
    "exact mesh": meshes('inertia="exact"'),
    "convex mesh": meshes('inertia="convex"'),
    "shell mesh": meshes('inertia="shell"', 'mass="2"'),
    "mirrored mesh": meshes('inertia="exact" scale="-2 1 .5" refpos=".1 0 .2" refquat="1 .2 0 .4"'),
    "points": mjcf('<body><freejoint/><geom type="mesh" mesh="m"/></body>', '<asset><mesh name="m" '
                   'vertex="0 0 0 1 0 0 0 1 0 0 0 1 .2 .2 .2" inertia="exact"/></asset>'),
    "motor": actuated('<motor joint="j" gear="3" ctrlrange="-.2 .5"/>', 'stiffness="2" '
                                                                        'springref="20"'),
    "two motors": actuated('<motor joint="j" gear="3"/><motor joint="j" forcerange="-.1 .2"/>'),
    "position": actuated('<position joint="j" kp="20" kv="3" gear="2" ctrlrange="-.5 .5"/>',
                         'stiffness="7" springref="30" damping="2"'),
    "clipped position": actuated('<position joint="j" kp="200" gear="2" forcerange="-3 3"/>'),
    "joint force range": actuated('<motor joint="j" gear="-5"/><position joint="k" kp="9"/>',
                                  'actuatorfrcrange="-1 2"'),
    "position and velocity": actuated('<position joint="j" kp="20"/><velocity joint="j" kv="3" '
                                      'gear="-2"/><motor joint="j" gear=".5"/>'),
    "general": actuated('<general joint="j" gainprm="4" biastype="affine" biasprm="1 -3 -2"/>'
                        '<general joint="k" gainprm="4" biastype="affine" biasprm="1 0 -2"/>'),
    "damping ratio of a free body": mjcf(
        "<body><freejoint/>" + GEOM + '<body><joint type="ball"/>' + GEOM + ARM.format(joint="")
        + "</body></body>", after='<actuator><position joint="j" kp="3" '
                                  'dampratio="1"/></actuator>'),
    "damping ratio": actuated('<position joint="j" kp="20" dampratio="1"/><position joint="k" '
                              'kp="5" '
                              'dampratio=".7" gear="3"/>', 'ref="10" armature=".1"'),
    "inherited range": actuated('<position joint="j" kp="20" inheritrange=".8"/>'),
    "classes of actuators": actuated(
        '<position class="x" joint="j"/><velocity class="y" joint="k"/>',
        before='<default><position kp="10" kv="2"/><velocity kv="3"/><default class="x"><motor '
        'ctrlrange="-.1 .2"/><position/></default><default class="y"><motor/></default></default>'),
    "activations": actuated(
        '<position joint="j" kp="20" kv="1" timeconst=".3"/><intvelocity joint="k" kp="9" '
        'kv=".5" actrange="-.4 .6"/><general joint="j" dyntype="filter" dynprm=".2" gainprm="3"/>'
        '<general joint="k" dyntype="integrator" actrange="-.5 .5" gear="-2"/>'
        '<cylinder joint="j" area="2" bias="1 -2 -.1" timeconst=".5"/>'),
    "gains by the state": actuated(
        '<damper joint="j" kv="3" gear="2" ctrlrange="0 2"/><general joint="k" gaintype="affine" '
        'gainprm="2 -1 -.5" biastype="affine" biasprm=".3 -1 -1" ctrlrange="0 1"/>'),
    "ranges of forces": actuated(
        '<position joint="j" kp="200" gear="-2" forcerange="-1 3"/>'
        '<position joint="k" kp="50" kv="2"/><motor joint="k" gear="3" forcerange="-.2 .1"/>',
        'actuatorfrcrange="-4 5"'),
    "gravity compensation": mjcf(
        '<body gravcomp=".7"><freejoint/>' + GEOM + '<body gravcomp="1.5"><joint type="ball"/>'
        + GEOM + ARM.format(joint="") + "</body></body>"),
    "flags": actuated('<motor joint="j" ctrlrange="-.1 .1"/>', 'damping="3" stiffness="4"',
                      '<option gravity="1 2 3"><flag clampctrl="disable" '
                      'damper="disable"/></option>'),
    "pairs": mjcf(
        '<geom name="w" size=".1"/><body mocap="true"><geom name="m" size=".1"/><body><joint/>'
        '<geom name="n" size=".1"/></body></body><body mocap="true"><geom name="o" '
        'size=".1"/></body>'
        '<body name="a"><joint/><geom name="a" size=".1" contype="0" conaffinity="0"/><body '
        'name="b">'
        '<joint/><geom name="b" size=".1"/></body></body><body><joint/><joint axis="1 0 0" '
        'pos="1 0 0"/>'
        '<geom name="c" size=".1"/><body><joint/><geom name="d" size=".1"/></body></body>',
        after='<contact><pair geom1="a" geom2="b"/><pair geom1="c" geom2="d"/><exclude body1="b" '
        'body2="world"/></contact>'),
    "parents meet": mjcf('<geom size=".1"/>' + ARM.format(joint=""),
                         '<option><flag filterparent="disable"/></option>'),
    "plane of a body": mjcf('<body pos="0 0 -1"><geom name="f" type="plane" size="1 1 1"/></body>'
                            + ARM.format(joint="")),
}  # fmt: skip


@pytest.mark.parametrize("name", FEATURES)
def test_numbers_are_those_of_mujoco(name, monkeypatch):
    """At random states: masses, poses, mass matrix, inverse dynamics, forces, pairs of geoms."""
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    monkeypatch.syspath_prepend(BENCH.parent)
    spec = importlib.util.spec_from_file_location("robot_files", BENCH)
    bench = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bench)
    exact = mujoco.MjModel.from_xml_string(FEATURES[name])
    assert exact.nv > 0
    differences = bench.compare(exact, *loaded(FEATURES[name]))
    assert len(differences) >= 6 and differences.pop("pairs") == 0
    assert max(differences.values()) < 1e-5, differences


def write(folder: Path, files: dict[str, str | bytes]) -> Path:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / "main.xml"


TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
CUBE_MSH = struct.pack("<4i", 4, 0, 0, 4) + struct.pack(
    "<12f12i", 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3
)
MESH = '<asset><mesh name="m" file="{}"/></asset>'.format
SHOWN = '<body><freejoint/><geom type="mesh" mesh="m"/></body>'


@pytest.mark.parametrize("name", ["t.obj", "t.msh"])
def test_files_are_where_mujoco_looks_for_them(tmp_path, name):
    """Beside the main file, by meshdir, and beside the file that an element was included from."""
    mesh = CUBE_MSH if name.endswith("msh") else TETRAHEDRON
    main = mjcf(SHOWN, '<include file="inc/a.xml"/>')
    for files in (
        {"inc/a.xml": f"<mujocoinclude>{MESH(name)}</mujocoinclude>", name: mesh},
        {"inc/a.xml": f"<mujoco>{MESH(name)}</mujoco>", f"inc/{name}": mesh},
        {"inc/a.xml": f'<x><compiler meshdir="m"/>{MESH(name)}</x>', f"m/{name}": mesh},
        {"inc/a.xml": '<x><include file="b.xml"/></x>', f"inc/{name}": mesh,
         "inc/b.xml": f'<x><compiler assetdir="inc" strippath="true"/>{MESH("far/" + name)}</x>'},
    ):  # fmt: skip
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        model, robot = loaded(write(folder, {"main.xml": main, **files}))
        assert_allclose(model.body_mass.numpy()[0], 1000 / 6, rtol=1e-6)
        assert robot.report.read["mesh"] == 1


def test_included_elements_keep_their_places(tmp_path):
    files = {"main.xml": mjcf('\n<include file="b.xml"/>'),
             "b.xml": "<x>\n<!-- -->\n<body>\n<joint axis='0 0 0'/></body></x>"}  # fmt: skip
    with pytest.raises(ValueError, match=r"b\.xml:4: <joint>: axis: expected a vector"):
        loaded(write(tmp_path, files))


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"a.xml": '<x><include file="main.xml"/></x>'}, "expected each file once"),
        ({"a.xml": '<x><include file="b.xml"/></x>', "b.xml": '<x><include file="a.xml"/></x>'},
         r"b\.xml:1: <include>: expected each file once"),
        ({"a.xml": '<x><include file="../../far.xml"/></x>', "../../far.xml": "<x/>"},
         "the one above it"),
        ({"a.xml": '<!DOCTYPE m [<!ENTITY a "b">]><x/>'}, r"a\.xml:0: <!DOCTYPE: .* not read"),
        ({"a.xml": "<x>" + "<body>" * 60 + '<include file="b.xml"/>' + "</body>" * 60 + "</x>",
          "b.xml": "<x>" + "<body>" * 60 + "</body>" * 60 + "</x>"}, "at most 100 elements"),
        ({"a.xml": "<x>" + " " * (33 << 20) + '<include file="b.xml"/></x>',
          "b.xml": "<x>" + " " * (33 << 20) + "</x>"}, "at most 64 MiB in all"),
        ({"a.xml": "<x"}, r"a\.xml:1: expected XML"),
        ({"a.xml": "<x><include/></x>"}, "file: missing"),
        ({"a.xml": '<x><include file="none.xml"/></x>'}, "there is no file none.xml"),
        ({"a.xml": MESH("t.msh"), "t.msh": CUBE_MSH[:-1]}, "expected a whole .msh file"),
        ({"a.xml": MESH("t.msh"), "t.msh": CUBE_MSH[:-4] + b"\x09\0\0\0"}, "corners from 0 to 3"),
        ({"a.xml": "<x>" + MESH("../../t.obj") + "</x>", "../../t.obj": TETRAHEDRON},
         "<mesh name=\"m\">: expected a file in the folder"),
    ],
)  # fmt: skip
def test_files_of_files_are_not_trusted(tmp_path, files, message):
    if files["a.xml"].startswith("<asset"):
        files["a.xml"] = f"<x>{files['a.xml']}</x>"
    main = write(tmp_path / "1/2", {"main.xml": mjcf(SHOWN, '<include file="a.xml"/>'), **files})
    builder = novaphy.ModelBuilder()
    with pytest.raises(ValueError, match=message):
        builder.add_mjcf(main)
    assert builder.body_count == builder.shape_count == 0


def test_what_has_no_counterpart_is_left_out_and_listed():
    text = actuated(
        '<muscle name="m" joint="j"/><position joint="k" kp="3"/>', before=MESH("nothing.obj") +
        '<option density="1.2"/><default><geom fluidshape="ellipsoid"/></default>').replace(
        "</mujoco>", '<equality>\n<connect body1="a" anchor="0 0 0"/></equality><sensor><jointpos '
        'joint="j"/></sensor></mujoco>').replace(
        "</worldbody>",
        '<geom type="mesh" mesh="m" contype="0" conaffinity="0"/></worldbody>')  # fmt: skip
    with pytest.raises(
        NotImplementedError, match=r'fluidshape: .* \(unsupported="warn" leaves it out'
    ):
        loaded(text)
    with pytest.warns(UserWarning, match=r"<text>:2: <connect>: left out: an equality of the kind"):
        _, robot = loaded(text, unsupported="warn")
    assert [n.element for n in robot.report.left_out] == [
        "<connect>", "<geom>", "<geom>", "<geom>", "<geom>", '<muscle name="m">',
    ]  # fmt: skip
    assert robot.report.read == {
        "actuator": 2, "body": 2, "equality": 1, "geom": 2, "joint": 2, "mesh": 1, "sensor": 1,
    }  # fmt: skip
    assert len(robot.actuators) == 1 and "left out:" in str(robot.report)


def test_what_only_looks_as_if_it_acted_is_read():
    flags = '<option><flag constraint="disable" actuation="disable"/></option>'
    inside = (
        '<body name="b"><joint name="j" range="-1 1"/>'
        + GEOM
        + '<site name="s" pos="1 2 3"/></body>'
    )
    after = (
        '<equality><joint joint1="j"/></equality><actuator><motor joint="j"/></actuator><tendon>'
        '<fixed limited="true" range="0 1"><joint joint="j" coef="1"/></fixed></tendon>'
    )
    model, robot = loaded(mjcf(inside, flags, after), xform=(0, 0, 1, 0, 0, 0, 1))
    assert robot.report.left_out == [] and robot.actuators == {}
    assert model.joint_limit_upper.numpy()[0] == 1e10 and model.shape_contact_pair_count == 0
    assert robot.sites == {"s": (0, (1, 2, 3, 0, 0, 0, 1))}
    tip = model.select("s")
    assert tip.get(model, "shape_transform").tolist() == [[1, 2, 3, 0, 0, 0, 1]]
    assert tip.sites.tolist() == tip.shapes.tolist()
    assert robot.timestep is None and robot.report.read["tendon"] == 1


def test_a_site_from_a_point_to_another_is_in_their_middle():
    inside = '<body name="b">' + GEOM + '<site name="s" fromto="0 0 0 1 0 0" size=".01"/></body>'
    model, _ = loaded(mjcf(inside))
    x, y, z, *turn = model.select("s").get(model, "shape_transform")[0]
    assert_allclose([x, y, z], [0.5, 0.0, 0.0], atol=1e-7)
    # The z axis goes from the second point to the first, as in MuJoCo.
    assert_allclose(np.abs(turn), [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)], atol=1e-6)


def test_the_gravity_and_the_step_of_a_file():
    """A builder that has nothing in it yet takes the gravity of the file."""
    text = mjcf(ARM.format(joint=""), '<option gravity="0 1 0" timestep="0.003"/>')
    model, robot = loaded(text)
    assert model.gravity.numpy()[0].tolist() == [0, 1, 0]
    assert_allclose(robot.timestep, 0.003)
    off, _ = loaded(text.replace("/>", '><flag gravity="disable"/></option>', 1))
    assert off.gravity.numpy()[0].tolist() == [0, 0, 0]
    builder = novaphy.ModelBuilder()
    builder.gravity = (0, 0, -1)
    with pytest.warns(UserWarning, match="gravity: that of the builder stays"):
        builder.add_mjcf(text)
    assert builder.finalize().gravity.numpy()[0].tolist() == [0, 0, -1]


def test_keyframes_are_rows_of_joint_q():
    inside = (
        '<body pos="1 0 0"><freejoint/>'
        + GEOM
        + '<body><joint type="ball"/>'
        + GEOM
        + "</body></body>"
    )
    inside += '<body mocap="true" pos="0 3 0"/><body><joint ref="90"/>' + GEOM + "</body>"
    after = '<keyframe><key name="home" time="2" qpos="1 2 3 0 2 0 0 1 0 0 0 .5"/></keyframe>'
    builder = novaphy.ModelBuilder()
    builder.add_mjcf(mjcf(inside))
    robot = builder.add_mjcf(mjcf(inside, after=after), xform=(0, 0, 1, 0, 0, 0, 1))
    key = robot.keyframes["home"]
    assert (key.time, key.coord, len(key.joint_q)) == (2, 19, 19)
    assert key.joint_q[:11] == [1, 2, 4, 1, 0, 0, 0, 0, 0, 0, 1]
    assert key.joint_q[11:] == [0, 3, 1, 0, 0, 0, 1, 0.5]
    assert_allclose(builder.joint_q[-1], np.pi / 2)  # at its ref
    with pytest.raises(ValueError, match="qpos: expected as many numbers"):
        loaded(mjcf(inside, after=after.replace(".5", "")))


def test_a_control_moves_what_its_actuator_says():
    text = actuated('<position joint="j" kp="50" kv="20"/><motor joint="k" gear="2"/>',
                    before='<option gravity="0 0 0"/>')  # fmt: skip
    model, robot = loaded(text)
    assert robot.actuators == {"j_position": 0, "k_motor": 1}
    control, state, after = model.control(), model.state(), model.state()
    control.ctrl.assign([0.02, 0])
    solver = novaphy.solvers.SolverFeatherstone(model)
    for _ in range(1500):
        solver.step(state, after, control, None, 1e-2)
        state, after = after, state
    assert_allclose(state.joint_q.numpy()[0], 0.02, atol=1e-5)


@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::RuntimeWarning")
def test_mutated_texts_are_read_or_refused():
    from test_urdf import mutated

    draw = random.Random(5)
    texts = [*FEATURES.values()]
    for k in range(400):
        builder = novaphy.ModelBuilder()
        how = ("error", "warn")[k % 2]
        try:
            builder.add_mjcf(mutated(draw, texts[k % len(texts)]), unsupported=how)
            builder.finalize()
        except (ValueError, NotImplementedError) as error:
            named = "<text>" in str(error) or "source: expected" in str(error)
            assert named or builder.body_count  # an error of finalize
        except OSError:  # its first letter is no <: a path
            assert builder.body_count == 0


def test_a_ball_joint_has_a_cone():
    text = mjcf('<body><joint type="ball" range="0 50"/>' + GEOM + "</body>")
    model, _ = loaded(text)
    assert_allclose(model.joint_limit_upper.numpy(), [np.radians(50), 1e10, 1e10], rtol=1e-6)
    model, _ = loaded(text.replace('range="0 50"', 'range="0 50" limited="false"'))
    assert (model.joint_limit_upper.numpy() == 1e10).all()
    for wrong in ("-50 0", "10 50", "0 -50"):
        with pytest.raises(ValueError, match="expected 0 and the largest angle of a ball joint"):
            loaded(text.replace("0 50", wrong))
    with pytest.warns(UserWarning, match="its range is 0.001 rad"):
        model, robot = loaded(text.replace('range="0 50"', 'limited="true"'))
    assert_allclose(model.joint_limit_upper.numpy()[0], 1e-3, rtol=1e-6)
    assert len(robot.report.mended) == 1
    servo = '<actuator><position joint="j" inheritrange="1"/></actuator>'
    with pytest.raises(ValueError, match="inheritrange: expected a hinge or slide with limits"):
        loaded(
            text.replace("<joint ", '<joint name="j" ').replace("</mujoco>", servo + "</mujoco>")
        )
