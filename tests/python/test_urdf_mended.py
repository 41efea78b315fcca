"""What robots' makers write in URDF files: what is made of it, and that it is said."""

from __future__ import annotations

import numpy as np
import pytest
from test_urdf import INERTIAL, LIMIT, TETRAHEDRON, TWO, joint, link, loaded, robot

import novaphy
from novaphy.testing import assert_allclose

pytestmark = pytest.mark.skipif(
    not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it"
)


@pytest.mark.filterwarnings("ignore:.*moves no mass")
def test_a_mirrored_mesh_keeps_its_outside_outside(tmp_path):
    (tmp_path / "t.obj").write_text(TETRAHEDRON)
    mesh = '<geometry><mesh filename="t.obj" scale="-1 2 1"/></geometry>'
    (tmp_path / "r.urdf").write_text(robot(link("a", f"<collision>{mesh}</collision>")))
    model, _, _ = loaded(tmp_path / "r.urdf", ignore_inertial_definitions=True, floating=True)
    assert_allclose(model.body_com.numpy()[0], [-0.25, 0.5, 0.25], atol=1e-6)
    assert_allclose(model.body_mass.numpy()[0], 1000 * 2 / 6, rtol=1e-6)


def inertial(mass: float, moments: str) -> str:
    x, y, z = moments.split()
    rest = 'ixy="0" ixz="0" iyz="0"'
    return (f'<inertial><origin xyz="0 0 1"/><mass value="{mass}"/>'
            f'<inertia ixx="{x}" iyy="{y}" izz="{z}" {rest}/></inertial>')  # fmt: skip


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_what_has_no_inertia_gets_one():
    """A point on a fixed joint is a part of its parent: the same mass matrix, to rounding."""
    whole = robot(link("a"), link("b"), joint("j", "a", "b"), link("p", inertial(3, "0 0 0")),
                  joint("f", "b", "p", '<origin xyz="1 0 0"/>', "fixed"))  # fmt: skip
    near = robot(link("a"), link("b"), joint("j", "a", "b"), link("p", inertial(3, "1e-9 1e-9 "
                                                                                   "1e-9")),
                 joint("f", "b", "p", '<origin xyz="1 0 0"/>', "fixed"))  # fmt: skip
    masses = []
    for text in (whole, near):
        model, state, result = loaded(text)
        masses.append(novaphy.eval_mass_matrix(model, state).ravel()[0])
        assert result.report.mended == []
    assert_allclose(masses[0], masses[1], rtol=1e-6)
    assert masses[0] > 3  # 3 kg one meter from the axis
    # On a joint that moves: at least the inertia of a ball of water.
    model, _, result = loaded(
        robot(link("a"), link("b", inertial(4, "0 5 5")), joint("j", "a", "b"))
    )
    radius = (3 * 4 / (4000 * np.pi)) ** (1 / 3)
    got = np.linalg.eigvalsh(model.body_inertia.numpy()[1].astype(float))
    assert_allclose(got, [0.4 * 4 * radius**2, 5, 5], rtol=1e-5)
    assert [n.element for n in result.report.mended] == ['<link name="b">']
    with pytest.raises(ValueError, match="positive definite"):
        loaded(
            robot(link("a"), link("b", inertial(4, "0 0 0")), joint("j", "a", "b")),
            mend_inertias=False,
        )
    # A link that is fixed to the world keeps its mass.
    model, _, result = loaded(robot(link("a", inertial(0.1, "1 1 0"))))
    assert_allclose(model.body_mass.numpy(), [0.1], rtol=1e-6)
    assert [n.element for n in result.report.mended] == ['<link name="a">']
    # Nothing that has a mass.
    model, state, _ = loaded(robot(link("a"), link("b", ""), joint("j", "a", "b")))
    assert_allclose(novaphy.eval_mass_matrix(model, state).ravel()[0], 1e-3, rtol=1e-6)


BOX = '<geometry><box size="1 2 3"/></geometry>'
MENDED = {
    "no name": ("<robot>" + link("a") + "</robot>", "it had no name"),
    "two inertials": (robot(link("a", INERTIAL * 2)), "there is one before it, which counts"),
    "two axes": (robot(*TWO[:2], joint("j", "a", "b", '<axis xyz="0 0 1"/><axis xyz="1 0 0"/>')),
                 "there is one before it"),
    "two shapes": (robot(link("a", f"<visual>{BOX[:-11] + BOX[10:]}</visual>")),
                   "a shape before it"),
    "two geometries": (robot(link("a", f"<collision>{BOX * 2}</collision>")), "one before it"),
    "limit of a double": (robot(link("a"), link("b"), joint("j", "a", "b",
                          '<limit lower="-1" upper="1" effort=" 1e308 " velocity="+inf"/>',
                          "revolute")), "effort: a number this large is no limit"),
    "no inertia": (robot(link("a", '<inertial><mass value="1"/></inertial>')), "entries of its"),
    "no mass": (robot(link("a", "<inertial><inertia/></inertial>")), "without a mass"),
    "no limits": (robot(link("a"), link("b"), joint("j", "a", "b", kind="revolute")),
                  "it has no <limit>"),
    "half a limit": (robot(link("a"), link("b"), joint("j", "a", "b", '<limit lower="-1"/>',
                           "prismatic")), "effort, velocity: what is missing"),
    "size 0": (robot(link("a", f"<visual>{BOX.replace('2', '0')}</visual>")), "a shape of size 0"),
    "no geometry": (robot(link("a", "<collision/>")), "it has no shape"),
    "unknown material": (robot(link("a", f'<visual>{BOX}<material name="m"/></visual>')),
                         "there is no material of that name with a color"),
    "material twice": (robot('<material name="m"><color rgba="1 0 0 1"/></material>' * 2,
                             link("a")),
                       "one of that name, which counts"),
    "no rgba": (robot(link("a", f'<visual>{BOX}<material name="m"><color/></material></visual>')),
                "it has no rgba"),
}  # fmt: skip


@pytest.mark.parametrize("name", MENDED)
def test_what_makers_write_is_mended_and_said(name):
    text, message = MENDED[name]
    with pytest.warns(UserWarning, match="<text>:1: <.*" + message):
        _, _, result = loaded(text, unsupported="error")
    notes = [*result.report.mended, *result.report.ignored]
    assert notes[0].file == "<text>" and notes[0].line == 1
    assert message in str(result.report)


def test_what_is_mended_counts():
    red = '<material name="m"><color rgba="1 0 0 1"/></material>'
    text = robot(
        link("a", f'<visual>{BOX}<material name="m"/></visual>'),
        link("z", f"<visual>{BOX}{red}</visual>"),
        joint("j", "a", "z", kind="fixed"),
    )
    assert set(loaded(text)[2].shape_colors.values()) == {(1, 0, 0, 1)}  # from a later link
    capsule = '<collision><geometry><capsule radius="0.1" length="0.4"/></geometry></collision>'
    model, _, _ = loaded(robot(link("a", INERTIAL + capsule)) + "\0")
    assert model.shape_type.numpy()[0] == novaphy.GeoType.CAPSULE
    assert_allclose(model.shape_scale.numpy()[0, :2], [0.1, 0.2])
    swapped = joint("j", "a", "b", LIMIT.replace("-1", "7"), "revolute")
    with pytest.warns(UserWarning, match="the lower one is taken"):
        model, _, _ = loaded(robot(link("a"), link("b"), swapped))
    assert model.joint_limit_lower.numpy()[0] < model.joint_limit_upper.numpy()[0] == 7
