"""What MJCF files say in many ways: numbers against MuJoCo's, and against closed forms."""

from __future__ import annotations

import importlib.util
import warnings
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
                   'zaxis="1 1 0"><joint axis="0 1 0" pos=".1 0 0"/>' + GEOM + "</frame></body></frame>"),
    "copies": mjcf('<replicate count="12" offset="1 0 .1" euler="0 0 20" sep="-"><body name="a" '
                   'pos="0 .3 0"><joint name="j"/>' + GEOM + '<site name="s"/></body></replicate>'),
    "ref": mjcf('<body pos="0 0 1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1" '
                'ref="1.25"/><joint axis="0 1 0" ref="20" pos="0 0 .2"/>' + GEOM + "</body>"),
    "hinges in several places": mjcf(
        '<body><joint axis="0 1 0" pos=".1 0 0" damping="1"/><joint axis="1 0 0" pos="0 .2 0"/>'
        '<joint type="slide" axis="0 0 1" armature=".1"/><joint axis="0 1 0"/>' + GEOM + "</body>"),
    "slide and ball": mjcf('<body><joint type="slide" axis="1 0 0"/><joint type="ball" pos=".1 0 0" '
                           'damping=".3" armature=".2"/>' + GEOM + "</body>"),
    "free joint with damping": mjcf('<body pos="1 2 3"><joint type="free" damping=".3" armature=".2"/>'
                                    + GEOM + '<geom size=".1" pos="1 0 0"/></body>'),
    "fixed point mass": mjcf('<body><joint/>' + GEOM + '<body pos="0 0 1"><inertial pos="0 0 .1" '
                             'mass="2" diaginertia="0 0 0"/></body></body>'),
    "groups": mjcf('<body><joint/>' + GEOM + '<geom size=".4" group="2"/></body>',
                   '<compiler inertiagrouprange="0 1"/>'),
    "total mass": mjcf(ARM.format(joint=""), '<compiler settotalmass="14"/>'),
    "bounds": mjcf('<body><joint/><geom size=".01"/><body><joint/>' + GEOM + "</body></body>",
                   '<compiler boundmass="2" boundinertia=".3"/>'),
    "balance": mjcf('<body><joint/><inertial pos="1 0 0" euler="0 9 0" mass="2" diaginertia="1 2 9"/>'
                    "</body>", '<compiler balanceinertia="true"/>'),
    "masses of geoms": mjcf('<body><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>' + GEOM
                            + '<geom type="capsule" size=".1 .2" mass="3" pos="1 0 0"/><geom type='
                            '"ellipsoid" size=".1 .2 .3"/><geom type="cylinder" size=".1 .2"/></body>',
                            '<compiler inertiafromgeom="true"/>'),
    "legacy mesh": meshes(""),
    "exact mesh": meshes('inertia="exact"'),
    "convex mesh": meshes('inertia="convex"'),
    "shell mesh": meshes('inertia="shell"', 'mass="2"'),
    "mirrored mesh": meshes('inertia="exact" scale="-2 1 .5" refpos=".1 0 .2" refquat="1 .2 0 .4"'),
    "points": mjcf('<body><freejoint/><geom type="mesh" mesh="m"/></body>', '<asset><mesh name="m" '
                   'vertex="0 0 0 1 0 0 0 1 0 0 0 1 .2 .2 .2" inertia="exact"/></asset>'),
    "motor": actuated('<motor joint="j" gear="3" ctrlrange="-.2 .5"/>', 'stiffness="2" springref="20"'),
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
        + "</body></body>", after='<actuator><position joint="j" kp="3" dampratio="1"/></actuator>'),
    "damping ratio": actuated('<position joint="j" kp="20" dampratio="1"/><position joint="k" kp="5" '
                              'dampratio=".7" gear="3"/>', 'ref="10" armature=".1"'),
    "inherited range": actuated('<position joint="j" kp="20" inheritrange=".8"/>'),
    "classes of actuators": actuated(
        '<position class="x" joint="j"/><velocity class="y" joint="k"/>',
        before='<default><position kp="10" kv="2"/><velocity kv="3"/><default class="x"><motor '
        'ctrlrange="-.1 .2"/><position/></default><default class="y"><motor/></default></default>'),
    "flags": actuated('<motor joint="j" ctrlrange="-.1 .1"/>', 'damping="3" stiffness="4"',
                      '<option gravity="1 2 3"><flag clampctrl="disable" damper="disable"/></option>'),
    "pairs": mjcf(
        '<geom name="w" size=".1"/><body mocap="true"><geom name="m" size=".1"/><body><joint/>'
        '<geom name="n" size=".1"/></body></body><body mocap="true"><geom name="o" size=".1"/></body>'
        '<body name="a"><joint/><geom name="a" size=".1" contype="0" conaffinity="0"/><body name="b">'
        '<joint/><geom name="b" size=".1"/></body></body><body><joint/><joint axis="1 0 0" pos="1 0 0"/>'
        '<geom name="c" size=".1"/><body><joint/><geom name="d" size=".1"/></body></body>',
        after='<contact><pair geom1="a" geom2="b"/><pair geom1="c" geom2="d"/><exclude body1="b" '
        'body2="world"/></contact>'),
    "parents meet": mjcf('<geom size=".1"/>' + ARM.format(joint=""),
                         '<option><flag filterparent="disable"/></option>'),
    "plane of a body": mjcf('<body pos="0 0 -1"><geom name="f" type="plane" size="1 1 1"/></body>'
                            + ARM.format(joint="")),
}  # fmt: skip


@pytest.mark.parametrize("name", FEATURES)
def test_numbers_are_those_of_mujoco(name):
    """At random states: masses, poses, mass matrix, inverse dynamics, forces, pairs of geoms."""
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    spec = importlib.util.spec_from_file_location("robot_files", BENCH)
    bench = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bench)
    exact = mujoco.MjModel.from_xml_string(FEATURES[name])
    assert exact.nv > 0
    differences = bench.compare(exact, *loaded(FEATURES[name]))
    assert len(differences) >= 6 and differences.pop("pairs") == 0
    assert max(differences.values()) < 1e-5, differences
