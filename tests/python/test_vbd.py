"""SolverVBD and the colours of builders and models."""

from __future__ import annotations

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


def test_colours_are_arrays_and_groups_and_survive_a_pickle():
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
    with pytest.raises(ValueError, match="expected particles of different colours"):
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
    assert solver.held_count == len(held) == 7
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
    with pytest.raises(TypeError, match="rigid_avbd_alpha"):
        solver_of(builder, rigid_avbd_alpha=0.9)
    with pytest.raises(ValueError, match=r"call ModelBuilder.color\(\)"):
        novaphy.solvers.SolverVBD(cloth().finalize())
    with pytest.raises(NotImplementedError, match="drag"):
        solver_of(cloth(tri_drag=1.0))


def test_a_step_on_a_tape_raises():
    nova = pytest.importorskip("novaphy.nova")
    solver = solver_of(cloth())
    state, after = solver.model.state(requires_grad=True), solver.model.state()
    with nova.Tape(), pytest.raises(novaphy.Error, match=r"SolverVBD\.step"):
        solver.step(state, after, None, None, 1 / 60)


@pytest.mark.parametrize("scene", ["hanging", "draped", "twisted", "crushed"])
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


def test_a_crushed_block_recovers():
    done = subprocess.run(
        [sys.executable, str(DEMO), "crushed", "--headless", "150"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr
