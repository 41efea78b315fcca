"""Gradients through contacts of articulations against differences of the converged solve."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_articulation_chains import TIGHT, snake

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
DT = 0.01


def ball(velocity: tuple[float, ...], restitution: float = 0.0, z: float = 0.102):
    """A turned ball just above the ground, or in it."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5, restitution=restitution)
    builder.add_ground_plane(cfg=surface)
    body = builder.add_body(xform=((0.0, 0.0, z), (0.0, 0.0, 0.1, 0.995)))
    builder.add_shape_sphere(body, radius=0.1, cfg=surface)
    builder.body_qd[body] = velocity
    return builder


def box(speed: float, depth: float = 0.002, restitution: float = 0.0):
    """A box whose four corners are in the ground: rows that are not independent."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5, restitution=restitution)
    builder.add_ground_plane(cfg=surface)
    body = builder.add_body(xform=((0.0, 0.0, 0.1 - depth), UPRIGHT))
    builder.add_shape_box(body, hx=0.1, hy=0.15, hz=0.1, cfg=surface)
    builder.body_qd[body] = (speed, 0.3 * speed, 0.0, 0.0, 0.0, 0.0)
    return builder


def walker(depth: float = 0.002, spread: float = 0.2, **hip: float):
    """A trunk on two legs with round feet, one of which leans on a ball."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5)
    builder.add_ground_plane(cfg=surface)
    trunk = builder.add_link(
        xform=((0.0, 0.0, 0.5 - depth), UPRIGHT), mass=2.0, inertia=np.diag([0.02, 0.03, 0.04])
    )
    joints = [builder.add_joint_free(trunk)]
    for side in (-spread, spread):
        leg = builder.add_link(
            mass=0.5, inertia=np.diag([0.005, 0.006, 0.004]), com=(0.01, 0.0, -0.2)
        )
        builder.add_shape_sphere(leg, xform=((0.0, 0.0, -0.4), UPRIGHT), radius=0.1, cfg=surface)
        joints.append(
            builder.add_joint_revolute(
                trunk, leg, axis=(0.0, 1.0, 0.0), parent_xform=((side, 0.0, 0.0), UPRIGHT), **hip
            )
        )
    builder.add_articulation(joints)
    other = builder.add_body(xform=((0.395, 0.02, 0.11), UPRIGHT))
    builder.add_shape_sphere(other, radius=0.1, cfg=surface)
    builder.joint_qd[0:8] = [0.3, 0.1, -0.4, 0.1, 0.2, 0.1, 0.3, -0.2]
    return builder


def walker_that_follows():
    """The walker, one of whose legs follows the other."""
    builder = walker()
    builder.add_constraint_mimic(2, 1, 0.0, -0.7)
    return builder


def free_below_a_swinging_body():
    """A ball that is free, but whose joint hangs on a body that turns."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5, density=0.0)
    builder.add_ground_plane(cfg=surface)
    inertia = np.diag([0.02, 0.03, 0.04])
    arm = builder.add_link(mass=1.0, inertia=inertia)
    child = builder.add_link(mass=0.7, inertia=inertia)
    joints = [
        builder.add_joint_revolute(
            -1, arm, axis=(0.0, 1.0, 0.0), parent_xform=((0.0, 0.0, 0.5), UPRIGHT)
        ),
        builder.add_joint_free(parent=arm, child=child),
    ]
    builder.add_articulation(joints)
    builder.add_shape_sphere(child, radius=0.1, cfg=surface)
    builder.joint_q[-7:] = [0.2, 0.1, -0.402, *UPRIGHT]
    builder.joint_qd[0:7] = [0.3, 0.2, -0.1, -0.4, 0.1, 0.2, -0.3]
    return builder


def on_a_kinematic_table(speed: float):
    """A ball, and a trunk on a leg with a round foot, on a slab that moves and turns."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5)
    slab = builder.add_body(
        is_kinematic=True, xform=((0.0, 0.0, -0.1), UPRIGHT), com=(0.1, -0.2, 0.05)
    )
    builder.add_shape_box(slab, hx=1.0, hy=1.0, hz=0.1, cfg=surface)
    body = builder.add_body(xform=((0.3, 0.2, 0.102), (0.0, 0.0, 0.1, 0.995)))
    builder.add_shape_sphere(body, radius=0.1, cfg=surface)
    trunk = builder.add_link(mass=2.0, inertia=np.diag([0.02, 0.03, 0.04]))
    leg = builder.add_link(mass=0.5, inertia=np.diag([0.005, 0.006, 0.004]), com=(0.01, 0, -0.2))
    builder.add_shape_sphere(leg, xform=((0.0, 0.0, -0.4), UPRIGHT), radius=0.1, cfg=surface)
    joints = [builder.add_joint_free(trunk)]
    joints.append(builder.add_joint_revolute(trunk, leg, axis=(0.0, 1.0, 0.0)))
    builder.add_articulation(joints)
    builder.joint_q[-8:] = [-0.5, 0.1, 0.498, *UPRIGHT, 0.05]
    builder.body_qd[slab] = (speed, 0.1, 0.2, 0.05, -0.1, 0.3)
    builder.body_qd[body] = (0.2, 0.1, -0.4, 0.2, -0.3, 0.4)
    return builder


CASES = {
    "breaking": (lambda: ball((0.1, 0.1, 1.0, 0.2, 0.3, 0.4)), {}, (1, 0, 0)),
    "sticking": (lambda: ball((0.1, 0.05, -0.5, -0.5, 1.0, 0.3)), {}, (0, 1, 0)),
    "sliding": (lambda: ball((1.0, 0.3, -0.4, 0.2, -0.3, 0.4)), {}, (0, 0, 1)),
    "sliding in": (lambda: ball((1.0, 0.3, -0.2, 0.2, -0.3, 0.4), z=0.09), {}, (0, 0, 1)),
    "pyramid": (
        lambda: ball((1.0, 0.3, -0.4, 0.2, -0.3, 0.4)),
        {"friction_cone": "pyramid"},
        (0, 0, 1),
    ),
    "soft": (lambda: ball((1.0, 0.3, -0.4, 0.2, -0.3, 0.4)), {"pgs_cfm": 0.1}, (0, 0, 1)),
    "spring": (
        lambda: ball((0.1, 0.05, -0.5, -0.5, 1.0, 0.3), z=0.097),
        {"compliant_contacts": True},
        (0, 1, 0),
    ),
    "bouncing": (lambda: ball((1.0, 0.2, -1.0, 0.1, 0.2, 0.3), 0.7), {}, (0, 1, 0)),
    "bouncing in the ground": (
        lambda: ball((1.0, 0.2, -1.0, 0.1, 0.2, 0.3), 0.7, z=0.02),
        {},
        (0, 1, 0),
    ),
    "standing box": (lambda: box(0.02), {"pgs_slop": 0.0}, (0, 4, 0)),
    "sliding box": (lambda: box(1.0), {"pgs_slop": 0.0}, (0, 0, 4)),
    "box in the ground": (lambda: box(1.0, 0.02), {}, (0, 0, 4)),
    "walker in the ground": (lambda: walker(0.02), {}, (1, 3, 0)),
    "walker": (walker, {}, (1, 3, 0)),
    "walker with weak drives": (
        lambda: walker(target_ke=500.0, target_kd=5.0, target_q=0.3, effort_limit=2.0),
        {},
        (1, 3, 0),
    ),
    "walker at its velocity limits": (lambda: walker(velocity_limit=0.4), {}, (1, 3, 0)),
    "legs that follow": (walker_that_follows, {}, (1, 1, 2)),
    "snake": (lambda: snake(mu=2.0), {}, (0, 3, 0)),
    "snake in the ground": (lambda: snake(0.02), {}, (0, 0, 3)),
    "snake at its limits": (lambda: snake(**TIGHT), {}, (0, 0, 3)),
    "walker on a pyramid": (walker, {"friction_cone": "pyramid"}, (1, 3, 0)),
    "sticking to a moving table": (lambda: on_a_kinematic_table(0.1), {}, (0, 2, 0)),
    "sliding on a moving table": (lambda: on_a_kinematic_table(1.5), {}, (0, 0, 2)),
    "free below a body": (free_below_a_swinging_body, {}, (0, 1, 0)),
}


def capsule():
    """A capsule that leans on the ground with one end, and turns."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5)
    builder.add_ground_plane(cfg=surface)
    body = builder.add_body(xform=((0.0, 0.0, 0.202), (0.3, 0.1, 0.0, 0.948)))
    builder.add_shape_capsule(body, radius=0.08, half_height=0.15, cfg=surface)
    builder.body_qd[body] = (0.4, 0.1, -0.5, 1.0, -2.0, 0.7)
    return builder


def tilted_box():
    """A box on one of its corners."""
    builder = box(0.1)
    builder.joint_q[0:7] = [0.0, 0.0, 0.165, 0.2, 0.15, 0.05, 0.967]
    return builder


# Contacts that are found from the state of the step: points and normals follow both bodies. Twelve
# hinges in a row leave differences of float32 that find contacts too coarse.
FOUND = {
    **{name: CASES[name] for name in CASES if "snake" not in name},
    "capsule": (capsule, {}, (0, 0, 1)),
    # Its other corners cannot touch within the step.
    "tilted box": (tilted_box, {"pgs_slop": 0.0}, (0, 0, 1)),
}


@pytest.mark.parametrize(
    "case, held", [(case, True) for case in CASES] + [(case, False) for case in FOUND]
)
def test_the_gradient_of_a_step_is_that_of_the_converged_solve(case: str, held: bool) -> None:
    """With the contacts as they are, or found from each state that a difference starts from."""
    from novaphy import nova
    from novaphy.diff import state_joint_q_tensor, state_joint_qd_tensor

    build, options, branches = (CASES if held else FOUND)[case]
    model = build().finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_iterations=2000, **options, contact_gradient="code"
    )
    state, after, control = model.state(), model.state(), model.control()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    found_from = model.state() if held else state
    found_from.body_q.assign(state.body_q.numpy())
    pipeline.collide(found_from, contacts)
    rng = np.random.default_rng(3)
    weights = [rng.normal(size=n) for n in (model.joint_coord_count, model.joint_dof_count)]

    control.joint_f.requires_grad = model.body_com.requires_grad = True
    with nova.Tape() as tape:
        solver.step(state, after, control, contacts, DT)
        of_q, of_qd = (nova.tensor(w.astype(np.float32)) for w in weights)
        loss = nova.sum(state_joint_q_tensor(after) * of_q)
        loss = loss + nova.sum(state_joint_qd_tensor(after) * of_qd)
    tape.backward(loss)
    info = solver.gradient_info()
    assert (info["breaking"], info["sticking"], info["sliding"]) == branches, info
    assert info["frozen_contacts"] == (sum(branches[1:]) if held else 0)
    is_frozen = held and sum(branches[1:]) > 0
    assert info["label"] == ("frozen" if is_frozen else "exact of the code"), info["reason"]
    gradients = {
        "joint_q": state.joint_q.grad.numpy(),
        "joint_qd": state.joint_qd.grad.numpy(),
        "joint_f": control.joint_f.grad.numpy(),
        "body_com": model.body_com.grad.numpy().ravel(),
    }
    model.body_com.requires_grad = False

    def value(name: str, k: int, change: float) -> float:
        now, then, forces = model.state(), model.state(), model.control()
        owner = {"joint_f": forces, "body_com": model}.get(name, now)
        array = getattr(owner, name)
        before = array.numpy().copy()
        numbers = before.copy()
        numbers.flat[k] += change
        array.assign(numbers)
        if not held:
            novaphy.eval_fk(model, now.joint_q, now.joint_qd, now)
            pipeline.collide(now, contacts)
        solver.step(now, then, forces, contacts, DT)
        array.assign(before)
        q, qd = (x.numpy().astype(float) for x in (then.joint_q, then.joint_qd))
        return float(q @ weights[0] + qd @ weights[1])

    for name, eps in (("joint_q", 2e-4), ("joint_qd", 2e-3), ("joint_f", 0.2), ("body_com", 2e-3)):
        expected = np.array(
            [
                (value(name, k, eps) - value(name, k, -eps)) / (2 * eps)
                for k in range(gradients[name].size)
            ]
        )
        scale = max(np.abs(expected).max(), 0.05)
        np.testing.assert_allclose(gradients[name], expected, atol=2e-3 * scale, err_msg=name)


def tumbling_walker():
    """A capsule with two round feet that falls and rolls over."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.8)
    builder.add_ground_plane(cfg=surface)
    trunk = builder.add_link(mass=2.0, inertia=np.diag([0.02, 0.03, 0.04]))
    builder.add_shape_capsule(trunk, radius=0.1, half_height=0.2, cfg=surface)
    joints = [builder.add_joint_free(trunk)]
    for side in (-0.2, 0.2):
        leg = builder.add_link(
            mass=0.5, inertia=np.diag([0.005, 0.006, 0.004]), com=(0.01, 0.0, -0.2)
        )
        builder.add_shape_sphere(leg, xform=((0.0, 0.0, -0.25), UPRIGHT), radius=0.1, cfg=surface)
        anchor = ((side, 0.0, 0.0), UPRIGHT)
        joints.append(
            builder.add_joint_revolute(trunk, leg, axis=(0.0, 1.0, 0.0), parent_xform=anchor)
        )
    builder.add_articulation(joints)
    builder.joint_q[0:7] = [0.0, 0.0, 0.35, *UPRIGHT]
    builder.joint_qd[0:8] = [1.0, 0.2, -0.3, 0.5, 4.0, 0.3, 1.0, -1.0]
    return builder


def test_a_gradient_through_steps_that_find_their_contacts_is_that_of_the_real_steps() -> None:
    """Held points miss how a rolling foot moves over the ground; the label tells them apart."""
    from novaphy import nova
    from novaphy.diff import state_joint_q_tensor

    model = tumbling_walker().finalize()
    # With this slop and erp, one law holds for overlaps and gaps. A contact at rest is then at no
    # kink between two laws.
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_iterations=3000, pgs_slop=0.0, pgs_erp=1.0, contact_gradient="code"
    )
    pipeline = novaphy.CollisionPipeline(model)
    steps = 20
    weights = np.random.default_rng(1).normal(size=model.joint_coord_count).astype(np.float32)

    def run(rates: np.ndarray, held: bool = False) -> tuple[float, np.ndarray, str]:
        states = [model.state(requires_grad=True), *(model.state() for _ in range(steps))]
        states[0].joint_qd.assign(rates.astype(np.float32))
        novaphy.eval_fk(model, states[0].joint_q, states[0].joint_qd, states[0])
        contacts = [pipeline.contacts() for _ in range(steps)]
        solver.clear_gradient_info()
        with nova.Tape() as tape:
            for t in range(steps):
                source = states[t]
                if held:
                    source = model.state()
                    source.body_q.assign(states[t].body_q.numpy())
                pipeline.collide(source, contacts[t])
                solver.step(states[t], states[t + 1], None, contacts[t], DT)
            loss = nova.sum(state_joint_q_tensor(states[-1]) * nova.tensor(weights))
        tape.backward(loss)
        value = float(states[-1].joint_q.numpy().astype(float) @ weights)
        return value, states[0].joint_qd.grad.numpy(), solver.gradient_info()["label"]

    rates = model.joint_qd.numpy().astype(float)
    steps_of = 1e-3 * np.eye(rates.size)
    expected = np.array([(run(rates + d)[0] - run(rates - d)[0]) / 2e-3 for d in steps_of])

    def error(gradient: np.ndarray) -> float:
        return float(np.linalg.norm(gradient - expected) / np.linalg.norm(expected))

    found, held = run(rates), run(rates, held=True)
    assert found[0] == held[0]
    assert found[2] == "exact of the code" and error(found[1]) < 0.007
    assert held[2] == "frozen" and error(held[1]) > 0.04


def test_a_gradient_through_several_steps_of_a_walker() -> None:
    from novaphy import nova
    from novaphy.diff import state_joint_q_tensor

    model = walker().finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_iterations=2000, contact_gradient="code"
    )
    pipeline = novaphy.CollisionPipeline(model)
    steps = 5
    states = [model.state() for _ in range(steps + 1)]
    novaphy.eval_fk(model, states[0].joint_q, states[0].joint_qd, states[0])
    contacts = [pipeline.contacts() for _ in range(steps)]
    with nova.Tape() as tape:
        for t in range(steps):
            held = model.state()
            held.body_q.assign(states[t].body_q.numpy())
            pipeline.collide(held, contacts[t])
            solver.step(states[t], states[t + 1], None, contacts[t], DT / 5)
        loss = nova.sum(state_joint_q_tensor(states[-1]))
    tape.backward(loss)
    gradient = states[0].joint_qd.grad.numpy()

    def value(k: int, change: float) -> float:
        now, then = model.state(), model.state()
        numbers = now.joint_qd.numpy()
        numbers[k] += change
        now.joint_qd.assign(numbers)
        for t in range(steps):
            solver.step(now, then, None, contacts[t], DT / 5)
            now, then = then, now
        return float(now.joint_q.numpy().astype(float).sum())

    expected = np.array([(value(k, 4e-3) - value(k, -4e-3)) / 8e-3 for k in range(gradient.size)])
    np.testing.assert_allclose(gradient, expected, atol=3e-3 * np.abs(expected).max())


@pytest.mark.parametrize("checkpoint", [None, 4])
def test_a_rollout_that_finds_its_contacts_is_the_loop_of_steps(checkpoint: int | None) -> None:
    from novaphy import nova
    from novaphy.diff import Trajectory, state_joint_q_tensor

    model = walker().finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    pipeline = novaphy.CollisionPipeline(model)
    steps = 12
    states = [model.state() for _ in range(steps + 1)]
    trajectory = Trajectory(model, steps, checkpoint=checkpoint)
    for start in (states[0], trajectory[0]):
        novaphy.eval_fk(model, start.joint_q, start.joint_qd, start)
    contacts = [pipeline.contacts() for _ in range(steps)]
    with nova.Tape() as tape:
        for t in range(steps):
            pipeline.collide(states[t], contacts[t])
            solver.step(states[t], states[t + 1], None, contacts[t], DT / 5)
        loss = nova.sum(state_joint_q_tensor(states[-1]))
    tape.backward(loss)
    counted = solver.gradient_info()["contact_steps"]
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, DT / 5, pipeline=pipeline)
        loss = nova.sum(state_joint_q_tensor(trajectory[steps]))
    tape.backward(loss)
    assert solver.gradient_info()["contact_steps"] == 2 * counted == 2 * steps
    np.testing.assert_array_equal(trajectory[steps].joint_q.numpy(), states[-1].joint_q.numpy())
    for name in ("joint_q", "joint_qd"):
        expected = getattr(states[0], name).grad.numpy()
        np.testing.assert_array_equal(getattr(trajectory[0], name).grad.numpy(), expected)
        assert np.abs(expected).max() > 1e-3


@pytest.mark.parametrize("checkpoint", [None, 4])
def test_a_tape_with_contacts_goes_back_as_often_as_wanted(checkpoint: int | None) -> None:
    """What runs once more between checkpoints leaves the kept states as they were recorded."""
    from novaphy import nova
    from novaphy.diff import Trajectory, state_joint_q_tensor

    model = walker().finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    pipeline = novaphy.CollisionPipeline(model)
    trajectory = Trajectory(model, 12, checkpoint=checkpoint)
    novaphy.eval_fk(model, trajectory[0].joint_q, trajectory[0].joint_qd, trajectory[0])
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, DT / 5, pipeline=pipeline)
        loss = nova.sum(state_joint_q_tensor(trajectory[12]))
    tape.backward(loss)
    first = trajectory[0].joint_qd.grad.numpy().copy()
    for times in (2, 3):
        tape.backward(loss)
        expected = times * first if times == 2 else first + 2 * first
        np.testing.assert_array_equal(trajectory[0].joint_qd.grad.numpy(), expected)
    if checkpoint is not None:
        kept = trajectory[4].joint_qd
        kept.assign(kept.numpy() + 1.0)
        with pytest.raises(novaphy.Error, match="modified after recording"):
            tape.backward(loss)


def test_steps_of_an_ant_are_exact_and_match_differences(monkeypatch, capsys) -> None:
    from novaphy import nova
    from novaphy.diff import state_joint_qd_tensor

    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "python" / "demos"))
    import demo_articulated_scenes

    model, dt = demo_articulated_scenes.build_ant().finalize(), 1e-3
    # With this slop and erp, one law holds for overlaps and gaps. A contact at rest is then at no
    # kink between two laws.
    options = {"pgs_slop": 0.0, "pgs_erp": 1.0}
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, **options, contact_gradient="code")
    converged = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_iterations=2000, **options, contact_gradient="code"
    )
    pipeline = novaphy.CollisionPipeline(model)
    contacts, probed, control = pipeline.contacts(), pipeline.contacts(), model.control()
    state, after = model.state(), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    rng = np.random.default_rng(7)
    weight = rng.normal(size=model.joint_dof_count)
    compared, spread = 0, np.linalg.norm(weight)
    for t in range(900):
        if t == 300:
            solver.clear_gradient_info()  # the body has landed
        if t % 50 == 0:
            torques = np.zeros(model.joint_dof_count, np.float32)
            torques[6:] = rng.uniform(-60.0, 60.0, torques.size - 6)
            control.joint_f.assign(torques)
        pipeline.collide(state, contacts)
        if t >= 300 and t % 20 == 0:
            start = model.state(requires_grad=True)
            start.joint_q.assign(state.joint_q.numpy())
            start.joint_qd.assign(state.joint_qd.numpy())
            novaphy.eval_fk(model, start.joint_q, start.joint_qd, start)
            pipeline.collide(start, probed)
            converged.clear_gradient_info()
            with nova.Tape() as tape:
                end = model.state()
                converged.step(start, end, control, probed, dt)
                loss = nova.sum(state_joint_qd_tensor(end) * nova.tensor(weight.astype(np.float32)))
            tape.backward(loss)
            info = converged.gradient_info()
            # A slip near 0 turns within the difference.
            slips = info["slip_margin"] is None or info["slip_margin"] > 0.02
            if info["label"] == "exact of the code" and slips:
                branches = [[info[k] for k in ("breaking", "sticking", "sliding")]]
                along = rng.normal(size=model.joint_dof_count)
                along /= np.linalg.norm(along)
                values = []
                for side in (-1.0, 1.0):
                    moved, end = model.state(), model.state()
                    moved.joint_q.assign(state.joint_q.numpy())
                    qd = state.joint_qd.numpy() + side * 2e-3 * along
                    moved.joint_qd.assign(qd.astype(np.float32))
                    converged.clear_gradient_info()
                    converged.step(moved, end, control, probed, dt)
                    info = converged.gradient_info()
                    branches.append([info[k] for k in ("breaking", "sticking", "sliding")])
                    values.append(end.joint_qd.numpy().astype(float) @ weight)
                expected = (values[1] - values[0]) / 4e-3
                if branches == branches[:1] * 3:  # else the difference is over several
                    found = start.joint_qd.grad.numpy().astype(float) @ along
                    assert found == pytest.approx(expected, rel=1e-3, abs=2e-3 * spread)
                    compared += 1
        solver.step(state, after, control, contacts, dt)
        state, after = after, state
    info = solver.gradient_info()
    share = info["exact_steps"] / info["contact_steps"]
    with capsys.disabled():
        print(
            f" [{share:.1%} of {info['contact_steps']} steps exact, {compared} compared] ", end=""
        )
    assert info["contact_steps"] > 500 and share >= 0.95 and compared >= 10


def test_the_label_falls_where_sweeps_do_not_converge() -> None:
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5)
    builder.add_ground_plane(cfg=surface)
    for k in range(10):
        cube = builder.add_body(xform=((0.0, 0.0, 0.1 * (2 * k + 1) - 0.002), UPRIGHT))
        weight = novaphy.ShapeConfig(mu=0.5, density=10.0 if k % 2 == 0 else 1e4)
        builder.add_shape_box(cube, hx=0.1, hy=0.1, hz=0.1, cfg=weight)
    model = builder.finalize()
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    pipeline.collide(state, contacts)
    solver.step(state, after, None, contacts, DT)
    info = solver.gradient_info()
    assert info["label"] == "surrogate" and info["residual"] > 1e-3
    assert "have not converged" in info.reason
    assert info["contact_steps"] == 1 and info["exact_steps"] == 0
    solver.clear_gradient_info()
    assert solver.gradient_info()["contact_steps"] == 0

    model = ball((0.0, 0.0, 0.0, 0.0, 0.0, 0.0), z=0.1).finalize()
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    pipeline.collide(state, contacts)
    solver.step(state, after, None, contacts, DT)
    info = solver.gradient_info()
    assert info["label"] == "exact of the code" and info["gap_margin"] < 1e-6


@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_a_contact_whose_gap_is_exactly_zero_has_the_slope_of_its_neighbours(shape: str) -> None:
    from novaphy import nova
    from novaphy.diff import state_joint_qd_tensor

    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    body = builder.add_body(xform=((0.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0)))
    if shape == "sphere":
        builder.add_shape_sphere(body, radius=0.5)
    else:
        builder.add_shape_box(body, hx=0.5, hy=0.5, hz=0.5)
    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_slop=0.0, pgs_erp=1.0, contact_gradient="code"
    )
    pipeline = novaphy.CollisionPipeline(model)
    slopes = []
    for offset in (-1e-5, 0.0, 1e-5):
        state, after = model.state(), model.state()
        state.joint_q[2] = 0.5 + offset
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        contacts = pipeline.contacts()
        pipeline.collide(state, contacts)
        with nova.Tape() as tape:
            solver.step(state, after, None, contacts, DT)
            tape.backward(nova.sum(state_joint_qd_tensor(after)[2:3]))
        slopes.append(state.joint_q.grad.numpy()[2])
    np.testing.assert_allclose(slopes, -1.0 / DT, rtol=1e-3)


def test_what_has_no_gradient_through_contacts_raises() -> None:
    from novaphy import nova
    from novaphy.diff import Trajectory

    model = ball((0.1, 0.0, -0.5, 0.0, 0.0, 0.0)).finalize(requires_grad=True)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    pipeline.collide(state, contacts)
    with pytest.raises(NotImplementedError, match="penalty"):
        novaphy.solvers.DiffFeatherstoneSolver(model, contact="penalty", contact_gradient="code")
    refusing = novaphy.solvers.DiffFeatherstoneSolver(model, contact=None, contact_gradient="code")
    with pytest.raises(ValueError, match="contacts: expected none"):
        refusing.step(state, after, None, contacts, DT)
    with pytest.raises(ValueError, match="contacts: expected none"):
        refusing.rollout(Trajectory(model, 2), None, contacts, DT)
    solver = novaphy.solvers.DiffFeatherstoneSolver(model, contact_gradient="code")
    model.joint_X_p.requires_grad = True
    with nova.Tape(), pytest.raises(NotImplementedError, match="model.joint_X_p: expected"):
        solver.step(state, after, None, contacts, DT)


@pytest.mark.parametrize("spin", [0.0, 0.5])
def test_redundant_contacts_are_no_surrogate(spin: float) -> None:
    """With more spin they are: test_open_friction.py."""
    builder = box(1.0)
    builder.joint_qd[0:6] = [1.0, 0.3, -0.2, 0.0, 0.0, spin]
    model = builder.finalize()
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_slop=0.0, pgs_iterations=5000, pgs_tolerance=1e-9, contact_gradient="code"
    )
    state = model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    solver.step(state, model.state(), None, contacts, DT)
    info = solver.gradient_info()
    assert info["label"] == "exact of the code" and info["sliding"] == 4


def capsule():
    """A capsule without a joint, just above the ground, with its center of mass aside."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5, density=0.0)
    builder.add_ground_plane(cfg=surface)
    body = builder.add_body(
        xform=((0.0, 0.0, 0.1), UPRIGHT), mass=1.0, com=(0.03, 0.0, 0.0),
        inertia=np.diag([0.01, 0.012, 0.014]),
    )  # fmt: skip
    along_x = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    builder.add_shape_capsule(
        body, xform=((0.0, 0.0, 0.0), along_x), radius=0.1, half_height=0.2, cfg=surface
    )
    return builder.finalize()


@pytest.mark.parametrize("follows", [True, False], ids=["eval_fk", "no eval_fk"])
def test_a_first_search_from_other_poses_is_frozen_and_so_is_the_gradient(follows):
    # The user writes joint_q of the first state. The first search reads body_q.
    from novaphy import diff, nova

    model, angle = capsule(), 0.06
    start = np.array([0.0, 0.0, 0.105, 0.0, np.sin(angle), 0.0, np.cos(angle)])
    turn = np.array([0.0, 0.0, 0.0, 0.0, np.cos(angle), 0.0, -np.sin(angle)])
    weights = nova.tensor(np.float32([0.7, -0.4, 0.5, 0.3, -0.6, 0.8]))
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, contact_gradient="code", pgs_slop=0.0, pgs_erp=0.5
    )
    path, pipeline = diff.Trajectory(model, 3), novaphy.CollisionPipeline(model)

    def result(joint_q: np.ndarray):
        path[0].joint_q.assign(joint_q.astype(np.float32))
        path[0].joint_qd.assign(np.float32([0.3, 0.2, -0.5, 0.1, 0.4, 0.2]))
        path[0].body_q.assign(model.body_q.numpy())
        if follows:
            with nova.no_grad():
                novaphy.eval_fk(model, path[0].joint_q, path[0].joint_qd, path[0])
        solver.rollout(path, None, None, 5e-3, pipeline=pipeline)
        return nova.sum(diff.state_joint_qd_tensor(path[3]) * weights)

    path[0].joint_q.requires_grad = True
    with nova.Tape() as tape:
        tape.backward(result(start))
    slope = float(path[0].joint_q.grad.numpy() @ turn)
    label = solver.gradient_info().label
    path[0].joint_q.requires_grad = False
    rise = result(start + 1e-3 * turn).item() - result(start - 1e-3 * turn).item()
    assert slope == pytest.approx(rise / 2e-3, rel=5e-3)
    assert label == ("exact of the code" if follows else "frozen")
