"""The energy of swinging mechanisms: bounded, in proportion to the step, and as in MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import novaphy

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
GRAVITY = 9.81
ARM_INERTIA = np.diag([0.0025, 0.0208, 0.0208])


def chain(q: list[float], qd: list[float]) -> novaphy.ModelBuilder:
    """Rods of 1 kg and 0.5 m on hinges about +Y, the first one's at the origin."""
    builder = novaphy.ModelBuilder(gravity=-GRAVITY)
    joints = []
    for k in range(len(q)):
        link = builder.add_link(mass=1.0, inertia=ARM_INERTIA)
        anchor = ((0.25, 0.0, 0.0) if k else (0.0, 0.0, 0.0), UPRIGHT)
        joints.append(
            builder.add_joint_revolute(
                link - 1,
                link,
                axis=(0.0, 1.0, 0.0),
                parent_xform=anchor,
                child_xform=((-0.25, 0.0, 0.0), UPRIGHT),
            )
        )
    builder.add_articulation(joints)
    builder.joint_q, builder.joint_qd = q, qd
    return builder


def run(
    builder: novaphy.ModelBuilder, dt: float, steps: int, every: int = 1
) -> dict[str, np.ndarray]:
    """Coordinates, rates and energies (J) at the start and behind every so many steps."""
    model = builder.finalize()
    solver = novaphy.solvers.SolverFeatherstone(model)  # its default damps nothing
    state, after = model.state(), model.state()
    rows = [[], [], []]

    def note() -> None:
        rows[0].append(state.joint_q.numpy().astype(float))
        rows[1].append(state.joint_qd.numpy().astype(float))
        rows[2].append(np.asarray(novaphy.eval_energy(model, state), float)[0].sum())

    note()
    for step in range(1, steps + 1):
        solver.step(state, after, None, None, dt)
        state, after = after, state
        if step % every == 0:
            note()
    return dict(zip(("q", "qd", "energy"), map(np.array, rows), strict=True))


MECHANISMS = {
    "pendulum": ([0.4], [1.0]),
    "arm": ([0.4, -0.6], [1.0, -0.5]),
    "three rods": ([0.3, 0.5, -0.4], [0.5, -1.0, 0.5]),
}


def test_a_pendulum_conserves_the_energy_that_its_scheme_does() -> None:
    """v' = v - dt V'(q) / I, q' = q + dt v' keeps I v^2 / 2 + V - dt v V' / 2 + O(dt^2)."""
    inertia = 0.0208 + 0.25**2
    plain, kept = [], []
    for dt in (1 / 60, 1 / 120):
        r = run(chain(*MECHANISMS["pendulum"]), dt, round(2 / dt))
        q, qd = r["q"][:, 0], r["qd"][:, 0]  # +Y turns +X to -Z
        energy = 0.5 * inertia * qd**2 - 0.25 * GRAVITY * np.sin(q)
        assert_allclose(np.diff(r["energy"]), np.diff(energy), atol=2e-6)
        shadow = energy + 0.5 * dt * qd * 0.25 * GRAVITY * np.cos(q)
        plain.append(np.abs(energy - energy[0]).max())
        kept.append(np.abs(shadow - shadow[0]).max())
    assert plain[0] / plain[1] == pytest.approx(2.0, abs=0.1)
    assert kept[0] / kept[1] == pytest.approx(4.0, abs=0.4)
    assert kept[1] < 0.05 * plain[1]


@pytest.mark.parametrize("name", MECHANISMS)
def test_the_error_of_the_energy_halves_with_the_step(name: str) -> None:
    errors = []
    for dt in (1 / 960, 1 / 1920):
        energy = run(chain(*MECHANISMS[name]), dt, round(0.6 / dt))["energy"]
        errors.append(np.abs(energy - energy[0]).max())
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.1)


def test_the_energy_of_a_pendulum_does_not_drift_over_a_hundred_thousand_steps() -> None:
    energy = run(chain(*MECHANISMS["pendulum"]), 1 / 960, 100_000, every=10)["energy"]
    parts = energy[1:].reshape(10, -1)
    waves = np.ptp(parts, axis=1)
    assert np.ptp(parts.mean(axis=1)) < 0.05 * waves[0]
    assert_allclose(waves, waves[0], rtol=0.01)


def test_the_drift_of_an_arm_over_a_hundred_thousand_steps_is_that_of_mujoco() -> None:
    """The scheme is not symplectic where the mass matrix changes: 6 mJ of a swing's 0.3 J in 104 s,
    half as much with half the step."""
    start, drifts = ([1.3, 0.1], [0.0, 0.0]), []
    for dt, steps in ((1 / 960, 100_000), (1 / 1920, 200_000)):
        ours, theirs = run(chain(*start), dt, steps, 10), in_mujoco(*start, dt, steps)
        ends = [np.mean(np.split(r["energy"][1:], 10)[9]) - r["energy"][0] for r in (ours, theirs)]
        assert ends[0] == pytest.approx(ends[1], abs=5e-5)
        drifts.append(ends[0])
    assert drifts[0] / drifts[1] == pytest.approx(2.0, abs=0.1)


def in_mujoco(q: list[float], qd: list[float], dt: float, steps: int) -> dict[str, np.ndarray]:
    mujoco = pytest.importorskip("mujoco", reason="the oracle of this test: pip install mujoco")
    body = ""
    for k in reversed(range(len(q))):
        body = (
            f'<body pos="{0.5 if k else 0.0} 0 0"><joint axis="0 1 0"/>'
            '<inertial pos="0.25 0 0" mass="1" diaginertia="0.0025 0.0208 0.0208"/>'
            f"{body}</body>"
        )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{dt!r}" gravity="0 0 {-GRAVITY}" integrator="Euler">'
        f'<flag energy="enable"/></option><worldbody>{body}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, qd
    rows = [[], [], []]
    for step in range(steps + 1):
        mujoco.mj_forward(model, data)
        for row, value in zip(rows, (data.qpos, data.qvel, data.energy.sum()), strict=True):
            row.append(np.array(value))
        if step < steps:
            mujoco.mj_step(model, data)
    return dict(zip(("q", "qd", "energy"), map(np.array, rows), strict=True))


@pytest.mark.parametrize("name", MECHANISMS)
def test_mechanisms_swing_as_in_mujoco(name: str) -> None:
    """Whose Euler scheme is the same: so are its errors."""
    dt, steps = 1 / 960, 576
    ours = run(chain(*MECHANISMS[name]), dt, steps)
    theirs = in_mujoco(*MECHANISMS[name], dt, steps)
    for key in ("q", "qd"):
        assert_allclose(ours[key], theirs[key], atol=1e-4 * np.abs(theirs[key]).max())
    of_scheme = theirs["energy"] - theirs["energy"][0]
    assert np.abs(of_scheme).max() > 1e-3
    assert_allclose(ours["energy"] - ours["energy"][0], of_scheme, atol=1e-4)
