"""What must not matter to a step of articulations; limits, half turns, and states that are odd."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose

import novaphy

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
DT = 1e-3


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of quaternions xyzw."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.array([*vector, a[3] * b[3] - a[:3] @ b[:3]])


def turned(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    return v + 2 * np.cross(q[:3], np.cross(q[:3], v) + q[3] * v)


def simulate(model: novaphy.Model, steps: int = 200) -> novaphy.SimState:
    solver = novaphy.solvers.SolverFeatherstone(model)
    state, after = model.state(), model.state()
    for _ in range(steps):
        solver.step(state, after, None, None, DT)
        state, after = after, state
    return state


# A hinge with three branches: a slide, a ball joint and a hinge that carries a slide.
KINDS = ("revolute", "prismatic", "ball", "revolute", "prismatic")
PARENTS = (-1, 0, 0, 0, 3)


class Tree:
    """The numbers of the tree, whatever the order in which joints are added."""

    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.links, self.joints, self.q, self.qd = [], [], [], []
        for kind in KINDS:
            half = rng.normal(size=(3, 3)) * 0.2
            inertia = half @ half.T
            inertia += np.trace(inertia) * np.eye(3)
            self.links.append(
                {"mass": rng.uniform(0.5, 2), "com": rng.normal(size=3) * 0.1, "inertia": inertia}
            )
            turn = rng.normal(size=4)
            joint = {"parent_xform": (rng.normal(size=3) * 0.3, turn / np.linalg.norm(turn))}
            if kind != "ball":
                joint |= {"axis": rng.normal(size=3), "target_ke": 20.0, "target_kd": 1.0}
            self.joints.append(joint)
            rotation = np.array([*rng.normal(size=3) * 0.2, 1.0])
            self.q.append(
                rotation / np.linalg.norm(rotation) if kind == "ball" else rng.uniform(-0.5, 0.5, 1)
            )
            self.qd.append(rng.uniform(-1, 1, 3 if kind == "ball" else 1))

    def add(self, builder: novaphy.ModelBuilder, order: tuple[int, ...]) -> None:
        links, joints = {-1: -1}, []
        for k in order:
            links[k] = builder.add_link(**self.links[k])
        for k in order:
            add = getattr(builder, f"add_joint_{KINDS[k]}")
            joints.append(add(links[PARENTS[k]], links[k], **self.joints[k]))
        builder.add_articulation(joints)
        rows = builder.joint_q[: len(builder.joint_q) - 8], builder.joint_qd[:-7]
        builder.joint_q = [*rows[0], *np.concatenate([self.q[k] for k in order])]
        builder.joint_qd = [*rows[1], *np.concatenate([self.qd[k] for k in order])]

    def split(self, numbers: np.ndarray, order: tuple[int, ...], of: list) -> np.ndarray:
        """The numbers in the order of KINDS."""
        parts = np.split(numbers, np.cumsum([len(of[k]) for k in order])[:-1])
        return np.concatenate([parts[order.index(k)] for k in range(len(KINDS))])


def orders() -> list[tuple[int, ...]]:
    """Those with parents first."""
    return [
        order
        for order in itertools.permutations(range(5))
        if all(p < 0 or order.index(p) < order.index(k) for k, p in enumerate(PARENTS))
    ]


def test_any_order_of_joints_with_parents_first_moves_the_same() -> None:
    tree, found = Tree(), []
    assert len(orders()) == 12
    for order in orders():
        builder = novaphy.ModelBuilder()
        tree.add(builder, order)
        state = simulate(builder.finalize())
        found.append(
            np.concatenate(
                [
                    tree.split(state.joint_q.numpy(), order, tree.q),
                    tree.split(state.joint_qd.numpy(), order, tree.qd),
                ]
            )
        )
    assert_allclose(found, np.broadcast_to(found[0], np.shape(found)), atol=2e-5)
    assert np.abs(found[0] - np.concatenate([*tree.q, *tree.qd])).max() > 0.1


def test_any_order_of_articulations_has_the_same_bits() -> None:
    trees = [Tree(seed) for seed in range(3)]
    found = {}
    for order in itertools.permutations(range(3)):
        builder = novaphy.ModelBuilder()
        for k in order:
            trees[k].add(builder, (0, 1, 2, 3, 4))
        state = simulate(builder.finalize(), 50)
        for k, q, qd in zip(
            order,
            np.split(state.joint_q.numpy(), 3),
            np.split(state.joint_qd.numpy(), 3),
            strict=True,
        ):
            found.setdefault(k, []).append(np.concatenate([q, qd]).tobytes())
    assert all(len(set(bits)) == 1 for bits in found.values())


def test_a_d6_of_one_angle_is_a_hinge() -> None:
    found = []
    for d6 in (False, True):
        builder = novaphy.ModelBuilder()
        link = builder.add_link(mass=1.0, com=(0.1, 0.05, 0.0), inertia=np.diag([0.02, 0.03, 0.04]))
        numbers = {"axis": (0.0, 0.6, 0.8), "target_ke": 5.0, "target_kd": 0.1, "target_q": 0.3}
        if d6:
            axis = novaphy.JointDofConfig(**numbers)
            joint = builder.add_joint_d6(-1, link, angular_axes=[axis])
        else:
            joint = builder.add_joint_revolute(-1, link, **numbers)
        builder.add_articulation([joint])
        state = simulate(builder.finalize())
        found.append(np.concatenate([state.joint_q.numpy(), state.joint_qd.numpy()]))
    assert_allclose(*found, rtol=1e-6)


def test_a_base_that_is_turned_with_gravity_a_kilometre_away_moves_the_same() -> None:
    turn = np.array([0.3, -0.5, 0.2, 0.7])
    turn /= np.linalg.norm(turn)
    found = []
    for away in (False, True):
        tree = Tree()
        if away:
            at, q = tree.joints[0]["parent_xform"]
            place = np.array([1000.0, -1000.0, 500.0]) + turned(turn, np.asarray(at))
            tree.joints[0]["parent_xform"] = (place, product(turn, np.asarray(q)))
        builder = novaphy.ModelBuilder()
        tree.add(builder, (0, 1, 2, 3, 4))
        model = builder.finalize()
        gravity = np.array([0.0, 0.0, -9.81])
        model.set_gravity(tuple(turned(turn, gravity) if away else gravity))
        state = simulate(model)
        found.append(np.concatenate([state.joint_q.numpy(), state.joint_qd.numpy()]))
    assert_allclose(*found, atol=2e-5)


def test_a_quaternion_and_its_negative_are_one_rotation() -> None:
    found = []
    for sign in (1.0, -1.0):
        tree = Tree()
        tree.q[2] = sign * tree.q[2]
        builder = novaphy.ModelBuilder()
        tree.add(builder, (0, 1, 2, 3, 4))
        state = simulate(builder.finalize())
        q = state.joint_q.numpy()
        q[2:6] *= sign
        found.append(
            np.concatenate([q, state.joint_qd.numpy(), state.body_q.numpy()[:, :3].ravel()])
        )
    assert_allclose(*found, atol=1e-6)


def test_a_ball_joint_turns_through_half_a_turn_and_more() -> None:
    """With equal moments and no gravity: at a constant rate, w dt of the Cayley map a step."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    link = builder.add_link(mass=1.0, inertia=0.1 * np.eye(3))
    builder.add_articulation([builder.add_joint_ball(-1, link)])
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    builder.joint_qd = (2 * np.pi * axis).tolist()
    model = builder.finalize()
    solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.0)
    state, after = model.state(), model.state()
    each = 2 * np.arctan(0.5 * DT * 2 * np.pi)
    for step in range(1, 1001):
        solver.step(state, after, None, None, DT)
        state, after = after, state
        q = state.joint_q.numpy()
        expected = np.array([*(np.sin(step * each / 2) * axis), np.cos(step * each / 2)])
        assert abs(q @ expected) == pytest.approx(1.0, abs=1e-5)
    assert_allclose(state.joint_qd.numpy(), 2 * np.pi * axis, rtol=1e-5)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 0, 1), (0.6, 0, -0.8)])
def test_a_ball_joint_at_half_a_turn_goes_both_ways(axis: tuple[float, ...]) -> None:
    builder = novaphy.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=0.1 * np.eye(3), com=(0.1, 0.0, 0.2))
    builder.add_articulation([builder.add_joint_ball(-1, link)])
    builder.joint_q, builder.joint_qd = [*axis, 0.0], [0.3, -1.0, 2.0]
    model = builder.finalize()
    state, back = model.state(), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    novaphy.eval_ik(model, state, back.joint_q, back.joint_qd)
    assert abs(back.joint_q.numpy() @ [*axis, 0.0]) == pytest.approx(1.0, abs=1e-6)
    assert_allclose(back.joint_qd.numpy(), [0.3, -1.0, 2.0], atol=1e-5)


def test_a_limit_lets_go_without_pulling_back() -> None:
    """Outside and leaving fast, the damper of the limit would pull; there is no force at all."""
    inertia = 0.1
    for rate, free in ((-5.0, True), (0.0, False)):
        builder = novaphy.ModelBuilder(gravity=0.0)
        link = builder.add_link(mass=1.0, inertia=inertia * np.eye(3))
        limits = {"limit_lower": -1.0, "limit_upper": 0.5, "limit_ke": 10.0, "limit_kd": 100.0}
        builder.add_articulation([builder.add_joint_revolute(-1, link, **limits)])
        builder.joint_q, builder.joint_qd = [0.6], [rate]
        model = builder.finalize()
        solver = novaphy.solvers.SolverFeatherstone(model, angular_damping=0.0)
        state, after = model.state(), model.state()
        solver.step(state, after, None, None, DT)
        if free:
            assert after.joint_qd.numpy()[0] == pytest.approx(rate, rel=1e-6)
        else:  # backward Euler of the spring and the damper
            pushed = -DT * 10.0 * 0.1 / (inertia + DT * 100.0 + DT**2 * 10.0)
            assert after.joint_qd.numpy()[0] == pytest.approx(pushed, rel=1e-4)


def test_the_factor_solves_as_a_dense_cholesky_does() -> None:
    builder = novaphy.ModelBuilder()
    Tree().add(builder, (0, 1, 2, 3, 4))
    model = builder.finalize()
    state = model.state()
    mass = novaphy.eval_mass_matrix(model, state)[0].astype(float)
    lower = np.linalg.cholesky(mass)
    tau = np.linspace(-1, 1, 7).astype(np.float32)
    bias = novaphy.eval_bias(model, state).ravel().astype(float)
    expected = np.linalg.solve(lower.T, np.linalg.solve(lower, tau - bias))
    got = novaphy.eval_forward_dynamics(model, state, tau).ravel()
    assert_allclose(got, expected, atol=2e-6 * np.linalg.cond(mass) * np.abs(expected).max())


def test_a_massless_link_between_others_is_legal() -> None:
    """Two hinges at one point with nothing between them are a D6 of two angles."""
    found = []
    for massless in (False, True):
        builder = novaphy.ModelBuilder()
        mass = {"mass": 1.0, "com": (0.1, 0.0, 0.0), "inertia": np.diag([0.02, 0.03, 0.04])}
        if massless:
            middle, link = builder.add_link(), builder.add_link(**mass)
            joints = [
                builder.add_joint_revolute(-1, middle, axis=(0, 1, 0)),
                builder.add_joint_revolute(middle, link, axis=(0, 0, 1)),
            ]
        else:
            link = builder.add_link(**mass)
            axes = [novaphy.JointDofConfig(axis=a) for a in ((0, 1, 0), (0, 0, 1))]
            joints = [builder.add_joint_d6(-1, link, angular_axes=axes)]
        builder.add_articulation(joints)
        builder.joint_q, builder.joint_qd = [0.2, -0.3], [0.5, 0.4]
        state = simulate(builder.finalize())
        found.append(np.concatenate([state.joint_q.numpy(), state.joint_qd.numpy()]))
    assert_allclose(*found, rtol=1e-5, atol=1e-6)


def test_a_target_outside_of_the_limits_is_kept() -> None:
    builder = novaphy.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=np.eye(3))
    limits = {"limit_lower": -0.5, "limit_upper": 0.5}
    builder.add_articulation([builder.add_joint_revolute(-1, link, target_q=2.0, **limits)])
    model = builder.finalize()
    assert model.joint_target_q.numpy().tolist() == [2.0]
    assert model.control().joint_target_q.numpy().tolist() == [2.0]


def test_a_quaternion_of_length_zero_is_named() -> None:
    builder = novaphy.ModelBuilder()
    Tree().add(builder, (0, 1, 2, 3, 4))
    model = builder.finalize()
    solver = novaphy.solvers.SolverFeatherstone(model)
    state, after = model.state(), model.state()
    q = state.joint_q.numpy()
    q[2:6] = 0.0
    state.joint_q.assign(q)
    before = after.joint_q.numpy().copy()
    with pytest.raises(novaphy.Error, match=r"joint 2|joint_2"):
        solver.step(state, after, None, None, DT)
    assert_allclose(after.joint_q.numpy(), before, atol=0)


def test_contacts_that_have_no_room_are_told() -> None:
    """A box rests on four corners; with room for three rows the flag says so, and it steps."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    body = builder.add_body(xform=((0.0, 0.0, 0.1), UPRIGHT))
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    model = builder.finalize()
    solver = novaphy.solvers.SolverFeatherstone(model)
    for room, full in ((3, True), (4, False)):
        pipeline = novaphy.CollisionPipeline(model, rigid_contact_max=room)
        contacts = pipeline.contacts()
        state, after = model.state(), model.state()
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        pipeline.collide(state, contacts)
        assert contacts.overflowed == full and contacts.rigid_contact_count.numpy()[0] == 4
        solver.step(state, after, None, contacts, DT)
        assert np.isfinite(after.joint_q.numpy()).all()
        assert contacts.rigid_contact_force.numpy()[:room, 2].sum() > 0.0
