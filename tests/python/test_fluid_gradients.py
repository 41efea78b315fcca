"""Gradients and tangents of the forces of a fluid against differences, and captures of steps."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")
DT = 0.01
STATES = ("joint_q", "joint_qd")
NAMES = (
    *STATES, "body_com", "body_mass", "fluid_density", "fluid_viscosity", "fluid_wind",
    "body_fluid_box",
)  # fmt: skip


def swimmer(**fluid) -> novaphy.ModelBuilder:
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.set_fluid(**fluid)
    draw = np.random.default_rng(5)
    links = []
    for _ in range(3):
        sides = draw.uniform(0.1, 0.4, 3)
        axes = np.linalg.qr(draw.normal(size=(3, 3)))[0]
        inertia = axes @ np.diag(((sides**2).sum() - sides**2) / 12) @ axes.T
        links.append(builder.add_link(mass=1.0, inertia=inertia, com=0.1 * draw.normal(size=3)))
    away = ((0.2, 0.1, 0.0), (0.0, 0.0, 0.0, 1.0))
    joints = [
        builder.add_joint_free(links[0]),
        builder.add_joint_revolute(links[0], links[1], axis=(0, 1, 0), parent_xform=away),
        builder.add_joint_ball(links[1], links[2], parent_xform=away),
    ]
    builder.add_articulation(joints)
    return builder


def model_of(**fluid) -> novaphy.Model:
    """Two worlds with two swimmers each."""
    world, every = novaphy.ModelBuilder(gravity=0.0), novaphy.ModelBuilder(gravity=0.0)
    for _ in range(2):
        world.add_builder(swimmer(**fluid))
    every.replicate(world, 2)
    return every.finalize()


def start_of(model) -> dict[str, np.ndarray]:
    draw = np.random.default_rng(3)
    q = draw.normal(size=(4, 12))
    for at in (3, 8):
        q[:, at : at + 4] /= np.linalg.norm(q[:, at : at + 4], axis=1, keepdims=True)
    rates = draw.normal(size=model.joint_dof_count)
    return {"joint_q": np.float32(q.ravel()), "joint_qd": np.float32(rates)}


def loss_of(model, start, names=()):
    from novaphy import diff, nova

    state, after = model.state(), model.state()
    for name, values in start.items():
        getattr(state, name).assign(values)
    owners = {name: state if name in STATES else model for name in names}
    for name, owner in owners.items():
        getattr(owner, name).requires_grad = True
    weights = np.random.default_rng(6).normal(size=model.joint_dof_count)
    tape = nova.Tape()
    with tape:
        novaphy.solvers.DiffFeatherstoneSolver(model).step(state, after, None, None, DT)
        loss = nova.sum(diff.state_joint_qd_tensor(after) * nova.tensor(np.float32(weights)))
    return tape, loss, owners


@pytest.mark.parametrize("fluid", [
    {"density": 300.0, "viscosity": 2.0, "wind": (0.5, -1.0, 0.3)}, {"density": 300.0},
    {"viscosity": 9.0, "wind": (0.5, -1.0, 0.3)},
])  # fmt: skip
def test_gradients_are_differences_and_tangents_are_gradients(fluid):
    from novaphy import diff, nova

    model = model_of(**fluid)
    start, draw = start_of(model), np.random.default_rng(4)
    tape, loss, owners = loss_of(model, start, NAMES)
    ways, tangents = {}, {}
    with tape:
        for name, owner in owners.items():
            kind = "state" if name in STATES else "model"
            ways[name] = np.float32(draw.normal(size=getattr(owner, name).numpy().shape))
            tensor = getattr(diff, f"{kind}_{name}_tensor")(owner)
            tangents[name] = tape.jvp([loss], [tensor], [nova.tensor(ways[name])])[0].item()
        tape.backward(loss)
    gradients = {n: getattr(o, n).grad.numpy().astype(float) for n, o in owners.items()}
    for name, way in ways.items():
        along, size = (gradients[name] * way).sum(), np.abs(gradients[name] * way).sum()
        assert_allclose(tangents[name], along, rtol=0, atol=1e-4 * size, err_msg=name)
        assert size > 1e-2 or not fluid.get("density") or name == "body_mass", name
        if name.startswith("fluid_") and name[6:] not in fluid:
            continue  # a density below 0 is refused
        base = start[name] if name in STATES else getattr(model, name).numpy().copy()
        step, ends = 2e-3 * max(0.5, np.abs(base).max()), []
        for sign in (1, -1):
            moved = np.float32(base + sign * step * way)
            if name in STATES:
                ends.append(loss_of(model, {**start, name: moved})[1].item())
                continue
            getattr(model, name).assign(moved)
            ends.append(loss_of(model, start)[1].item())
            getattr(model, name).assign(base)
        difference = (ends[0] - ends[1]) / (2 * step)
        assert_allclose(along, difference, rtol=0, atol=3e-3 * size, err_msg=name)


def test_a_fluid_that_is_not_there_has_a_gradient_by_its_density():
    slopes, ends = [], []
    for density in (0.0, 1.0):
        model = model_of(density=density)
        tape, loss, _ = loss_of(model, start_of(model), ("fluid_density",))
        with tape:
            tape.backward(loss)
        slopes.append(model.fluid_density.grad.numpy())
        ends.append(loss.item())
    # The step is linear in the density.
    assert_allclose(slopes[0], slopes[1], rtol=1e-5)
    assert_allclose(slopes[0].sum(), ends[1] - ends[0], rtol=1e-3)


def replayed(model, densities, capturing: bool) -> np.ndarray:
    """The rates after a rollout for each density of the fluid, which a capture replays or not."""
    from novaphy import diff, nova

    solver, trajectory = novaphy.solvers.DiffFeatherstoneSolver(model), diff.Trajectory(model, 3)
    for name, values in start_of(model).items():
        getattr(trajectory[0], name).assign(values)

    def rollout() -> None:
        solver.rollout(trajectory, None, None, DT)

    if capturing:
        with nova.ScopedCapture() as capture:
            rollout()
        rollout = capture.graph.launch
    rates = []
    for density in densities:
        model.fluid_density.fill_(density)
        rollout()
        rates.append(trajectory[3].joint_qd.numpy())
    return np.array(rates)


def test_a_captured_rollout_replays_its_bits_and_reads_the_fluid_anew():
    fluid = {"density": 200.0, "viscosity": 1.0}
    now, later = (replayed(model_of(**fluid), (200.0, 80.0), way) for way in (False, True))
    assert (now == later).all() and (now[0] != now[1]).any()
    # A capture without a fluid has no launch for one.
    with pytest.raises(novaphy.Error, match="modified after the capture"):
        replayed(model_of(), (50.0,), True)
