"""SolverVBD and the colors of builders and models."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_vbd(), reason="built with NOVAPHY_BUILD_VBD=OFF")
DEMO = Path(__file__).parents[2] / "python" / "demos" / "demo_vbd.py"


def cloth(**options):
    builder = novaphy.ModelBuilder()
    builder.add_cloth_grid(
        pos=(0, 0, 1), dim_x=6, dim_y=6, cell_x=0.1, cell_y=0.1, mass=0.01, fix_left=True, **options
    )
    return builder


def solver_of(builder, **options):
    builder.color()
    return novaphy.solvers.SolverVBD(builder.finalize(), **options)


def test_colors_are_arrays_and_groups_and_survive_a_pickle():
    import pickle

    builder = cloth()
    builder.color()
    model = builder.finalize()
    groups = model.particle_color_groups
    colors = model.particle_colors.numpy()
    assert all(group.dtype == np.int32 for group in groups)
    assert sorted(np.concatenate(groups)) == list(range(model.particle_count))
    for color, group in enumerate(groups):
        assert (colors[group] == color).all() and (np.diff(group) > 0).all()
    again = pickle.loads(pickle.dumps(model))
    assert (again.particle_colors.numpy() == colors).all()
    builder.set_coloring(groups)
    assert (builder.finalize().particle_colors.numpy() == colors).all()
    with pytest.raises(ValueError, match="groups: expected every particle once"):
        builder.set_coloring(groups[:-1])
    with pytest.raises(ValueError, match="expected particles of different colors"):
        builder.set_coloring([np.concatenate(groups)])
    builder.set_coloring([np.concatenate(groups)], allow_conflicts=True)
    assert novaphy.ModelBuilder().finalize().particle_color_groups == []


def test_a_step_leaves_its_input_and_tells_its_residual():
    solver = solver_of(cloth(), iterations=30)
    state, after = solver.model.state(), solver.model.state()
    state.particle_f.assign(np.full((49, 3), 0.01, np.float32))
    with pytest.raises(novaphy.Error, match="expected a step before"):
        solver.residual()
    before = state.particle_q.numpy().copy()
    solver.step(state, after, None, None, 1 / 120)
    assert (state.particle_q.numpy() == before).all()
    assert (state.particle_f.numpy() == np.float32(0.01)).all()
    residual = solver.residual()
    assert residual.iterations == 30 and 0 < residual.floor < residual.relative < 1
    assert residual.force == pytest.approx(residual.relative * residual.scale)
    solver.reset()
    with pytest.raises(novaphy.Error, match="expected a step before"):
        solver.residual()


def test_held_particles_go_where_targets_say():
    solver = solver_of(cloth())
    state, after = solver.model.state(), solver.model.state()
    held = np.flatnonzero(solver.model.particle_mass.numpy() == 0)
    assert solver.kinematic_count == len(held) == 7
    with pytest.warns(DeprecationWarning, match="held_count is now called kinematic_count"):
        assert solver.held_count == 7
    targets = state.particle_q.numpy()[held] + np.float32(0.01)
    solver.step(state, after, None, None, 1 / 60, targets=targets)
    assert (after.particle_q.numpy()[held] == targets).all()
    assert after.particle_qd.numpy()[held] == pytest.approx(0.6, abs=1e-4)
    with pytest.raises(ValueError, match="targets"):
        solver.step(state, after, None, None, 1 / 60, targets=targets[:3])


def test_options_are_kept_and_bad_ones_are_refused():
    builder = cloth()
    solver = solver_of(
        builder, iterations=3, initial_guess="adaptive", acceleration=0.5, tolerance=1e-3
    )
    assert (solver.iterations, solver.initial_guess) == (3, "adaptive")
    assert (solver.acceleration, solver.safeguard) == (0.5, False)
    assert solver.tolerance == pytest.approx(1e-3)
    for options, text in (
        ({"iterations": -1}, "iterations"),
        ({"initial_guess": "best"}, "initial_guess"),
        ({"acceleration": 2.0}, "acceleration"),
        ({"friction_epsilon": float("nan")}, "friction_epsilon"),
    ):
        with pytest.raises(ValueError, match=text):
            solver_of(builder, **options)
    for name, instead in (
        ("rigid_avbd_alpha", "0.95"),
        ("rigid_body_particle_contact_buffer_size", "any number"),
        ("particle_topological_contact_filter_threshold", "common particle"),
        ("integrate_with_external_rigid_solver", "is_kinematic"),
    ):
        with pytest.raises(TypeError, match=f"'{name}'; use .*{instead}"):
            solver_of(builder, **{name: 1})
    with pytest.raises(ValueError, match=r"call ModelBuilder.color\(\)"):
        novaphy.solvers.SolverVBD(cloth().finalize())
    with pytest.raises(NotImplementedError, match="drag"):
        solver_of(cloth(tri_drag=1.0))


@pytest.mark.parametrize("name", ["particle_q", "particle_tri_material", "particle_tri_activation"])
def test_a_step_on_a_tape_names_what_carries_a_gradient(name):
    nova = pytest.importorskip("novaphy.nova")
    solver = solver_of(cloth())
    model = solver.model
    state, after = model.state(), model.state()
    array = state.particle_q if name == "particle_q" else getattr(model, name)
    array.requires_grad = True
    with nova.Tape(), pytest.raises(novaphy.Error, match=f"{name}: it carries a gradient"):
        solver.step(state, after, None, None, 1 / 60)
    array.requires_grad = False
    with nova.Tape():
        solver.step(state, after, None, None, 1 / 60)


def test_a_captured_step_replays_the_bits_of_direct_ones():
    nova = pytest.importorskip("novaphy.nova")
    solver = solver_of(cloth(), iterations=6)
    model = solver.model
    held = model.particle_q.numpy()[model.particle_mass.numpy() == 0]
    assert len(held) == solver.kinematic_count > 0
    # A row of targets for each of four steps.
    targets = [novaphy.DeviceArray(held + np.float32(0.01 * k), novaphy.vec3) for k in range(4)]
    direct, captured = ([model.state(), model.state()] for _ in range(2))
    for k in range(4):
        solver.step(direct[k % 2], direct[1 - k % 2], None, None, 1 / 60, targets=targets[k])
    with nova.ScopedCapture() as capture:
        for k in range(4):
            states = captured[k % 2], captured[1 - k % 2]
            solver.step(*states, None, None, 1 / 60, targets=targets[k])
    capture.graph.launch()
    assert (captured[0].particle_q.numpy() == direct[0].particle_q.numpy()).all()
    assert (captured[0].particle_qd.numpy() == direct[0].particle_qd.numpy()).all()
    model.particle_tri_material.assign(2 * model.particle_tri_material.numpy())
    with pytest.raises(novaphy.Error, match="modified after the capture"):
        capture.graph.launch()


def test_numbers_that_are_not_finite_are_named():
    solver = solver_of(cloth())
    model = solver.model
    before = model.state().particle_q.numpy()

    for name in ("particle_q", "particle_qd", "particle_f"):
        state, after = model.state(), model.state()
        array = getattr(state, name)
        values = array.numpy().copy()
        values[20, 1] = np.nan
        array.assign(values)
        with pytest.raises(ValueError, match=rf"state_in.{name}\[20\]: expected finite"):
            solver.step(state, after, None, None, 1 / 60)
        assert (after.particle_q.numpy() == before).all()
    state = model.state()
    huge = state.particle_qd.numpy().copy()
    huge[20] = 3e38
    state.particle_qd.assign(huge)
    with pytest.raises(ValueError, match="the inertial target of a particle overflows"):
        solver.step(state, model.state(), None, None, 1e3)
    for name in ("particle_mass", "particle_tri_pose", "particle_tri_area"):
        array = getattr(model, name)
        good = array.numpy().copy()
        values = good.copy()
        values.reshape(-1)[-1] = np.inf
        array.assign(values)
        with pytest.raises(ValueError, match=f"model.{name}"):
            solver.step(model.state(), model.state(), None, None, 1 / 60)
        array.assign(good)
    solver.step(model.state(), model.state(), None, None, 1 / 60)


def test_a_replay_notes_what_is_not_finite_and_the_next_call_names_it():
    nova = pytest.importorskip("novaphy.nova")
    builder = cloth()
    builder.add_ground_plane(height=1.0)
    solver = solver_of(builder)
    model = solver.model
    state, after = model.state(), model.state()
    pipeline = novaphy.CollisionPipeline(model, soft_contact_max=3)
    contacts = pipeline.contacts()
    with nova.ScopedCapture() as capture:
        solver.step(state, after, None, None, 1 / 60)
    good = state.particle_qd.numpy().copy()
    bad = good.copy()
    bad[20, 2] = np.inf
    for ask in (solver.residual, lambda: solver.step(state, after, None, None, 1 / 60)):
        state.particle_qd.assign(bad)
        for _ in range(2):
            capture.graph.launch()
        state.particle_qd.assign(good)
        with pytest.raises(novaphy.Error, match=r"particle 20: state_in\.particle_qd: expected"):
            ask()
        capture.graph.launch()
        assert np.isfinite(solver.residual().relative)
    with nova.ScopedCapture() as capture:
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, 1 / 60)
    capture.graph.launch()
    with pytest.raises(novaphy.Error, match=r"contacts: \d+ were found, but there are slots for 3"):
        solver.residual()


@pytest.mark.parametrize("scene", ["hanging", "draped", "twisted", "crushed", "net"])
def test_the_demos_run(scene, tmp_path):
    states = tmp_path / "states.npz"
    done = subprocess.run(
        [sys.executable, str(DEMO), scene, "--headless", "3", "--dump-states", str(states)],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr
    q = np.load(states)["particle_q"]
    assert len(q) == 4 and np.isfinite(q).all()


def run_gradient_demo(name, *options):
    pytest.importorskip("novaphy.diff")
    script = DEMO.parent / "diff" / f"demo_diffsim_{name}.py"
    done = subprocess.run(
        [sys.executable, str(script), *options], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr


def test_the_stiffness_of_a_cloth_is_found():
    run_gradient_demo("vbd_cloth", "--headless", "6")


def test_a_gripper_holds_what_it_dropped(tmp_path):
    states = tmp_path / "states.npz"
    run_gradient_demo("vbd_gripper", "--headless", "5", "--dump-states", str(states))
    loss = np.load(states)["loss"]
    assert loss[0] > 0.1 and loss[-1] < 1e-3


@pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")
@pytest.mark.parametrize("scene", ["hanging", "draped", "twisted", "crushed", "net"])
def test_gradients_of_the_scenes_are_those_of_differences(scene):
    done = subprocess.run(
        [sys.executable, str(DEMO), scene, "--headless", "20", "--check-grad"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0 and ", by differences" in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize("scene", [pytest.param("crushed", marks=pytest.mark.slow), "net"])
def test_a_crushed_block_recovers_and_a_net_catches(scene):
    done = subprocess.run(
        [sys.executable, str(DEMO), scene, "--headless", "150"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr


def loss_of(state, weights):
    from novaphy import diff, nova

    return nova.sum(diff.state_particle_q_tensor(state) * nova.tensor(weights))


def diff_solver(builder, **options):
    pytest.importorskip("novaphy.diff")
    builder.color()
    return novaphy.solvers.DiffSolverVBD(builder.finalize(), **options)


def test_the_differentiable_step_has_the_bits_of_the_plain_one():
    solver = diff_solver(cloth(), iterations=7)
    plain = novaphy.solvers.SolverVBD(solver.model, iterations=7)
    state = solver.model.state()
    one, other = solver.model.state(), solver.model.state()
    plain.step(state, one, None, None, 1 / 60)
    solver.step(state, other, None, None, 1 / 60)
    assert (one.particle_q.numpy() == other.particle_q.numpy()).all()
    assert (one.particle_qd.numpy() == other.particle_qd.numpy()).all()
    with pytest.raises(novaphy.Error, match="expected a backward before"):
        solver.gradient_info()
    with pytest.raises(ValueError, match="gradient: expected"):
        novaphy.solvers.DiffSolverVBD(solver.model, gradient="frozen")
    with pytest.raises(ValueError, match="gradient_tolerance: expected none"):
        novaphy.solvers.DiffSolverVBD(solver.model, gradient_tolerance=1e-3)


@pytest.mark.parametrize("interval", [1, 3])
def test_gradients_of_a_rollout_are_those_of_differences(interval):
    nova = pytest.importorskip("novaphy.nova")
    diff = pytest.importorskip("novaphy.diff")
    builder = cloth(tri_ke=50.0, tri_ka=50.0, tri_kd=0.01, edge_ke=0.05, edge_kd=1e-4)
    solver = diff_solver(builder, iterations=5)
    model = solver.model
    steps, rng = 8, np.random.default_rng(3)
    weights = rng.normal(size=(49, 3)).astype(np.float32)
    trajectory = diff.Trajectory(model, steps, checkpoint=interval)
    model.tri_materials.requires_grad = True

    def run():
        solver.rollout(trajectory, None, None, 1 / 60)
        return loss_of(trajectory[steps], weights)

    def value():  # in double precision, for differences
        run()
        return float((trajectory[steps].particle_q.numpy().astype(np.float64) * weights).sum())

    with nova.Tape() as tape:
        loss = run()
    tape.backward(loss)
    info = solver.gradient_info()
    assert (
        info.label == "exact of the code"
        and info.primal.iterations == 5
        and info.primal.relative > 0
    )
    by_velocity = trajectory[0].particle_qd.grad.numpy().copy()
    by_material = model.tri_materials.grad.numpy().copy()
    model.tri_materials.requires_grad = False
    assert (by_material[:, 3:] == 0).all()

    velocity = trajectory[0].particle_qd.numpy().copy()
    direction = rng.normal(size=velocity.shape).astype(np.float32)
    found = []
    for sign in (1, -1):
        trajectory[0].particle_qd.assign(velocity + np.float32(sign * 5e-3) * direction)
        found.append(value())
    trajectory[0].particle_qd.assign(velocity)
    expected = float((by_velocity * direction).sum())
    assert (found[0] - found[1]) / 1e-2 == pytest.approx(expected, rel=1e-2)

    material = model.tri_materials.numpy().copy()
    change = np.zeros_like(material)
    change[:, :2] = rng.uniform(0.5, 1.5, (len(material), 2))
    found = []
    for sign in (1, -1):
        model.tri_materials.assign(material + np.float32(4 * sign) * change)
        found.append(value())
    model.tri_materials.assign(material)
    expected = float((by_material * change).sum())
    assert (found[0] - found[1]) / 8 == pytest.approx(expected, rel=1e-2)


def test_the_adaptive_guess_is_carried_from_step_to_step():
    nova = pytest.importorskip("novaphy.nova")
    diff = pytest.importorskip("novaphy.diff")
    options = {"iterations": 2, "initial_guess": "adaptive"}
    solver = diff_solver(cloth(tri_ke=50.0, tri_ka=50.0, tri_kd=0.01), **options)
    model, steps = solver.model, 7
    rng = np.random.default_rng(5)
    weights = rng.normal(size=(49, 3)).astype(np.float32)
    speed = np.float32(0.1) * rng.normal(size=(49, 3)).astype(np.float32)

    def rolled(checkpoint, parts=((0, None),), begin=solver.reset):
        trajectory = diff.Trajectory(model, steps, checkpoint=checkpoint)
        trajectory[0].particle_qd.assign(speed)
        begin()
        with nova.Tape() as tape:
            for start, stop in parts:
                solver.rollout(trajectory, None, None, 1 / 60, start=start, stop=stop)
            loss = loss_of(trajectory[steps], weights)
        tape.backward(loss)
        return trajectory, trajectory[0].particle_qd.grad.numpy().copy()

    trajectory, gradient = rolled(1)
    last = trajectory[steps].particle_q.numpy().copy()
    # Steps of SolverVBD, which carries the velocity too, give the same states.
    plain = novaphy.solvers.SolverVBD(model, **options)
    states = [model.state(), model.state()]
    states[0].particle_qd.assign(speed)
    for _ in range(steps):
        plain.step(states[0], states[1], None, None, 1 / 60)
        states.reverse()
    assert (states[0].particle_q.numpy() == last).all()
    # Checkpoints keep the velocity, and a rollout continues where the one before ended.
    for other in (rolled(3), rolled(1, ((0, 3), (3, None))), rolled(3, ((0, 3), (3, None)))):
        assert (other[0][steps].particle_q.numpy() == last).all()
        assert (other[1] == gradient).all()
    kept, _ = rolled(3)
    for t in (1, 2, 4, 5):
        again = kept.recompute(t)
        assert (again.particle_q.numpy() == trajectory[t].particle_q.numpy()).all()
    unrecorded = diff.Trajectory(model, steps, checkpoint=3)
    unrecorded[0].particle_qd.assign(speed)
    solver.reset()
    solver.rollout(unrecorded, None, None, 1 / 60)
    assert (unrecorded[steps].particle_q.numpy() == last).all()
    assert (unrecorded.recompute(5).particle_q.numpy() == trajectory[5].particle_q.numpy()).all()
    # Without reset() the guess of the first step uses the velocity from before.
    assert (rolled(1, begin=lambda: None)[0][steps].particle_q.numpy() != last).any()

    direction = rng.normal(size=(49, 3)).astype(np.float32)
    values = []
    for sign in (1, -1):
        moved = diff.Trajectory(model, steps)
        moved[0].particle_qd.assign(speed + np.float32(sign * 1e-3) * direction)
        solver.reset()
        solver.rollout(moved, None, None, 1 / 60)
        q = moved[steps].particle_q.numpy().astype(np.float64)
        values.append(float((q * weights).sum()))
    expected = float((gradient * direction).sum())
    assert (values[0] - values[1]) / 2e-3 == pytest.approx(expected, rel=1e-2)

    trajectory[0].particle_qd.assign(speed)
    solver.reset()
    qd = diff.state_particle_qd_tensor(trajectory[0], True)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, 1 / 60)
        loss = loss_of(trajectory[steps], weights)
    (slope,) = tape.jvp([loss], [qd], [nova.tensor(direction)])
    assert float(slope.numpy().sum()) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
def test_friction_acts_on_what_begins_at_rest(gradient):
    diff = pytest.importorskip("novaphy.diff")
    from novaphy import nova

    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(mu=0.5, ke=2e3, kd=0.0))
    builder.add_particle((0, 0, 0.0195), (0, 0, 0), 0.1, radius=0.02)
    builder.color()
    model = builder.finalize()
    model.soft_contact_kd = 0.0
    model.soft_contact_ke = 2e3
    solver = novaphy.solvers.DiffSolverVBD(model, iterations=20, gradient=gradient)
    trajectory = diff.Trajectory(model, 1)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(trajectory[0], contacts)
    velocity = diff.state_particle_qd_tensor(trajectory[0], requires_grad=True)

    def end(vx):
        velocity.assign([[vx, 0.0, 0.0]])
        solver.rollout(trajectory, None, contacts, 0.01)
        return diff.state_particle_q_tensor(trajectory[1])

    difference = (end(1e-3).numpy()[0, 0] - end(-1e-3).numpy()[0, 0]) / 2e-3
    with nova.Tape() as tape:
        tape.backward(nova.sum(end(0.0)[:, 0]))
    slope = velocity.grad.numpy()[0, 0]
    assert slope == pytest.approx(difference, rel=0.02)
    assert slope < 0.2 * 0.01  # a fifth of the way without friction


def test_checkpoints_keep_the_velocity_of_the_adaptive_guess():
    """States between them are those of the rollout, and the solver goes on as if nobody asked."""
    diff = pytest.importorskip("novaphy.diff")
    builder = cloth(tri_ke=50.0, tri_ka=50.0, tri_kd=0.01, edge_ke=0.05, edge_kd=1e-4)
    builder.color()
    model = builder.finalize()

    def run(interval, ask):
        solver = novaphy.solvers.SolverVBD(model, iterations=2, initial_guess="adaptive")
        found = []
        for _ in range(2):  # the second begins with the velocity that the first one left
            trajectory = diff.Trajectory(model, 7, checkpoint=interval)
            solver.rollout(trajectory, None, None, 1 / 60)
            if interval == 1:
                found += [trajectory[t].particle_q.numpy() for t in range(8)]
            else:
                found += [trajectory.recompute(t).particle_q.numpy() for t in range(ask)]
        return found

    expected = run(1, 0)
    for t, (one, other) in enumerate(zip(expected, run(3, 8), strict=True)):
        assert (one == other).all(), t
    assert not (expected[7] == expected[15]).all()


def test_contacts_of_every_step_are_kept_and_inputs_without_a_rule_raise():
    nova = pytest.importorskip("novaphy.nova")
    builder = cloth()
    builder.add_ground_plane(height=0.95)
    solver = diff_solver(builder)
    model = solver.model
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    states = [model.state(requires_grad=True)] + [model.state() for _ in range(12)]
    counts = []
    with nova.Tape() as tape:
        for before, after in zip(states, states[1:], strict=False):
            with nova.no_grad():
                pipeline.collide(before, contacts)
            counts.append(contacts.active_soft_contact_count)
            solver.step(before, after, None, contacts, 1 / 60)
        loss = loss_of(states[-1], np.ones((49, 3), np.float32))
    assert len(set(counts)) > 1
    tape.backward(loss)
    grad = states[0].particle_q.grad.numpy()
    assert np.isfinite(grad).all() and np.abs(grad).max() > 0.1


# Arrays of the model with a gradient. All others raise by name, except the initial positions and
# velocities, which steps do not read.
WITH_GRADIENT = {
    "gravity",
    "particle_mass",
    "particle_radius",
    "particle_spring_stiffness",
    "particle_spring_damping",
    "particle_spring_rest_length",
    "particle_tri_pose",
    "particle_tri_area",
    "particle_tri_material",
    "particle_tri_activation",
    "particle_edge_material",
    "particle_edge_rest_angle",
    "particle_edge_rest_length",
    "particle_tet_pose",
    "particle_tet_material",
    "particle_tet_activation",
    "shape_margin",
    "shape_material_ke",
    "shape_material_kd",
    "shape_material_mu",
}
NOT_READ = {"particle_q", "particle_qd"}


def everything():
    """A cloth, a block, a spring and the ground."""
    builder = cloth(tri_ke=50.0, tri_ka=50.0, tri_kd=0.01, edge_ke=0.05, edge_kd=1e-4)
    builder.add_soft_grid(
        pos=(0, 0, 0.2), dim_x=1, dim_y=1, dim_z=1, cell_x=0.1, cell_y=0.1, cell_z=0.1,
        density=100, k_mu=100, k_lambda=100, k_damp=0.1,
    )  # fmt: skip
    builder.add_spring(10, 50, 10.0, 0.1)
    builder.add_ground_plane()
    return builder


def test_every_array_of_the_model_has_a_gradient_or_raises_by_name():
    nova = pytest.importorskip("novaphy.nova")
    solver = diff_solver(everything(), iterations=2)
    model = solver.model
    names = [
        name
        for name in dir(model)
        if isinstance(getattr(model, name), novaphy.DeviceArray)
        and getattr(model, name).numpy().dtype == np.float32
        and getattr(model, name).numpy().size > 0
    ]
    # Some arrays also have Newton's name.
    seen, checked = {}, set()
    for name in names:
        array = getattr(model, name)
        try:
            array.requires_grad = True
            with nova.Tape() as tape:
                states = model.state(requires_grad=True), model.state()
                solver.step(*states, None, None, 1 / 60)
                loss = loss_of(states[1], np.ones((model.particle_count, 3), np.float32))
            tape.backward(loss)
            seen[name] = "gradient" if array.grad is not None else "none"
        except NotImplementedError as error:
            seen[name] = "raises"
            checked.add(str(error).split("model.")[1].split(":")[0])
        finally:
            array.requires_grad = False
    by_gradient = {name for name, found in seen.items() if found == "gradient"}
    assert by_gradient >= WITH_GRADIENT
    raised = {name for name, found in seen.items() if found == "raises"}
    assert {"shape_transform", "shape_scale", "particle_inv_mass"} <= raised
    assert {"particle_inv_mass", "shape_transform", "particle_tet_volume"} <= checked
    silent = {name for name, found in seen.items() if found == "none"}
    assert silent <= NOT_READ, silent


@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
def test_a_damping_of_zero_has_its_gradient(gradient):
    """Against differences to one side, of bent cloth and a block."""
    nova = pytest.importorskip("novaphy.nova")
    builder = cloth(tri_ke=50.0, tri_ka=50.0, tri_kd=0.0, edge_ke=0.05, edge_kd=0.0)
    builder.add_soft_grid(
        pos=(0, 0, 0.2), dim_x=1, dim_y=1, dim_z=1, cell_x=0.1, cell_y=0.1, cell_z=0.1,
        density=100, k_mu=100, k_lambda=100, k_damp=0.0,
    )  # fmt: skip
    solver = diff_solver(builder, iterations=60, gradient=gradient)
    model = solver.model
    rng = np.random.default_rng(4)
    bent = model.particle_q.numpy() + rng.normal(0, 5e-3, (model.particle_count, 3))
    speed = rng.normal(size=bent.shape).astype(np.float32)
    weights = rng.normal(size=bent.shape).astype(np.float32)

    def states(requires_grad=False):
        pair = model.state(requires_grad=requires_grad), model.state()
        pair[0].particle_q.assign(bent.astype(np.float32))
        pair[0].particle_qd.assign(speed)
        return pair

    for name, column, step in (
        ("particle_tri_material", 2, 2e-3),
        ("particle_edge_material", 1, 2e-5),
        ("particle_tet_material", 2, 2e-2),
    ):
        array = getattr(model, name)
        assert (array.numpy()[:, column] == 0).all()
        acts = (array.numpy() != 0).any(1)  # False: surface triangles of the block
        array.requires_grad = True
        before, after = states(True)
        with nova.Tape() as tape:
            solver.step(before, after, None, None, 1 / 60)
            loss = loss_of(after, weights)
        tape.backward(loss)
        found = array.grad.numpy()[:, column].astype(np.float64).sum()
        array.requires_grad = False
        values = []
        for k in range(3):
            numbers = array.numpy().copy()
            numbers[acts, column] = k * step
            array.assign(numbers)
            before, after = states()
            solver.step(before, after, None, None, 1 / 60)
            values.append((after.particle_q.numpy().astype(np.float64) * weights).sum())
        numbers[acts, column] = 0
        array.assign(numbers)
        expected = (4 * values[1] - values[2] - 3 * values[0]) / (2 * step)
        assert abs(found) > 0 and abs(found - expected) <= 2e-2 * abs(expected), (
            name,
            found,
            expected,
        )


def test_contacts_that_carry_a_gradient_raise_by_name():
    nova = pytest.importorskip("novaphy.nova")
    solver = diff_solver(everything(), iterations=2)
    model = solver.model
    contacts = novaphy.CollisionPipeline(model).contacts()
    contacts.soft_contact_normal.requires_grad = True
    states = model.state(requires_grad=True), model.state()
    with nova.Tape(), pytest.raises(NotImplementedError, match="contacts.soft_contact_normal"):
        solver.step(*states, None, contacts, 1 / 60)


@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
@pytest.mark.parametrize("interval", [1, 3])
def test_targets_move_held_particles_in_a_rollout_and_have_gradients(gradient, interval):
    nova = pytest.importorskip("novaphy.nova")
    diff = pytest.importorskip("novaphy.diff")
    builder = cloth(tri_ke=50.0, tri_ka=50.0, tri_kd=0.01, edge_ke=0.05, edge_kd=1e-4)
    solver = diff_solver(builder, iterations=8, gradient=gradient)
    model, steps = solver.model, 6
    held = model.particle_q.numpy()[model.particle_mass.numpy() == 0]
    rng = np.random.default_rng(5)
    weights = rng.normal(size=(49, 3)).astype(np.float32)
    path = held + np.cumsum(rng.normal(0, 4e-3, (steps, *held.shape)), 0).astype(np.float32)
    trajectory = diff.Trajectory(model, steps, checkpoint=interval)
    targets = nova.tensor(path, requires_grad=True)

    def value(at):
        targets.assign(at.astype(np.float32))
        solver.rollout(trajectory, None, None, 1 / 60, targets=targets)
        return float((trajectory[steps].particle_q.numpy().astype(np.float64) * weights).sum())

    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, 1 / 60, targets=targets)
        loss = loss_of(trajectory[steps], weights)
    tape.backward(loss)
    assert solver.gradient_info().label == (
        "exact of the code" if gradient == "unrolled" else "implicit"
    )
    grad = targets.grad.numpy()
    assert grad.shape == path.shape and (np.abs(grad).max((1, 2)) > 1e-3).all()
    end = trajectory[steps].particle_q.numpy()[model.particle_mass.numpy() == 0]
    assert (end == path[-1]).all()
    direction = rng.normal(size=path.shape)
    expected = (grad * direction).sum()
    found = (value(path + 1e-3 * direction) - value(path - 1e-3 * direction)) / 2e-3
    assert found == pytest.approx(expected, rel=1e-2)

    # The same places in every step, and step by step; the plain solver goes there too.
    plain = novaphy.solvers.SolverVBD(model, iterations=8)
    with pytest.raises(ValueError, match="targets"):
        solver.rollout(trajectory, None, None, 1 / 60, targets=nova.tensor(path[:2]))
    if gradient == "unrolled" and interval == 1:
        other = diff.Trajectory(model, steps)
        targets.assign(path)
        for each in (solver, plain):
            each.rollout(other if each is plain else trajectory, None, None, 1 / 60,
                         targets=targets)  # fmt: skip
        for t in range(steps + 1):
            assert (other[t].particle_q.numpy() == trajectory[t].particle_q.numpy()).all()
        state, after = model.state(), model.state()
        for t in range(steps):
            solver.step(state, after, None, None, 1 / 60, targets=path[t])
            state, after = after, state
        assert (state.particle_q.numpy() == trajectory[steps].particle_q.numpy()).all()
    semi_implicit = novaphy.solvers.SolverSemiImplicit(model)
    with pytest.raises(NotImplementedError, match="targets"):
        semi_implicit.rollout(trajectory, None, None, 1 / 600, targets=targets)


@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
def test_a_tape_has_the_forward_derivative_of_a_rollout(gradient):
    nova = pytest.importorskip("novaphy.nova")
    diff = pytest.importorskip("novaphy.diff")
    builder = cloth(tri_ke=50.0, tri_ka=50.0, tri_kd=0.01, edge_ke=0.05, edge_kd=1e-4)
    options = {} if gradient == "unrolled" else {"gradient_tolerance": 1e-6}
    solver = diff_solver(builder, iterations=8, gradient=gradient, **options)
    model, steps = solver.model, 3
    trajectory = diff.Trajectory(model, steps)
    rng = np.random.default_rng(8)
    weights = rng.normal(size=(49, 3)).astype(np.float32)
    material = diff.model_tri_material_tensor(model, requires_grad=True)
    velocity = diff.state_particle_qd_tensor(trajectory[0], requires_grad=True)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, 1 / 60)
        last = diff.state_particle_q_tensor(trajectory[steps])
        loss = nova.sum(last * nova.tensor(weights))
    directions = [np.zeros(material.shape, np.float32), rng.normal(size=(49, 3))]
    directions[0][:, :2] = rng.normal(size=(len(directions[0]), 2))
    directions = [nova.tensor(d.astype(np.float32)) for d in directions]
    (slope,) = tape.jvp([last], [material, velocity], directions)
    forwards = float((slope.numpy().astype(np.float64) * weights).sum())
    tape.backward(loss)
    backwards = sum(
        float((t.grad.numpy().astype(np.float64) * d.numpy()).sum())
        for t, d in zip((material, velocity), directions, strict=True)
    )
    scale = np.linalg.norm(slope.numpy()) * np.linalg.norm(weights)
    assert abs(forwards - backwards) < 1e-5 * scale


@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
def test_a_captured_forward_derivative_replays_direct_ones(gradient):
    nova = pytest.importorskip("novaphy.nova")
    diff = pytest.importorskip("novaphy.diff")
    solver = diff_solver(cloth(), iterations=6, gradient=gradient)
    trajectory = diff.Trajectory(solver.model, 2)
    velocity = nova.tensor(np.zeros((49, 3), np.float32), requires_grad=True)
    direction = nova.tensor(np.ones((49, 3), np.float32))

    def once():
        with nova.Tape() as tape:
            diff.state_particle_qd_tensor(trajectory[0]).copy_(velocity)
            solver.rollout(trajectory, None, None, 1 / 60)
            last = diff.state_particle_q_tensor(trajectory[2])
        return tape.jvp([last], [velocity], [direction])[0]

    at_rest = once().numpy().copy()
    with nova.ScopedCapture() as capture:
        slope = once()
    capture.graph.launch()
    assert np.abs(at_rest).max() > 0 and (slope.numpy() == at_rest).all()
    rng = np.random.default_rng(3)
    velocity.assign(rng.normal(size=(49, 3)).astype(np.float32))
    direction.assign(rng.normal(size=(49, 3)).astype(np.float32))
    capture.graph.launch()
    replayed = slope.numpy().copy()
    assert (replayed == once().numpy()).all() and not (replayed == at_rest).all()


def test_a_step_that_is_not_solved_is_an_error_unless_allowed():
    nova = pytest.importorskip("novaphy.nova")
    solver = diff_solver(cloth(), iterations=2, gradient="implicit", newton_iterations=0)
    states = solver.model.state(requires_grad=True), solver.model.state()
    with pytest.raises(novaphy.Error, match="the step was not solved"):
        solver.step(*states, None, None, 1 / 60)
    allowed = novaphy.solvers.DiffSolverVBD(
        solver.model, iterations=2, gradient="implicit", newton_iterations=0, allow_unconverged=True
    )
    with nova.Tape() as tape:
        allowed.step(*states, None, None, 1 / 60)
        loss = loss_of(states[1], np.ones((49, 3), np.float32))
    tape.backward(loss)
    info = allowed.gradient_info()
    assert info.label == "surrogate" and not info.converged
    assert info.residual == np.float32(info.primal.relative) > 1e-3
    assert info.linear_residual <= 1e-4 and info.linear_sweeps > 0


def test_the_label_is_that_of_the_worst_step():
    """Backward ends with the first step, which is solved: the cloth is at rest there."""
    nova = pytest.importorskip("novaphy.nova")
    model = diff_solver(cloth(), iterations=2, gradient="implicit").model
    model.gravity.assign(0 * model.gravity.numpy())
    solver = novaphy.solvers.DiffSolverVBD(
        model, iterations=2, gradient="implicit", newton_iterations=0, allow_unconverged=True
    )
    states = [model.state(requires_grad=True), model.state(), model.state()]
    force = np.random.default_rng(2).normal(size=(49, 3)).astype(np.float32)
    states[1].particle_f.assign(force)
    with nova.Tape() as tape:
        for before, after in itertools.pairwise(states):
            solver.step(before, after, None, None, 1 / 60)
        loss = loss_of(states[2], np.ones((49, 3), np.float32))
    tape.backward(loss)
    info = solver.gradient_info()
    assert info.converged and info.primal.relative < 1e-3  # of the first step
    for worst in (info, tape.gradient_info()):
        assert worst.label == "surrogate" and worst.residual > 1e-3
        assert worst.steps == 2 and worst.surrogate_steps == 1
        assert "the first is step 1" in worst.reason


def test_a_replay_names_the_first_step_that_was_not_solved():
    nova = pytest.importorskip("novaphy.nova")
    diff = pytest.importorskip("novaphy.diff")
    solver = diff_solver(cloth(), iterations=2, gradient="implicit", newton_iterations=0)
    model = solver.model
    # Without gravity the cloth is at rest, so the step is solved. With gravity the first step is
    # not.
    gravity = model.gravity.numpy().copy()
    model.gravity.assign(0 * gravity)
    force = np.zeros((3, model.particle_count, 3), np.float32)
    forces = nova.tensor(force, requires_grad=True)
    trajectory = diff.Trajectory(model, 3)
    with nova.ScopedCapture() as capture:
        with nova.Tape() as tape:
            solver.rollout(trajectory, None, None, 1 / 60, forces=forces)
            loss = loss_of(trajectory[3], np.ones((model.particle_count, 3), np.float32))
            tape.backward(loss)
    capture.graph.launch()
    solver.gradient_info()
    assert np.isfinite(trajectory[3].particle_q.numpy()).all()
    force[1] = (0.0, 0.0, -0.1)
    forces.assign(force)
    capture.graph.launch()
    assert np.isfinite(trajectory[1].particle_q.numpy()).all()
    assert np.isnan(trajectory[3].particle_q.numpy()).all() and np.isnan(forces.grad.numpy()).all()
    with pytest.raises(novaphy.Error, match="step 1 of the rollout: .*the step was not solved"):
        solver.gradient_info()
    with pytest.raises(novaphy.Error, match="step 1 of the rollout: .*the step was not solved"):
        solver.rollout(trajectory, None, None, 1 / 60, forces=forces)


def test_a_number_that_changed_after_recording_is_named():
    nova = pytest.importorskip("novaphy.nova")
    diff = pytest.importorskip("novaphy.diff")
    solver = diff_solver(cloth(), iterations=2)
    trajectory = diff.Trajectory(solver.model, 1)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, 1 / 60)
        loss = nova.sum(diff.state_particle_q_tensor(trajectory[1]))
    solver.model.soft_contact_ke *= 10
    with pytest.raises(novaphy.Error, match="soft_contact_ke was set to another value"):
        tape.backward(loss)


@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
def test_a_captured_rollout_replays_the_gradients_of_direct_ones(gradient):
    nova = pytest.importorskip("novaphy.nova")
    diff = pytest.importorskip("novaphy.diff")
    builder = cloth()
    builder.add_ground_plane(height=0.95)
    solver = diff_solver(builder, iterations=6, gradient=gradient)
    model = solver.model
    model.tri_materials.requires_grad = True
    held = model.particle_q.numpy()[model.particle_mass.numpy() == 0]
    rows = np.stack([held + np.float32(0.01 * k) for k in range(3)])
    targets = nova.tensor(rows, requires_grad=True)  # {steps, k, 3}
    velocity = nova.tensor(np.zeros((model.particle_count, 3), np.float32), requires_grad=True)
    weights = nova.tensor(
        np.random.default_rng(2).normal(size=(model.particle_count, 3)).astype(np.float32)
    )
    trajectory = diff.Trajectory(model, 3)
    pipeline = novaphy.CollisionPipeline(model)

    def once():
        with nova.Tape() as tape:
            diff.state_particle_qd_tensor(trajectory[0]).copy_(velocity)
            solver.rollout(trajectory, None, None, 1 / 60, targets=targets, pipeline=pipeline)
            loss = nova.sum(diff.state_particle_q_tensor(trajectory[3]) * weights)
            tape.backward(loss)
        return loss

    def results():
        grads = [velocity.grad, targets.grad, model.tri_materials.grad]
        values = [g.numpy().copy() for g in grads] + [trajectory[3].particle_q.numpy().copy()]
        for g in grads:
            g.zero_()
        return values

    once()
    at_rest = results()
    with nova.ScopedCapture() as capture:
        once()
    capture.graph.launch()
    for expected, found in zip(at_rest, results(), strict=True):
        assert np.abs(expected).max() > 0 and (expected == found).all()
    velocity.assign(np.full((model.particle_count, 3), (0.1, 0.2, -0.5), np.float32))
    once()
    moved = results()
    capture.graph.launch()
    for expected, found, before in zip(moved, results(), at_rest, strict=True):
        assert (expected == found).all() and not (expected == before).all()
    # A replay cannot raise. Its results are NaN, and the solver reports why.
    velocity.assign(np.full((model.particle_count, 3), np.nan, np.float32))
    capture.graph.launch()
    assert np.isnan(trajectory[3].particle_q.numpy()).all()
    with pytest.raises(novaphy.Error, match="a replay of a captured step failed.*finite"):
        solver.gradient_info()


def test_a_step_on_a_tape_refuses_a_state_that_wants_gradients():
    """They would stop there without a word."""
    nova = pytest.importorskip("novaphy.nova")
    solver = solver_of(cloth())
    state, after = solver.model.state(requires_grad=True), solver.model.state()
    with nova.Tape(), pytest.raises(novaphy.Error, match="state_in: expected requires_grad False"):
        solver.step(state, after, None, None, 1 / 60)
    with nova.Tape(), nova.no_grad():
        solver.step(state, after, None, None, 1 / 60)
    solver.step(state, after, None, None, 1 / 60)


@pytest.mark.parametrize("pressed", [1.0, 0.9])
def test_an_implicit_step_is_where_sweeps_converge_or_it_raises(pressed):
    builder = novaphy.ModelBuilder()
    builder.add_cloth_grid(
        dim_x=3, dim_y=3, cell_x=0.06, cell_y=0.06, mass=1e-3, fix_left=True,
        tri_ke=300.0, tri_ka=300.0, tri_kd=1e-2, edge_ke=5e-3, edge_kd=1e-4,
    )  # fmt: skip
    solver = diff_solver(builder, iterations=10, gradient="implicit")
    model, raised = solver.model, 0
    for seed in (0, 1, 2, 3, 4, 5, 6, 7):
        noise = np.random.default_rng(seed).normal(0, 0.004, (model.particle_count, 3))
        start, ends = model.state(), []
        start.particle_q.assign((model.particle_q.numpy() * pressed + noise).astype(np.float32))
        for guess in ("inertia", "previous"):
            ends.append(model.state())
            sweeps = novaphy.solvers.SolverVBD(model, iterations=2000, initial_guess=guess)
            sweeps.step(start, ends[-1], None, None, 1 / 120)
        converged, other = (end.particle_q.numpy() for end in ends)
        if np.abs(converged - other).max() > 1e-5:
            continue  # more than one minimum within reach
        end = model.state()
        try:
            solver.step(start, end, None, None, 1 / 120)
        except novaphy.Error as error:
            assert "the step was not solved" in str(error)
            raised += 1
            continue
        assert np.abs(end.particle_q.numpy() - converged).max() < 1e-4
    assert raised < 8
