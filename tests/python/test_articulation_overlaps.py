"""Bodies that overlap at first, standing robots, and sweeps that do not converge."""

from __future__ import annotations

import os
import warnings

import numpy as np
import pytest

import novaphy

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
GRAVITY = 9.81


class Scene:
    """A model with its solver, stepped with contacts that are found in every step."""

    def __init__(self, builder: novaphy.ModelBuilder, **options: object) -> None:
        self.model = builder.finalize()
        self.solver = novaphy.solvers.SolverFeatherstone(self.model, **options)
        self.pipeline = novaphy.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts()
        self.state, self.after = self.model.state(), self.model.state()
        self.place(self.state.joint_q.numpy())

    def place(self, q: np.ndarray) -> None:
        self.state.joint_q.assign(q)
        novaphy.eval_fk(self.model, self.state.joint_q, self.state.joint_qd, self.state)

    def step(self, dt: float) -> None:
        self.pipeline.collide(self.state, self.contacts)
        self.solver.step(self.state, self.after, None, self.contacts, dt)
        self.state, self.after = self.after, self.state

    def force(self) -> float:
        count = self.contacts.active_rigid_contact_count
        return float(np.abs(self.contacts.rigid_contact_force.numpy()[:count]).max(initial=0.0))


def boxes(depth: float, count: int = 1, first: int = 0) -> novaphy.ModelBuilder:
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5)
    builder.add_ground_plane(cfg=surface)
    for k in range(first, first + count):
        box = builder.add_body(xform=((k, 0.0, 0.1 - depth), UPRIGHT))
        builder.add_shape_box(box, hx=0.1, hy=0.1, hz=0.1, cfg=surface)
    return builder


@pytest.mark.parametrize("dt", [5e-4, 1e-3, 2e-3, 4e-3])
@pytest.mark.parametrize("depth", [0.001, 0.01, 0.05, 0.1])
def test_an_overlap_with_the_ground_is_taken_away_without_speed(depth: float, dt: float) -> None:
    scene = Scene(boxes(depth))
    heights, fastest = [], 0.0
    for _ in range(round(0.3 / dt)):
        scene.step(dt)
        heights.append(float(scene.state.joint_q.numpy()[2]) - 0.1)
        fastest = max(fastest, float(np.abs(scene.state.joint_qd.numpy()).max()))
    assert max(heights) < 1e-3
    assert heights[-1] == pytest.approx(-min(depth, 0.005), abs=1e-4)  # the slop stays
    assert fastest < 1e-3


def test_lanes_shift_as_a_box_alone() -> None:
    many = Scene(boxes(0.03, 6))
    for _ in range(20):
        many.step(2e-3)
    q = many.state.joint_q.numpy().reshape(6, 7)
    for k in (0, 5):
        alone = Scene(boxes(0.03, 1, first=k))
        for _ in range(20):
            alone.step(2e-3)
        np.testing.assert_array_equal(q[k], alone.state.joint_q.numpy())


def test_boxes_in_each_other_part_without_speed() -> None:
    builder = novaphy.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    for x in (0.0, 0.15):
        box = builder.add_body(xform=((x, 0.0, 0.0), UPRIGHT))
        builder.add_shape_box(box, hx=0.1, hy=0.1, hz=0.1)
    scene = Scene(builder)
    for _ in range(250):
        scene.step(2e-3)
    x = scene.state.body_q.numpy()[:, 0]
    assert x[1] - x[0] == pytest.approx(0.195, abs=1e-4)
    assert x.mean() == pytest.approx(0.075, abs=1e-5)
    assert np.abs(scene.state.joint_qd.numpy()).max() < 1e-4


def rotor() -> novaphy.ModelBuilder:
    """A rotor on the axis of its hinge, in the link before its parent: no motion parts them."""
    builder = novaphy.ModelBuilder()
    trunk, hip, rotor = (
        builder.add_link(mass=m, inertia=np.diag([0.01 * m] * 3)) for m in (5.0, 1.0, 0.1)
    )
    light = novaphy.ShapeConfig(density=0.0)
    builder.add_shape_box(trunk, hx=0.2, hy=0.1, hz=0.05, cfg=light)
    builder.add_shape_sphere(rotor, radius=0.03, cfg=light)
    at = ((0.1, 0.09, 0.04), UPRIGHT)
    joints = [builder.add_joint_free(trunk)]
    joints.append(builder.add_joint_revolute(trunk, hip, axis=(0, 1, 0), parent_xform=at))
    joints.append(builder.add_joint_revolute(hip, rotor, axis=(0, 1, 0)))
    builder.add_articulation(joints)
    return builder


def test_what_no_motion_can_part_falls_as_if_it_did_not_overlap() -> None:
    scene = Scene(rotor())
    strongest = 0.0
    for _ in range(250):
        scene.step(2e-3)
        strongest = max(strongest, scene.force())
    qd = scene.state.joint_qd.numpy()
    assert qd[2] == pytest.approx(-GRAVITY * 0.5, rel=1e-3)
    assert np.abs(np.delete(qd, 2)).max() < 0.05
    assert strongest < 6.1 * GRAVITY


def arm(offset: float, mass: float) -> novaphy.ModelBuilder:
    """A base, and two links on hinges of one axis, of which the last one overlaps the base on it.

    `offset` (m): the lever of the overlap about the axis.
    """
    builder = novaphy.ModelBuilder(gravity=0.0)
    light = novaphy.ShapeConfig(density=0.0)
    base, first, last = (
        builder.add_link(mass=m, inertia=np.eye(3) * 0.01 * m) for m in (9.0, mass, mass)
    )
    builder.add_shape_sphere(base, radius=0.1, cfg=light)
    at = ((offset, 0.0, 0.15), UPRIGHT)
    builder.add_shape_sphere(last, radius=0.1, xform=at, cfg=light)
    joints = [builder.add_joint_fixed(-1, base)]
    joints.append(builder.add_joint_revolute(base, first, axis=(0, 0, 1)))
    joints.append(builder.add_joint_revolute(first, last, axis=(0, 1e-4, 1)))
    builder.add_articulation(joints)
    return builder


@pytest.mark.filterwarnings("ignore:.*overlaps at the start")
@pytest.mark.parametrize("dt", [1e-3, 4e-3])
@pytest.mark.parametrize("offset", [0.0, 1e-7, 1e-5, 1e-4, 1e-3])
def test_contacts_that_nothing_moves_push_no_harder_than_the_moved_mass_allows(
    offset: float, dt: float
) -> None:
    scene = Scene(arm(offset, mass=5.0), pgs_slop=0.0)
    strongest = fastest = 0.0
    before = scene.state.joint_q.numpy()
    for _ in range(50):
        scene.step(dt)
        strongest = max(strongest, scene.force())
        fastest = max(fastest, float(np.abs(scene.state.joint_qd.numpy()).max()))
        after = scene.state.joint_q.numpy()
        assert np.abs(after - before).max() < 0.11  # no shift turns a joint farther
        before = after
    assert strongest < 10.0 / dt * 1.001  # N: 0.01 m/s of 10 kg, a hundred times
    assert fastest < 10.0


def random_tree(rng: np.random.Generator, root: int) -> str:
    def body(depth: int, name: str) -> str:
        place = rng.uniform(-0.15, 0.15, 3) + (np.array([0, 0, 0.4]) if depth == 3 else 0)
        turn = rng.normal(size=4)
        numbers = lambda x: " ".join(f"{v:.4f}" for v in x)  # noqa: E731
        text = f'<body name="{name}" pos="{numbers(place)}" quat="{numbers(turn)}">'
        kind = rng.integers(4)
        axis = numbers(rng.normal(size=3))
        joints = ("<joint type='ball'/>", f"<joint type='slide' axis='{axis}'/>")
        hinge = f"<joint type='hinge' axis='{axis}'/>"
        text += "<freejoint/>" if depth == 3 and kind < 2 else [*joints, hinge, hinge][kind]
        for _ in range(rng.integers(1, 3)):
            size, at = numbers(rng.uniform(0.02, 0.12, 3)), numbers(rng.uniform(-0.1, 0.1, 3))
            text += f'<geom type="{rng.choice(["sphere", "capsule", "box"])}" size="{size}" '
            text += f'pos="{at}" quat="{numbers(rng.normal(size=4))}"/>'
        for k in range(rng.integers(0, 3) if depth > 0 else 0):
            text += body(depth - 1, f"{name}_{k}")
        return text + "</body>"

    return body(3, f"b{root}")


@pytest.mark.skipif(not novaphy.has_io(), reason="needs NOVAPHY_WITH_IO")
@pytest.mark.parametrize("seed", range(8))
def test_random_bodies_that_overlap_at_first_do_not_explode(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bodies = "".join(random_tree(rng, k) for k in range(3))
    builder = novaphy.ModelBuilder()
    builder.add_mjcf(
        f'<mujoco><worldbody><geom type="plane" size="5 5 1"/>{bodies}</worldbody></mujoco>'
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = Scene(builder)
        for _ in range(100):
            scene.step(2e-3)
            assert np.abs(scene.state.joint_qd.numpy()).max() < 100.0


def violent_scene(seed: int) -> tuple[Scene, float]:
    """Bodies in each other, of any density, with random speeds, options and time step."""
    rng = np.random.default_rng([seed, 1])
    builder = novaphy.ModelBuilder()
    bodies = "".join(random_tree(rng, k) for k in range(rng.integers(1, 4)))
    density = 10.0 ** rng.uniform(1, 5)
    builder.add_mjcf(
        f'<mujoco><default><geom density="{density}"/></default><worldbody>'
        f'<geom type="plane" size="5 5 1"/>{bodies}</worldbody></mujoco>'
    )
    scene = Scene(
        builder,
        friction_cone=str(rng.choice(["cone", "pyramid"])),
        compliant_contacts=bool(rng.random() < 0.2),
        pgs_iterations=int(rng.choice([5, 30, 100])),
    )
    speeds = rng.normal(size=scene.model.joint_dof_count) * rng.choice([0.0, 1.0, 30.0])
    scene.state.joint_qd.assign(speeds.astype(np.float32))
    return scene, float(rng.choice([1e-3, 2e-3, 4e-3, 1e-2]))


def check_violent_scenes(seeds: range, steps: int) -> None:
    for seed in seeds:
        scene, dt = violent_scene(seed)
        try:
            for _ in range(steps):
                scene.step(dt)
        except RuntimeError as error:
            assert "SolverFeatherstone.step: " in str(error), seed
        for state in (scene.state, scene.after):
            for name in ("joint_q", "joint_qd", "body_q", "body_qd"):
                assert np.isfinite(getattr(state, name).numpy()).all(), (seed, name)


@pytest.mark.skipif(not novaphy.has_io(), reason="needs NOVAPHY_WITH_IO")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("chunk", range(8))
def test_violent_scenes_stay_finite_or_raise(chunk: int) -> None:
    check_violent_scenes(range(25 * chunk, 25 * (chunk + 1)), steps=25)


@pytest.mark.slow
@pytest.mark.skipif(not novaphy.has_io(), reason="needs NOVAPHY_WITH_IO")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("chunk", range(int(os.environ.get("NOVAPHY_VIOLENT_THOUSANDS", "2"))))
def test_thousands_of_violent_scenes_stay_finite_or_raise(chunk: int) -> None:
    check_violent_scenes(range(1000 * chunk, 1000 * (chunk + 1)), steps=100)


def quadruped(friction: float) -> Scene:
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.8, density=0.0)
    builder.add_ground_plane(cfg=surface)
    trunk = builder.add_link(mass=8.0, inertia=np.diag([0.05, 0.2, 0.2]))
    joints, home = [builder.add_joint_free(trunk)], []
    drive = {
        "axis": (0, 1, 0),
        "target_ke": 60.0,
        "target_kd": 3.0,
        "friction": friction,
        "actuator_mode": novaphy.JointTargetMode.POSITION,
    }
    for x in (0.2, -0.2):
        for y in (0.1, -0.1):
            thigh = builder.add_link(
                mass=0.8, inertia=np.diag([0.004, 0.004, 0.0005]), com=(0, 0, -0.1)
            )
            shank = builder.add_link(
                mass=0.2, inertia=np.diag([0.001, 0.001, 0.0001]), com=(0, 0, -0.1)
            )
            hip, knee = ((x, y, 0.0), UPRIGHT), ((0.0, 0.0, -0.2), UPRIGHT)
            joints.append(
                builder.add_joint_revolute(trunk, thigh, parent_xform=hip, target_q=0.8, **drive)
            )
            joints.append(
                builder.add_joint_revolute(thigh, shank, parent_xform=knee, target_q=-1.5, **drive)
            )
            builder.add_shape_sphere(shank, radius=0.02, xform=knee, cfg=surface)
            home += [0.8, -1.5]
    builder.add_articulation(joints)
    scene = Scene(builder, angular_damping=0.0)
    q = scene.state.joint_q.numpy()
    q[2] = 0.2 * np.cos(0.8) + 0.2 * np.cos(0.7) + 0.021
    q[7:] = home
    scene.place(q)
    return scene


@pytest.mark.parametrize("friction", [0.2, 1.0])
def test_a_robot_with_dry_friction_stands_still(friction: float) -> None:
    scene = quadruped(friction)
    for _ in range(1500):
        scene.step(1 / 500)
    start = scene.state.joint_q.numpy()
    for _ in range(1000):
        scene.step(1 / 500)
    moved = scene.state.joint_q.numpy() - start
    assert np.abs(moved[:3]).max() < 3e-6  # m in 2 s: below 0.1 mm a minute
    assert scene.solver.pgs_sweeps < 30


def test_notify_model_changed_forgets_the_friction_of_joints() -> None:
    scene, fresh = quadruped(0.2), quadruped(0.2)
    for _ in range(5):
        scene.step(1 / 500)
    scene.solver.notify_model_changed(novaphy.ModelFlags.ALL)
    fresh.place(scene.state.joint_q.numpy())
    fresh.state.joint_qd.assign(scene.state.joint_qd.numpy())
    for each in (scene, fresh):
        each.step(1 / 500)
    np.testing.assert_array_equal(scene.state.joint_qd.numpy(), fresh.state.joint_qd.numpy())


def uneven_stack() -> novaphy.ModelBuilder:
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(mu=0.5))
    for k, mass in enumerate((0.1, 10.0, 0.1, 10.0, 0.1)):
        box = builder.add_body(xform=((0.0, 0.0, 0.1 + 0.2 * k), UPRIGHT), label=f"box {k}")
        surface = novaphy.ShapeConfig(mu=0.5, density=mass / 0.008)
        builder.add_shape_box(box, hx=0.1, hy=0.1, hz=0.1, cfg=surface, label=f"box {k}")
    return builder


def test_sweeps_that_do_not_converge_warn_once() -> None:
    scene = Scene(uneven_stack(), pgs_iterations=5)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(100):
            scene.step(2e-3)
    texts = [str(w.message) for w in caught if "not converged" in str(w.message)]
    assert len(texts) == 1
    assert "the last of 5 sweeps changed velocities by" in texts[0]
    assert "shapes '" in texts[0] and "box" in texts[0]


def test_sweeps_that_converge_do_not_warn() -> None:
    scene = Scene(boxes(0.0, 6))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(50):
            scene.step(2e-3)


def test_an_explosion_names_the_rate_and_the_contact() -> None:
    scene = Scene(boxes(0.0))
    for _ in range(20):
        scene.step(2e-3)
    qd = scene.state.joint_qd.numpy()
    qd[4] = 1e30
    scene.state.joint_qd.assign(qd)
    expected = r"exploded: state_in.joint_qd of dof 4 .* is 1e\+30 .* largest force .* N between"
    with pytest.raises(RuntimeError, match=expected):
        scene.step(2e-3)


needs_diff = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")


def jammed_rod() -> novaphy.ModelBuilder:
    """Build a rod that is thrown onto its end, with so much friction that sweeps go around."""
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=30.0)
    builder.add_ground_plane(cfg=surface, label="floor")
    turn = (0.0, 0.5271881, 0.0, 0.8497486)
    rod = builder.add_body(xform=((0.0, 0.0, 0.24207272), turn))
    builder.add_shape_capsule(rod, radius=0.02, half_height=0.5, cfg=surface, label="rod")
    builder.body_qd[rod] = (5.543, -0.506, -0.607, -0.376, -3.357, -0.269)
    return builder


@needs_diff
@pytest.mark.parametrize("allowed", [False, True])
def test_gradients_of_a_step_that_did_not_converge_raise_unless_allowed(allowed: bool) -> None:
    from novaphy import diff, nova

    model = jammed_rod().finalize()
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, allow_unconverged=allowed, contact_gradient="code"
    )
    pipeline = novaphy.CollisionPipeline(model)
    path = diff.Trajectory(model, 3)
    start = diff.state_joint_qd_tensor(path[0])
    path[0].joint_qd.requires_grad = True
    with nova.Tape() as tape:
        solver.rollout(path, None, None, 1e-3, pipeline=pipeline)
        loss = nova.sum(diff.state_joint_q_tensor(path[3]))
    assert solver.gradient_info()["unconverged_steps"] > 0
    along = nova.tensor(np.ones(model.joint_dof_count, np.float32))
    if allowed:
        assert np.isfinite(tape.jvp([loss], [start], [along])[0].item())
        tape.backward(loss)
        assert np.isfinite(path[0].joint_qd.grad.numpy()).all()
        return
    told = r"not converged in step [0-2]: the last of 1000 sweeps .* 'floor' and 'rod'"
    with pytest.raises(RuntimeError, match=f"jvp: .*{told}.*allow_unconverged=True"):
        tape.jvp([loss], [start], [along])
    with pytest.raises(RuntimeError, match=f"backward: .*{told}.*allow_unconverged=True"):
        tape.backward(loss)


@needs_diff
@pytest.mark.parametrize("depth", [0.003, 0.02])
def test_gradients_of_shifts_are_those_of_differences(depth: float) -> None:
    from novaphy import diff, nova

    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5)
    builder.add_ground_plane(cfg=surface)
    turn = (0.3, 0.1, 0.05, 0.947)
    box = builder.add_body(xform=((0.0, 0.0, 0.1), turn))
    builder.add_shape_box(box, hx=0.1, hy=0.15, hz=0.08, cfg=surface)
    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_slop=0.0, pgs_tolerance=1e-8, contact_gradient="code"
    )
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    rng = np.random.default_rng(3)
    q0 = model.joint_q.numpy()
    x, y, z, w = q0[3:] / np.linalg.norm(q0[3:])
    up = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    q0[2] = np.abs(up) @ [0.1, 0.15, 0.08] - depth  # the lowest corner is so deep
    qd0 = rng.normal(size=6).astype(np.float32)
    qd0[2] = -1.0
    weight = rng.normal(size=7).astype(np.float32)

    def run(q: np.ndarray, qd: np.ndarray, record: bool = False):
        state, after = model.state(requires_grad=True), model.state()
        state.joint_q.assign(q.astype(np.float32))
        state.joint_qd.assign(qd.astype(np.float32))
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        pipeline.collide(state, contacts)
        if not record:
            solver.step(state, after, None, contacts, 2e-3)
            return float(after.joint_q.numpy().astype(float) @ weight)
        with nova.Tape() as tape:
            solver.step(state, after, None, contacts, 2e-3)
            loss = nova.sum(diff.state_joint_q_tensor(after) * nova.tensor(weight))
            tape.backward(loss)
        one = rng.normal(size=7).astype(np.float32)
        turned = q[3:].astype(np.float32)
        one[3:] -= (one[3:] @ turned) / (turned @ turned) * turned  # tangent to the unit sphere
        along = tape.jvp([loss], [diff.state_joint_q_tensor(state)], [nova.tensor(one)])
        return state.joint_q.grad.numpy(), state.joint_qd.grad.numpy(), one, float(along[0].item())

    by_q, by_qd, one, along = run(q0, qd0, record=True)
    assert along == pytest.approx(float(by_q @ one), rel=1e-3, abs=1e-4)
    eps = 1e-4
    for k in range(3):
        step = eps * np.eye(7)[k]
        by = (run(q0 + step, qd0) - run(q0 - step, qd0)) / (2 * eps)
        assert by_q[k] == pytest.approx(by, abs=2e-2 * float(np.abs(by_q).max()))
    for k in range(6):
        step = 0.05 * np.eye(6)[k]
        by = (run(q0, qd0 + step) - run(q0, qd0 - step)) / 0.1
        assert by_qd[k] == pytest.approx(by, abs=2e-2 * float(np.abs(by_qd).max()))


def low_arm(lower: float) -> novaphy.ModelBuilder:
    """Two links on hinges, whose end is 1 cm in the ground; `lower` (rad): of the second one.

    Angles grow downwards.
    """
    builder = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(mu=0.5, density=0.0)
    builder.add_ground_plane(cfg=surface)
    links = [builder.add_link(mass=m, inertia=np.eye(3) * 0.01 * m) for m in (5.0, 1.0)]
    base, elbow = ((0.0, 0.0, 0.1), UPRIGHT), ((0.4, 0.0, 0.0), UPRIGHT)
    joints = [
        builder.add_joint_revolute(-1, links[0], axis=(0, 1, 0), parent_xform=base),
        builder.add_joint_revolute(
            links[0], links[1], axis=(0, 1, 0), parent_xform=elbow, limit_lower=lower
        ),
    ]
    builder.add_articulation(joints)
    builder.add_shape_sphere(links[1], radius=0.11, xform=((0.3, 0.0, 0.0), UPRIGHT), cfg=surface)
    return builder


def test_overlaps_shift_no_joint_out_of_its_limits() -> None:
    scene = Scene(low_arm(-1e-4), pgs_slop=0.0)
    strongest = 0.0
    for _ in range(200):
        scene.step(2e-3)
        strongest = max(strongest, scene.force())
        assert scene.state.joint_q.numpy()[1] > -2e-3
    assert strongest < 10.0 * 6.0 * GRAVITY  # N


@needs_diff
@pytest.mark.parametrize("lower", [-1e-4, -1e-3, -3.0])
def test_gradients_of_shifts_at_limits_are_those_of_differences(lower: float) -> None:
    from novaphy import diff, nova

    model = low_arm(lower).finalize(requires_grad=True)
    model.joint_limit_lower.requires_grad = True
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_slop=0.0, pgs_tolerance=1e-8, contact_gradient="code"
    )
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    weight = np.float32([1.0, -0.7])

    def run(q: np.ndarray, tape: object = None) -> tuple[object, object]:
        state, after = model.state(requires_grad=True), model.state()
        state.joint_q.assign(q.astype(np.float32))
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
        pipeline.collide(state, contacts)
        if tape is None:
            solver.step(state, after, None, contacts, 2e-3)
            return after.joint_q.numpy().astype(float), None
        with tape:
            solver.step(state, after, None, contacts, 2e-3)
            return state, nova.sum(diff.state_joint_q_tensor(after) * nova.tensor(weight))

    tape = nova.Tape()
    state, loss = run(np.zeros(2), tape)
    tape.backward(loss)
    moved, _ = run(np.zeros(2))
    stops = lower == -1e-3  # the rates go to -2e-4, the shift without limits to -6e-3
    assert moved[1] == pytest.approx({-1e-4: -2.1e-4, -1e-3: -1e-3, -3.0: -5.6e-3}[lower], rel=0.02)
    by_limit = model.joint_limit_lower.grad.numpy()[1]
    assert by_limit == pytest.approx(float(weight[1]), rel=1e-5) if stops else by_limit == 0.0
    for k, eps in enumerate((1e-3, 2e-5)):
        one = np.eye(2)[k]
        by = float((run(eps * one)[0] - run(-eps * one)[0]) @ weight) / (2 * eps)
        along = tape.jvp([loss], [diff.state_joint_q_tensor(state)], [nova.tensor(np.float32(one))])
        assert along[0].item() == pytest.approx(state.joint_q.grad.numpy()[k], rel=1e-4)
        assert along[0].item() == pytest.approx(by, rel=1e-2)


@needs_diff
def test_shifts_do_not_change_when_all_masses_grow_alike() -> None:
    from novaphy import diff, nova

    model = low_arm(-3.0).finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, pgs_slop=0.0, pgs_tolerance=1e-8, contact_gradient="code"
    )
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    pipeline.collide(state, contacts)
    model.body_mass.requires_grad = model.body_inertia.requires_grad = True
    leaves = [diff.model_body_mass_tensor(model), diff.model_body_inertia_tensor(model)]
    with nova.Tape() as tape:
        solver.step(state, after, None, contacts, 2e-3)
        loss = nova.sum(diff.state_joint_q_tensor(after))
    tape.backward(loss)
    shift = float(np.abs(after.joint_q.numpy()).max())
    parts = [
        a.numpy().astype(float) * a.grad.numpy() for a in (model.body_mass, model.body_inertia)
    ]
    assert shift > 1e-3 and np.abs(parts[0]).max() > 1e-2 * shift
    assert abs(parts[0].sum() + parts[1].sum()) < 1e-4 * shift
    alike = [nova.tensor(a.numpy()) for a in (model.body_mass, model.body_inertia)]
    along = tape.jvp([loss], leaves, alike)
    assert abs(float(along[0].item())) < 1e-4 * shift
