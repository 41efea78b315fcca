"""Every array of a model acts on a step of bodies on penalty joints, or other than its default it
raises: the edits are those of test_articulation_fields."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from test_articulation_fields import (
    ACT,
    DERIVED,
    PENALTY,
    RAISE,
    SHAPES,
    STRUCTURE,
    scaled,
    scene,
)

import novaphy

HAVE_NONE = {
    "joint_armature",
    "joint_friction",
    "joint_velocity_limit",
    "shape_material_restitution",
    "shape_material_mu_torsional",
    "shape_material_mu_rolling",
    "joint_act",
    "body_gravcomp",
    "fluid_density",
    "fluid_viscosity",
}
# Arrays of the search only. The gap adds rows of shapes that do not overlap, which have no force.
OF_THE_SEARCH = {"shape_gap"}
# Arrays of "pgs" contacts only. The penalty law takes the mean of two materials.
OF_TREES = {"shape_mixing"}
OF_ACTUATORS = ("actuator_", "act", "ctrl")  # without rows, because actuators are refused
OF_FLUIDS = ("fluid_wind", "body_fluid_")  # without effect where no fluid is
EDITS = {
    name: edit
    for name, edit in {
        **ACT,
        **RAISE,
        **{name: scaled(name, SHAPES) for name in PENALTY},
    }.items()
    if not name.startswith((*OF_ACTUATORS, *OF_FLUIDS))
}
ACTS = sorted(set(EDITS) - HAVE_NONE - OF_THE_SEARCH - OF_TREES)


def run(edit: Callable[[novaphy.Model], None]) -> np.ndarray:
    """All poses and velocities of a run, after an edit of the model."""
    model = scene(actuators=False).finalize()
    edit(model)
    solver = novaphy.solvers.SolverSemiImplicit(model)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    numbers = []
    for _ in range(300):
        state.clear_forces()
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, 1 / 4800)
        state, after = after, state
        numbers += [state.body_q.numpy().ravel(), state.body_qd.numpy().ravel()]
    return np.concatenate(numbers)


def test_the_table_has_every_array_of_joints_shapes_and_bodies() -> None:
    model = scene(actuators=False).finalize()
    arrays = {name for name in dir(model) if isinstance(getattr(model, name), novaphy.DeviceArray)}
    others = (
        "particle_",
        "spring_",
        "edge_",
        "tri_",
        "tet_",
        "articulation_",
        "mesh_",
        *OF_ACTUATORS,
        *OF_FLUIDS,
    )
    for name in sorted(arrays):
        if name.startswith(others):
            continue
        kinds = [
            name in ACTS,
            name in HAVE_NONE,
            name in OF_THE_SEARCH,
            name in OF_TREES,
            name in DERIVED or "_aabb_" in name,
            name in STRUCTURE,
        ]
        assert sum(kinds) == 1, name
    assert arrays >= set(EDITS)


@pytest.fixture(scope="module")
def base() -> np.ndarray:
    numbers = run(lambda model: None)
    assert np.isfinite(numbers).all()
    return numbers


@pytest.mark.parametrize("name", ACTS)
def test_an_edited_array_acts(name: str, base: np.ndarray) -> None:
    assert not np.array_equal(run(EDITS[name]), base)


@pytest.mark.parametrize("name", sorted(HAVE_NONE))
def test_a_value_without_effect_raises(name: str) -> None:
    with pytest.raises((NotImplementedError, ValueError), match=name):
        run(EDITS[name])


@pytest.mark.parametrize("solver", ["SolverSemiImplicit", "DiffSemiImplicitSolver"])
def test_actuators_of_a_control_raise_behind_the_first_step(solver: str) -> None:
    if solver.startswith("Diff") and not novaphy.has_diff():
        pytest.skip("needs NOVAPHY_WITH_DIFF")
    builder = novaphy.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=np.eye(3))
    builder.add_articulation([builder.add_joint_revolute(-1, link)])
    model = builder.finalize()
    options = {}
    if solver.startswith("Diff"):
        options["config"] = novaphy.solvers.DiffSolverConfig(enable_joints=True)
    made = getattr(novaphy.solvers, solver)(model, **options)
    state, after, control = model.state(), model.state(), model.control()
    made.step(state, after, control, None, 1e-4)
    control.joint_act.fill_(0.5)
    with pytest.raises(NotImplementedError, match=rf"{solver}.*: joint_act\[0\]: expected 0"):
        made.step(state, after, control, None, 1e-4)
