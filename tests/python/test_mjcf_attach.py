"""Models that MJCF files attach, and parts that they describe and no solver has."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF")

CHILD = """<mujoco model="kid"><compiler angle="radian"/><option gravity="0 0 1" density="3"/>
<default><joint damping="2"/><geom friction="0.3"/><default class="big"><geom size=".2"/></default>
</default><worldbody><geom name="wall" size=".3" pos="5 0 0"/><site name="mark" pos="0 1 0"/>
<body name="a" pos="1 0 0" euler="0 0 1"><joint name="j" axis="0 1 0" range="-1 1"/>
<geom name="g" size=".1"/><site name="s" pos="0 0 1"/>
<body name="b" pos="0 0 2"><joint name="k" axis="1 0 0"/>
<geom class="big" pos=".1 0 0"/></body></body>
<body name="c" pos="0 3 0"><joint name="l"/><geom name="h" size=".1"/></body></worldbody>
<contact><exclude body1="b" body2="c"/><pair geom1="g" geom2="h"/></contact>
<actuator><position name="m" joint="k" kp="3" dampratio="1"/><motor joint="l"/>
<motor site="s" gear="0 0 1"/></actuator></mujoco>"""
MAIN = """<mujoco><asset><model name="kid" file="{file}"/></asset><worldbody>
<body name="base" pos="0 0 3"><joint name="root" range="-90 90"/><geom size=".1"/>{inside}</body>
{beside}</worldbody><actuator><motor name="first" joint="root"/>{after}</actuator></mujoco>"""
INSIDE = {
    "body": '<attach model="kid" body="a" prefix="p_"/>',
    "frame": '<frame pos="0 1 0" euler="90 0 0"><attach model="kid" body="a" prefix="p_"/></frame>',
    "inner": '<attach model="kid" body="b" prefix="p_"/>',
    "world": '<attach model="kid" prefix="p_"/>',
    "twice": '<attach model="kid" body="a" prefix="p_"/><attach model="kid" body="a" prefix="q_"/>',
    "copies": '<replicate count="2" offset="0 0 1"><attach model="kid" body="c" prefix="p_"/>'
    "</replicate>",
}


@pytest.fixture
def write(tmp_path):
    def made(inside="", beside="", after="", file="kid.xml", child=CHILD, name="main.xml"):
        (tmp_path / "kid.xml").write_text(child)
        main = tmp_path / name
        main.write_text(MAIN.format(file=file, inside=inside, beside=beside, after=after))
        return str(main)

    return made


def loaded(path, **options):
    builder = novaphy.ModelBuilder()
    robot = builder.add_mjcf(path, **options)
    return builder.finalize(), robot


def test_a_body_and_what_hangs_on_it_become_a_part(write):
    model, robot = loaded(write(INSIDE["frame"]))
    assert model.body_label == ["base", "p_a", "p_b"]
    assert list(robot.joints) == ["p_j", "p_k", "root"]
    assert sorted(robot.actuators, key=robot.actuators.get) == ["first", "p_m", "p_s_motor"]
    assert robot.sites["p_s"][0] == robot.links["p_a"]
    assert_allclose(model.body_q.numpy()[1, :3], [1, 1, 3], atol=1e-6)
    dofs = robot.joint_dofs
    assert model.joint_damping.numpy()[dofs["p_j"]] == 2
    assert model.joint_damping.numpy()[dofs["root"]] == 0
    assert model.joint_limit_upper.numpy()[dofs["p_j"]] == 1.0  # radian there, degrees here
    assert_allclose(model.joint_limit_upper.numpy()[dofs["root"]], np.pi / 2, rtol=1e-6)
    assert model.gravity.numpy()[0].tolist() == [0, 0, np.float32(-9.81)]


@pytest.mark.parametrize("name", INSIDE)
def test_what_is_attached_is_what_mujoco_compiles(write, name):
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    path = write(INSIDE[name], beside=INSIDE[name].replace('"p_', '"z_').replace('"q_', '"y_'))
    exact = mujoco.MjModel.from_xml_path(path)
    model, robot = loaded(path)
    names = [exact.body(k).name for k in range(1, exact.nbody)]
    rows = [robot.links[n] for n in names]
    assert len(robot.links) == len(names)
    assert set(robot.joints) == {exact.joint(k).name for k in range(exact.njnt)}
    assert set(robot.sites) == {exact.site(k).name for k in range(exact.nsite)}
    data = mujoco.MjData(exact)
    mujoco.mj_forward(exact, data)
    assert_allclose(model.body_q.numpy()[rows, :3], data.xpos[1:], atol=1e-5)
    assert_allclose(model.body_mass.numpy()[rows], exact.body_mass[1:], rtol=1e-5)
    assert_allclose(
        model.joint_limit_upper.numpy()[[robot.joint_dofs[exact.joint(k).name]
                                         for k in range(exact.njnt) if exact.jnt_limited[k]]],
        exact.jnt_range[exact.jnt_limited.astype(bool), 1], rtol=1e-6,
    )  # fmt: skip
    servo = [k for k in range(exact.nu) if exact.actuator(k).name.endswith(("_m", "_m0", "_m1"))]
    for k in servo:
        row = robot.actuators[exact.actuator(k).name]
        assert_allclose(model.actuator_bias.numpy()[row], exact.actuator_biasprm[k, :3], rtol=1e-4)
    assert model.actuator_count == exact.nu


def test_models_attach_models_and_cycles_are_refused(write, tmp_path):
    leaf = '<asset><model name="leaf" file="leaf.xml"/></asset><worldbody>'
    inner = CHILD.replace("<worldbody>", leaf).replace(
        '<geom class="big"', '<attach model="leaf" body="d" prefix="in_"/><geom class="big"'
    )
    (tmp_path / "leaf.xml").write_text(
        '<mujoco><worldbody><body name="d"><joint name="e"/><geom size=".1"/></body></worldbody>'
        '<actuator><motor name="x" joint="e"/></actuator></mujoco>'
    )
    _, robot = loaded(write(INSIDE["body"], child=inner))
    assert "p_in_e" in robot.joints and "p_in_x" in robot.actuators
    (tmp_path / "leaf.xml").write_text(
        '<mujoco><asset><model name="kid" file="kid.xml"/></asset><worldbody><body name="d">'
        '<geom size=".1"/><attach model="kid" body="a" prefix="r_"/></body></worldbody></mujoco>'
    )
    with pytest.raises(ValueError, match="expected no model inside of itself"):
        loaded(write(INSIDE["body"], child=inner))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"inside": '<attach model="kid" body="z" prefix="p_"/>'}, 'there is no body "z" in'),
        ({"inside": '<attach model="dad" body="a" prefix="p_"/>'}, 'there is no model "dad"'),
        ({"inside": '<attach model="kid" body="a"/>'}, "prefix: missing"),
        ({"inside": 2 * INSIDE["body"]}, 'expected different names, got "p_a" twice'),
        ({"inside": INSIDE["body"], "file": "../../kid.xml"}, "there is no file"),
        ({"inside": INSIDE["body"], "child": "<mujoco/"}, "expected XML"),
        ({"inside": INSIDE["body"], "child": CHILD.replace("k", "k&")}, "expected XML"),
        ({"inside": INSIDE["body"], "after": '<motor joint="j"/>'}, 'there is no joint "j"'),
        (
            {"inside": INSIDE["body"].replace("/>", ' frame="f"/>')},
            "attributes model, body and prefix, got frame",
        ),
        (
            {"inside": INSIDE["body"].replace("/>", '><geom size="1"/></attach>')},
            "no element in <attach>",
        ),
        (
            {"inside": INSIDE["body"], "after": '<motor joint="root" site="p_s"/>'},
            "one transmission, got joint and site",
        ),
    ],
)
def test_what_cannot_be_attached_is_refused_with_its_line(write, arguments, message):
    builder = novaphy.ModelBuilder()
    with pytest.raises((ValueError, OSError), match=message):
        builder.add_mjcf(write(**arguments))
    assert builder.body_count == 0


def test_a_model_above_the_folder_is_refused(write, tmp_path):
    (tmp_path / "low").mkdir()
    path = write(INSIDE["body"], file="../kid.xml", name="low/main.xml")
    with pytest.raises(ValueError, match="in the folder of the file, below it or beside it"):
        loaded(path)
    loaded(path, package_dirs=[tmp_path.parent])


PARTS = """<mujoco><asset><hfield name="hills" size="2 2 .5 .1" nrow="2" ncol="3"
elevation="0 1 2 3 4 5"/></asset><default><equality solref=".01 1"/><tendon damping="3"/></default>
<worldbody>{geom}<body name="a"><joint name="j"/><geom size=".1"/><site name="s"/></body>
<body name="b"><joint name="k"/><geom size=".1"/><site name="t"/></body></worldbody>
<equality><connect name="pin" body1="a" body2="b" anchor="1 2 3"/>
<weld body1="a" body2="b" active="false"/><joint joint1="j" joint2="k" polycoef="0 2 0 0 0"/>
</equality><tendon><fixed name="rope"><joint joint="j" coef="2"/><joint joint="k" coef="-1"/>
</fixed><spatial damping="0"><site site="s"/><site site="t"/></spatial></tendon></mujoco>"""


def test_parts_without_a_solver_are_read_and_refused_by_finalize():
    text = PARTS.format(geom='<geom type="hfield" hfield="hills"/>')
    builder = novaphy.ModelBuilder()
    robot = builder.add_mjcf(text)
    pin, weld, joint = robot.equalities
    assert (pin.kind, pin.name, pin.names) == ("connect", "pin", {"body1": "a", "body2": "b"})
    assert pin.numbers == {"anchor": [1, 2, 3], "solref": [0.01, 1]}
    assert weld.names["active"] == "false" and joint.numbers["polycoef"][1] == 2
    rope, string = robot.tendons
    assert rope.kind == "fixed" and rope.numbers == {"damping": [3]}
    assert [(p.names["joint"], p.numbers["coef"]) for p in rope.parts] == [("j", [2]), ("k", [-1])]
    assert string.numbers == {"damping": [0]} and string.parts[1].names == {"site": "t"}
    (hills,) = robot.height_fields
    assert hills.numbers["elevation"] == [0, 1, 2, 3, 4, 5] and hills.numbers["nrow"] == [2]
    with pytest.raises(
        NotImplementedError,
        match=r'finalize: <text>:5: <connect name="pin">: an eq'
        r'uality of the kind connect \(unsupported="warn" leaves it out\) \(and 3',
    ):
        builder.finalize()  # fmt: skip
    worlds = novaphy.ModelBuilder()
    with pytest.raises(NotImplementedError, match="an equality of the kind connect"):
        worlds.replicate(builder, 2)
        worlds.finalize()


def test_parts_without_a_solver_are_left_out_and_listed():
    text = PARTS.format(geom='<geom type="hfield" hfield="hills"/>')
    model, robot = loaded(text, unsupported="warn")
    assert model.joint_count == 2 and len(robot.equalities) == 3 and len(robot.height_fields) == 1
    assert [n.element for n in robot.report.left_out] == [
        '<connect name="pin">', "<joint>", '<fixed name="rope">', "<geom>",
    ]  # fmt: skip


def test_height_fields_have_the_numbers_of_their_files(tmp_path):
    values = np.arange(6, dtype=np.float32)
    (tmp_path / "hills.bin").write_bytes(np.int32([2, 3]).tobytes() + values.tobytes())
    main = tmp_path / "main.xml"
    text = PARTS.format(geom="").replace('nrow="2" ncol="3"\nelevation="0 1 2 3 4 5"',
                                         'file="{}"')  # fmt: skip
    main.write_text(text.format("hills.bin"))
    (hills,) = novaphy.ModelBuilder().add_mjcf(str(main)).height_fields
    assert hills.numbers["elevation"] == values.tolist() and hills.numbers["ncol"] == [3]
    (tmp_path / "short.bin").write_bytes(np.int32([2, 3]).tobytes())
    for name, message in (("short.bin", "a whole height field"), ("none.bin", "none.bin")):
        main.write_text(text.format(name))
        with pytest.raises((ValueError, OSError), match=message):
            novaphy.ModelBuilder().add_mjcf(str(main))


def test_of_models_with_one_name_the_first_counts(write, tmp_path):
    """As in MuJoCo; the report names the other one."""
    path = write(INSIDE["body"])
    (tmp_path / "other.xml").write_text(CHILD.replace('size=".1"', 'size=".7"'))
    text = (tmp_path / "main.xml").read_text()
    other = '<model name="kid" file="other.xml"/></asset>'
    (tmp_path / "main.xml").write_text(text.replace("</asset>", other))
    with pytest.warns(UserWarning, match="another model of this name stands before it"):
        model, robot = loaded(path)[:2]
    assert not (model.shape_scale.numpy() > 0.65).any()
    assert '<model name="kid">' in [note.element for note in robot.report.ignored]
