"""Differentiable rigid bodies: the reference die to the bit, gradients, paths, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import golden

import novaphy
from novaphy import diff, nova, solvers
from novaphy.testing import assert_same_bits

STEPS, DT, DAMPING = 768, 1 / 960, 0.05
OMEGA = np.float32([[1, 5, 2]])
SURFACE = {"ke": 1e4, "kd": 300.0, "kf": 500.0, "mu": 0.5}


@pytest.fixture(scope="module")
def reference():
    """A float32 tape of the operator's formulas, with the viscous law and with huber 0.1."""
    return golden("newton_dice")


def die_model(shape="box", start=(0, 0, 0.6, 0, 0, 0, 1), **cfg):
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(**SURFACE, **cfg)
    builder.add_ground_plane(cfg=surface)
    body = builder.add_body(xform=start, mass=4.0)
    if shape == "box":
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=surface)
    elif shape == "sphere":
        builder.add_shape_sphere(body, radius=0.1, cfg=surface)
    else:
        builder.add_shape_capsule(body, radius=0.06, half_height=0.15, cfg=surface)
    return builder.finalize(requires_grad=True)


def die_loss(q, qd):
    return diff.rigid_orientation_velocity_loss_generated(
        q,
        qd,
        0,
        (1, 0, 0),
        (0, 0, 1),
        (0, 1, 0),
        (0, 1, 0),
        axis_weight_b=0.25,
        target_height=0.1,
        height_weight=1.0,
        linear_velocity_weight=0.01,
        angular_velocity_weight=0.001,
    )


def assert_gradient(got, expected):
    assert np.abs(got - expected).max() <= 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize(("key", "smoothing"), [("op18", 0.0), ("opH", 0.1)])
def test_the_operator_has_the_references_bits_and_gradient(reference, key, smoothing):
    model = die_model()
    model.body_inertia = reference["model_body_inertia"]
    assert_same_bits(model.body_inv_inertia.numpy(), reference["model_body_inv_inertia"])
    omega = nova.tensor(OMEGA, requires_grad=True)
    q = nova.tensor(reference["model_body_q"], requires_grad=True)
    f = nova.zeros((1, 6))
    poses, twists = [], []
    with nova.Tape() as tape:
        now, twist = q, diff.body_twist_from_omega_generated(omega, 1, 0, 0)
        twists.append(twist.numpy()[0])
        for _ in range(STEPS):
            now, twist = diff.integrate_rigid_bodies_with_static_contacts_generated(
                model, now, twist, f, DAMPING, smoothing, DT, newton_spin=True
            )
            poses.append(now.numpy()[0])
            twists.append(twist.numpy()[0])
        loss = die_loss(now, twist)
        tape.backward(loss)
    assert_same_bits(np.array(poses), reference[f"{key}_body_q"][1:], "body_q")
    assert_same_bits(np.array(twists), reference[f"{key}_body_qd"], "body_qd")
    assert_same_bits(loss.numpy()[0], reference[f"{key}_loss"], "loss")
    assert_gradient(omega.grad.numpy(), reference[f"{key}_grad_omega"])
    assert_gradient(q.grad.numpy(), reference[f"{key}_grad_body_q0"])


class Die:
    """The die by the solver."""

    def __init__(self, reference, interval=1, worlds=1):
        builder = novaphy.ModelBuilder()
        one = novaphy.ModelBuilder()
        surface = novaphy.ShapeConfig(**SURFACE)
        one.add_ground_plane(cfg=surface)
        one.add_body(xform=(0, 0, 0.6, 0, 0, 0, 1), mass=4.0)
        one.add_shape_box(0, hx=0.1, hy=0.1, hz=0.1, cfg=surface)
        one.body_qd[0] = (1, 0, 0, 1, 5, 2)
        builder.replicate(one, worlds)
        self.model = builder.finalize(requires_grad=True)
        self.model.body_inertia = np.repeat(reference["model_body_inertia"], worlds, 0)
        config = solvers.DiffSolverConfig(
            enable_static_contacts=True, angular_damping=DAMPING, friction_law="huber"
        )
        self.solver = solvers.DiffSemiImplicitSolver(self.model, config)
        self.trajectory = diff.Trajectory(self.model, STEPS, checkpoint=interval)

    def forward(self, body=0):
        self.solver.rollout(self.trajectory, None, None, DT)
        end = self.trajectory[STEPS]
        return diff.rigid_orientation_velocity_loss_generated(
            diff.state_body_q_tensor(end),
            diff.state_body_qd_tensor(end),
            body,
            (1, 0, 0),
            (0, 0, 1),
            (0, 1, 0),
            (0, 1, 0),
            axis_weight_b=0.25,
            target_height=0.1,
            height_weight=1.0,
            linear_velocity_weight=0.01,
            angular_velocity_weight=0.001,
        )

    def gradient(self, body=0):
        with nova.Tape() as tape:
            loss = self.forward(body)
            tape.backward(loss)
        return loss.item(), self.trajectory[0].body_qd.grad.numpy()


@pytest.mark.parametrize("interval", [1, 28])
def test_a_rollout_has_the_bits_and_the_gradient_of_the_operator(reference, interval):
    die = Die(reference, interval)
    loss, gradient = die.gradient()
    omega = nova.tensor(OMEGA, requires_grad=True)
    with nova.Tape() as tape:
        now = nova.tensor(reference["model_body_q"])
        twist = diff.body_twist_from_omega_generated(omega, 1, 0, 0)
        for _ in range(STEPS):
            now, twist = diff.integrate_rigid_bodies_with_static_contacts_generated(
                die.model, now, twist, nova.zeros((1, 6)), DAMPING, 0.1, DT
            )
        expected = die_loss(now, twist)
        tape.backward(expected)
    assert loss == expected.item()
    assert_same_bits(die.trajectory[STEPS].body_q.numpy(), now.numpy(), "body_q")
    assert_gradient(gradient[:, 3:], omega.grad.numpy())


def test_a_captured_rollout_replays_the_same_bits(reference):
    die = Die(reference)
    expected = die.gradient()
    again = Die(reference)
    with nova.ScopedCapture() as capture:
        with nova.Tape() as tape:
            loss = again.forward()
            tape.backward(loss)
            seen = diff.state_body_qd_tensor(again.trajectory[0]).grad * 1.0
            tape.zero()
    for _ in range(2):
        capture.graph.launch()
        assert loss.item() == expected[0]
        assert_same_bits(seen.numpy(), expected[1])


def test_a_die_among_worlds_is_the_die_alone(reference):
    alone = Die(reference).gradient()
    worlds = Die(reference, worlds=3)
    loss, gradient = worlds.gradient(body=1)
    assert loss == alone[0]
    assert_same_bits(gradient[1:2], alone[1])
    assert not gradient[[0, 2]].any()


def test_the_solver_has_the_bits_of_the_forward_one_while_nothing_touches(reference):
    die = Die(reference)
    forward = solvers.SolverSemiImplicit(die.model, friction_law="huber")
    die.forward()
    state, after = die.model.state(), die.model.state()
    for _ in range(200):
        forward.step(state, after, None, None, DT)
        state, after = after, state
    assert_same_bits(state.body_q.numpy(), die.trajectory[200].body_q.numpy())
    assert_same_bits(state.body_qd.numpy(), die.trajectory[200].body_qd.numpy())


def test_the_forward_solver_falls_alike(reference):
    die = Die(reference)
    die.forward()
    pipeline = novaphy.CollisionPipeline(die.model)
    contacts = pipeline.contacts()
    forward = solvers.SolverSemiImplicit(die.model, friction_law="huber", friction_smoothing=0.1)
    state, after = die.model.state(), die.model.state()
    for _ in range(340):  # past the first touch; later bounces part the two by rounding
        pipeline.collide(state, contacts)
        forward.step(state, after, None, contacts, DT)
        state, after = after, state
    assert contacts.rigid_contacts()["force"].any()
    np.testing.assert_allclose(
        state.body_q.numpy(), die.trajectory[340].body_q.numpy(), rtol=0, atol=2e-5
    )


TURNED = np.float32([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9])
STATES = {  # shape, pose, twist: none near a kink
    "a box on a corner, sliding": (
        "box",
        (0, 0, 0.13, *TURNED),
        (0.7, 0.3, -0.4, 0.5, -0.3, 0.2),
    ),
    "a box deep in the ground, turned a little": (
        "box",
        (0.1, 0.2, 0.085, 0.02, 0.01, 0.3, np.sqrt(1 - 0.0905)),
        (0.2, 0.1, -0.2, 0.3, 0.1, -0.4),
    ),
    "a rolling sphere": ("sphere", (0, 0, 0.09, *TURNED), (0.5, 0.2, -0.3, 0.3, 0.4, 1.0)),
    "a leaning capsule": (
        "capsule",
        (0, 0, 0.1, 0, np.sin(0.6), 0, np.cos(0.6)),
        (0.5, 0.2, -0.3, 0.3, 0.4, 1.0),
    ),
    "a box in flight": ("box", (0, 0, 2.0, *TURNED), (0.5, 0.2, 0.3, 3.0, -2.0, 1.0)),
}


def one_step(model, q, qd, f, smoothing=0.1):
    q1, qd1 = diff.integrate_rigid_bodies_with_static_contacts_generated(
        model, q, qd, f, DAMPING, smoothing, 1 / 100
    )
    weights = np.float32(np.cos(np.arange(13)))
    return nova.sum(q1 * nova.tensor(weights[None, :7])) + nova.sum(
        qd1 * nova.tensor(weights[None, 7:])
    )


@pytest.mark.parametrize("name", STATES)
def test_gradients_of_a_step_are_its_derivatives(name):
    shape, pose, twist = STATES[name]
    model = die_model(shape)
    inputs = [
        nova.tensor(np.float32([x]), requires_grad=True)
        for x in (pose, twist, (0.3, -0.2, 0.5, 0.1, 0.2, -0.1))
    ]
    found = nova.gradcheck(
        lambda q, qd, f: one_step(model, q, qd, f), inputs, epsilon=1e-3, rtol=2e-2, atol=1e-3
    )
    assert found.ok, found.worst


@pytest.mark.parametrize("name", list(STATES)[:4])
def test_gradients_with_respect_to_the_model_are_derivatives(name):
    shape, pose, twist = STATES[name]
    model = die_model(shape)
    q, qd = (nova.tensor(np.float32([x])) for x in (pose, twist))
    f = nova.tensor(np.float32([(0.3, -0.2, 0.5, 0.1, 0.2, -0.1)]))
    names = ["body_mass", "body_com", "gravity", "shape_material_mu"]
    leaves = [getattr(diff, f"model_{n}_tensor")(model, requires_grad=True) for n in names]
    found = nova.gradcheck(
        lambda *_: one_step(model, q, qd, f), leaves, epsilon=2e-3, rtol=2e-2, atol=1e-3
    )
    assert found.ok, found.worst


def test_the_gradient_reaches_the_inertia_by_way_of_its_inverse():
    shape, pose, twist = STATES["a box in flight"]
    model = die_model(shape)
    q, qd = (nova.tensor(np.float32([x])) for x in (pose, twist))
    f = nova.tensor(np.float32([(0, 0, 0, 1.0, 2.0, -1.0)]))
    inertia = diff.model_body_inertia_tensor(model, requires_grad=True)
    with nova.Tape() as tape:
        tape.backward(one_step(model, q, qd, f))
    gradient = inertia.grad.numpy().reshape(3, 3)
    start = model.body_inertia.numpy()
    for i in range(3):
        values = []
        for sign in (1, -1):
            moved = start.copy()
            moved[0, i, i] += sign * 1e-3
            model.body_inertia = moved
            values.append(one_step(model, q, qd, f).item())
        model.body_inertia = start
        assert gradient[i, i] == pytest.approx((values[0] - values[1]) / 2e-3, rel=2e-2)


@pytest.mark.parametrize("shape", ["box", "sphere", "capsule"])
def test_at_rest_the_gradient_is_finite_and_friction_is_part_of_it(shape):
    height = {"box": 0.097, "sphere": 0.095, "capsule": 0.055}[shape]
    turn = (0, np.sin(np.pi / 4), 0, np.cos(np.pi / 4)) if shape == "capsule" else (0, 0, 0, 1)
    model = die_model(shape)
    q = nova.tensor(np.float32([(0, 0, height, *turn)]), requires_grad=True)
    qd = nova.zeros((1, 6), requires_grad=True)
    mass = float(model.body_mass.numpy()[0])
    dt = 1e-3
    for smoothing in (0.0, 0.1):
        with nova.Tape() as tape:
            _, end = diff.integrate_rigid_bodies_with_static_contacts_generated(
                model, q, qd, nova.zeros((1, 6)), 0.0, smoothing, dt
            )
            tape.backward(nova.sum(end * nova.tensor(np.float32([[1, 0, 0, 0, 0, 0]]))))
        gradient = qd.grad.numpy()[0]
        assert np.isfinite(q.grad.numpy()).all() and np.isfinite(gradient).all()
        contacts = {"box": 4, "sphere": 1, "capsule": 2}[shape]
        depth = {"box": 0.003, "sphere": 0.005, "capsule": 0.005}[shape]
        limit = 0.5 * 1e4 * depth
        slope = min(500.0, 2 * limit / smoothing) if smoothing else 500.0
        assert gradient[0] == pytest.approx(1 - contacts * slope * dt / mass, rel=1e-2)
        tape.zero()


def test_what_is_not_covered_is_named():
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    for x in (0.0, 3.0):
        body = builder.add_body(xform=(x, 0, 1, 0, 0, 0, 1))
        builder.add_shape_box(body)
    model = builder.finalize()
    config = solvers.DiffSolverConfig(enable_static_contacts=True)
    with pytest.raises(NotImplementedError, match=r"shapes 1 \(BOX\) and 2 \(BOX\)"):
        solvers.DiffSemiImplicitSolver(model, config)
    with pytest.raises(NotImplementedError, match="enable_rigid"):
        solvers.DiffSemiImplicitSolver(model, solvers.DiffSolverConfig(enable_rigid=False))
    q, qd = nova.zeros((2, 7)), nova.zeros((2, 6))
    step = diff.integrate_rigid_bodies_with_static_contacts_generated
    with pytest.raises(NotImplementedError, match=r"shapes 1 \(BOX\) and 2 \(BOX\)"):
        step(model, q, qd, qd, 0.05, 0.1, 1e-3)
    alone = die_model()
    q, qd = nova.zeros((1, 7)), nova.zeros((1, 6))
    for arguments, message in [
        ((qd, qd, qd, 0.05, 0.1, 1e-3), "body_q"),
        ((q, q, qd, 0.05, 0.1, 1e-3), "body_qd"),
        ((q, qd, qd, -0.05, 0.1, 1e-3), "angular_damping"),
        ((q, qd, qd, 0.05, -0.1, 1e-3), "friction_smoothing"),
        ((q, qd, qd, 0.05, 0.1, 0.0), "dt"),
    ]:
        with pytest.raises(ValueError, match=message):
            step(alone, *arguments)


def test_the_losses_check_their_arguments():
    q, qd = nova.zeros((2, 7)), nova.zeros((2, 6))
    loss = diff.rigid_orientation_velocity_loss_generated
    x, z = (1, 0, 0), (0, 0, 1)
    with pytest.raises(IndexError, match="body_index"):
        loss(q, qd, 2, x, z, x, z)
    with pytest.raises(ValueError, match="target_axis_a"):
        loss(q, qd, 0, x, (0, 0, 0), x, z)
    with pytest.raises(ValueError, match="height_weight"):
        loss(q, qd, 0, x, z, x, z, height_weight=float("nan"))
    with pytest.raises(ValueError, match="omega"):
        diff.body_twist_from_omega_generated(q, 0, 0, 0)
