"""Every row of the table of refusals in docs/coverage.md has a test."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from scenes import Ball, ball_model

import novaphy

nova = pytest.importorskip("novaphy.nova")
from novaphy import diff, solvers  # noqa: E402

HERE = Path(__file__).parent
TABLE = HERE.parents[1] / "docs" / "coverage.md"
DT = 1e-3


def neither_contacts_nor_a_pipeline() -> None:
    model = ball_model()
    solver = solvers.DiffSemiImplicitSolver(model)
    with pytest.raises(ValueError, match="enable_particle_contacts"):
        solver.step(model.state(), model.state(), None, None, DT)


def a_particle_of_all_worlds() -> None:
    one, builder = novaphy.ModelBuilder(), novaphy.ModelBuilder()
    one.add_particle((0, 0, 1), (0, 0, 0), 1.0)
    builder.replicate(one, 2)
    builder.add_particle((0, 0, 2), (0, 0, 0), 1.0)
    model = builder.finalize()
    with pytest.raises(NotImplementedError, match=r"particle_world\[2\]: particles of all worlds"):
        solvers.DiffSemiImplicitSolver(model)


def targets_without_kinematic_particles() -> None:
    model = ball_model()
    trajectory = diff.Trajectory(model, 1)
    with pytest.raises(NotImplementedError, match="targets: expected none"):
        solvers.SolverSemiImplicit(model).rollout(
            trajectory, None, None, DT, targets=nova.zeros((1, 3))
        )


def an_element_of_no_particle() -> None:
    builder = novaphy.ModelBuilder()
    for x in (0.0, 1.0):
        builder.add_particle((x, 0, 1), (0, 0, 0), 1.0)
    builder.add_spring(0, 1, 100.0, 0.0, 0)
    model = builder.finalize()
    model.particle_spring_indices[:] = [0, 7]
    with pytest.raises(IndexError, match=r"particle_spring_indices.*7"):
        solvers.SolverSemiImplicit(model).step(model.state(), model.state(), None, None, DT)


def a_step_in_a_capture() -> None:
    ball = Ball(steps=1)
    solver = solvers.SolverSemiImplicit(ball.model)
    assert not solver.supports_graph_capture
    with nova.ScopedCapture(), pytest.raises(novaphy.Error, match="[Cc]apture"):
        solver.step(*ball.states, None, ball.contacts, DT)


def forces_of_a_later_state() -> None:
    trajectory = diff.Trajectory(ball_model(), 2)
    with pytest.raises(novaphy.Error, match="forces"):
        trajectory[1].particle_f.assign([(1.0, 0.0, 0.0)])


def forces_that_a_step_left() -> None:
    ball = Ball(steps=1)
    a, b = ball.states
    with nova.Tape():
        ball.solver.step(a, b, None, ball.contacts, DT)
        with pytest.raises(novaphy.Error, match="clear it before it is used again"):
            ball.solver.step(a, b, None, ball.contacts, DT)


def a_view_of_bytes_with_another_gradient() -> None:
    model = ball_model()
    trajectory = diff.Trajectory(model, 2)
    trajectory[0].requires_grad = True
    solver = solvers.DiffSemiImplicitSolver(
        model, solvers.DiffSolverConfig(enable_particle_contacts=False)
    )
    with nova.Tape():
        solver.rollout(trajectory, None, None, DT)
        whole = nova.from_dlpack(trajectory.particle_q)
        with pytest.raises(novaphy.Error, match="belongs to another view"):
            nova.sum(whole)


def options_of_vbd_without_a_gradient() -> None:
    builder = novaphy.ModelBuilder()
    builder.add_particle((0, 0, 1), (0, 0, 0), 1.0)
    builder.color()
    model = builder.finalize()
    for option in ({"acceleration": 0.5}, {"safeguard": True}, {"tolerance": 1e-3}):
        with pytest.raises((NotImplementedError, TypeError), match=next(iter(option))):
            solvers.DiffSolverVBD(model, **option)


# The beginning of a row -> its test: one of this file, or the file and the name of another one.
TESTS: dict[str, Callable[[], None] | str] = {
    "a model whose springs": "test_elements.py::test_elements_that_would_be_left_out_are_refused",
    "a `Contacts` or a `pipeline` together": (
        "test_body_contacts.py::test_what_is_not_covered_is_named"
    ),
    "neither of them, under": neither_contacts_nor_a_pipeline,
    "joints that are not `FREE`": (
        "test_penalty_joint_gradients.py::test_what_is_not_covered_is_named"
    ),
    '`friction_law="newton17"`': (
        "test_sim.py::test_the_friction_law_of_a_differentiable_solver_is_checked"
    ),
    '`penalty_law="mean"` with': (
        "test_penalty_laws.py::test_what_is_not_supported_is_refused_by_name"
    ),
    "in `SolverSemiImplicit` and `DiffSemiImplicitSolver`: ropes": (
        "test_vbd_ropes.py::test_other_solvers_refuse_ropes_by_name"
    ),
    "`friction_smoothing` with": (
        "test_sim.py::test_the_friction_law_of_a_differentiable_solver_is_checked"
    ),
    "a setting of `DiffSemi": (
        "test_sim.py::test_the_friction_law_of_a_differentiable_solver_is_checked"
    ),
    "a step above the stable one": (
        "test_penalty_joint_gradients.py::test_what_is_not_covered_is_named"
    ),
    "rigid contacts found on another": (
        "test_bodies.py::test_a_recorded_sweep_refuses_meshes_by_name"
    ),
    "a particle, or on another device": a_particle_of_all_worlds,
    "a name that is not built": "test_package.py::test_a_planned_name_says_that_it_is_not_built",
    "in `add_urdf`": "test_urdf.py::test_a_mimic_is_refused_fixed_or_freed_if_asked",
    "in `add_mjcf`": "test_mjcf.py::test_bad_files_are_refused_and_the_builder_stays",
    "particles or bodies that would": (
        "test_static_bodies.py::test_parts_that_would_not_move_are_refused"
    ),
    "neither a `Contacts`, a": "test_body_contacts.py::test_what_is_not_covered_is_named",
    "a `pipeline` besides": "test_body_contacts.py::test_what_is_not_covered_is_named",
    "a `Contacts` with `per_contact": (
        "test_row_materials.py::test_where_they_are_not_read_they_are_refused"
    ),
    "a `rigid_contact_stiffness`": (
        "test_row_materials.py::test_a_material_that_no_row_has_is_named"
    ),
    "contacts that overflowed": (
        "test_recorded_rollouts.py::"
        "test_contacts_that_overflow_raise_however_many_particles_there_are"
    ),
    "`SolverVBD.step` on a tape": (
        "test_vbd.py::test_a_step_on_a_tape_names_what_carries_a_gradient"
    ),
    "`SolverVBD` on a device": (
        "test_vbd_guide.py::test_a_row_of_the_table_of_devices_is_as_it_says"
    ),
    "in `DiffSolverVBD`: bodies": (
        "test_avbd_gradients.py::test_what_has_no_gradient_is_refused_by_name"
    ),
    "in `DiffSolverVBD`, and in `SolverVBD`": (
        "test_avbd.py::test_what_rows_do_not_do_is_refused_by_name"
    ),
    "in `SolverVBD` and `DiffSolverVBD`:": (
        "test_vbd_model.py::test_every_number_acts_or_raises_by_name"
    ),
    "`SolverVBD.residual`": (
        "test_vbd.py::test_a_replay_notes_what_is_not_finite_and_the_next_call_names_it"
    ),
    "in both: particles": "test_vbd.py::test_options_are_kept_and_bad_ones_are_refused",
    "in `DiffSolverVBD`: `requires": options_of_vbd_without_a_gradient,
    "in `DiffSolverVBD(gradient": (
        "test_vbd.py::test_a_step_that_is_not_solved_is_an_error_unless_allowed"
    ),
    "`targets` of `rollout`": targets_without_kinematic_particles,
    "`ShapeConfig.mu_torsional`": "test_shape_config.py::test_a_field_acts_or_is_refused",
    "`restitution`, except": "test_articulation_fields.py::test_restitution_raises_under_penalty",
    "a number of the model": (
        "test_edited_values.py::test_a_launch_refuses_a_bad_number_before_it_writes"
    ),
    "in `SolverSemiImplicit`, `Diff": (
        "test_edited_values.py::test_a_bad_number_of_particles_elements_or_shapes_is_named"
    ),
    "in the same solvers": (
        "test_edited_values.py::test_a_bad_number_of_particles_elements_or_shapes_is_named"
    ),
    "in `SolverFeatherstone` and": (
        "test_articulation_fields.py::test_a_number_that_the_builder_refuses_is_named"
    ),
    "in a recorded step": (
        "test_every_gradient.py::test_the_gradient_by_every_array_is_right_or_refused_by_name"
    ),
    "`requires_grad` of an array": (
        "test_leaves.py::test_an_array_that_follows_another_is_refused_as_a_leaf"
    ),
    "a `particle_world`": "test_model_worlds.py::test_a_world_that_is_not_there_is_refused",
    "an element of a particle": an_element_of_no_particle,
    "the launch of a captured": (
        "test_edited_values.py::"
        "test_a_launch_refuses_another_number_of_the_model_than_that_recorded"
    ),
    "`step` inside a": a_step_in_a_capture,
    "writing the `particle_f`": forces_of_a_later_state,
    "the forces that a recorded": forces_that_a_step_left,
    "a view that overlaps": a_view_of_bytes_with_another_gradient,
    "`state_in is state_out`": "test_tape.py::test_overlapping_memory_is_refused",
    "two states that share": "test_sim.py::test_a_bad_step_is_refused_and_changes_nothing",
}


def rows() -> list[str]:
    """The first cells of the table."""
    text = TABLE.read_text(encoding="utf-8")
    table = text.split("| Request | Raises |\n|---|---|\n")[1].split("\n\n")[0]
    return [re.split(r"(?<!\\)\|", row)[1].strip() for row in table.splitlines()]


def test_every_row_has_one_test() -> None:
    found = [[begin for begin in TESTS if row.startswith(begin)] for row in rows()]
    for row, begins in zip(rows(), found, strict=True):
        assert len(begins) == 1, row
    assert {begins[0] for begins in found} == set(TESTS)


@pytest.mark.parametrize("begin", [b for b, test in TESTS.items() if isinstance(test, str)])
def test_the_test_of_a_row_is_there(begin: str) -> None:
    file, name = str(TESTS[begin]).split("::")
    assert f"\ndef {name}(" in (HERE / file).read_text(encoding="utf-8")


@pytest.mark.parametrize("begin", [b for b, test in TESTS.items() if callable(test)])
def test_a_request_is_refused(begin: str) -> None:
    test = TESTS[begin]
    assert callable(test)
    test()
