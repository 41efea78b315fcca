"""Ranges that actuators of MJCF files inherit from their joints: those of MuJoCo 4.0."""

from __future__ import annotations

import numpy as np
import pytest
from test_mjcf_features import GEOM, loaded, mjcf

import novaphy
from novaphy.testing import assert_allclose

pytestmark = pytest.mark.skipif(
    not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it"
)


LIMITED = '<joint name="j" axis="0 1 0" range="-90 90"/>'


@pytest.mark.parametrize(
    ("actuator", "default", "joint", "control", "activation"),
    [
        ('position inheritrange=".5"', "", LIMITED, 0.25, None),
        ("position", 'position inheritrange="1"', LIMITED, 0.5, None),
        ("general", 'position inheritrange="1"', LIMITED, 0.5, None),
        ("motor", 'position inheritrange="1"', LIMITED, None, None),
        ('position inheritrange="1"', 'position ctrlrange="0 1"', LIMITED, 0.5, None),
        ('position inheritrange="1" ctrllimited="false"', "", LIMITED, None, None),
        ('intvelocity inheritrange="1"', "", LIMITED, None, 0.5),
        ('position inheritrange="-1"', "", LIMITED, None, None),
    ],
)
def test_ranges_that_actuators_inherit_are_those_of_mujoco(
    actuator, default, joint, control, activation
):
    """Half turns, of MuJoCo 4.0; None: no range."""
    before = f"<default><{default}/></default>" if default else ""
    text = mjcf(
        f"<body>{joint}{GEOM}</body>", before, f'<actuator><{actuator} joint="j"/></actuator>'
    )
    model, _ = loaded(text)
    for name, expected in (("ctrl", control), ("act", activation)):
        (got,) = getattr(model, f"actuator_{name}_range").numpy()
        end = 1e10 if expected is None else expected * np.pi
        assert_allclose(got, (-end, end), rtol=1e-6)


def test_an_own_range_replaces_an_inherited_one():
    before = '<default><position inheritrange="1"/></default>'
    servo = '<actuator><position joint="j" ctrlrange="0 1"/></actuator>'
    text = mjcf(f"<body>{LIMITED}{GEOM}</body>", before, servo)
    assert loaded(text)[0].actuator_ctrl_range.numpy().tolist() == [[0.0, 1.0]]


@pytest.mark.parametrize(
    ("actuator", "joint", "message"),
    [
        ('position inheritrange="1"', '<joint name="j"/>', "expected a hinge or slide with limits"),
        (
            'position inheritrange="1" ctrlrange="0 1"',
            LIMITED,
            "inheritrange, ctrlrange: expected one of them",
        ),
        (
            'intvelocity inheritrange="1" actrange="0 1"',
            LIMITED,
            "inheritrange, actrange: expected one of them",
        ),
        ('motor inheritrange="1"', LIMITED, "expected <position> or <intvelocity>"),
        ('velocity inheritrange="1"', LIMITED, "expected <position> or <intvelocity>"),
    ],
)
def test_an_inherited_range_that_mujoco_refuses(actuator, joint, message):
    text = mjcf(f"<body>{joint}{GEOM}</body>", "", f'<actuator><{actuator} joint="j"/></actuator>')
    with pytest.raises(ValueError, match=message):
        loaded(text)
