"""Arguments of a wrong type: the message names the argument, what was expected and what came."""

from __future__ import annotations

import pytest

import novaphy
from novaphy._arguments import explain

diff = pytest.importorskip("novaphy.diff")
nova = pytest.importorskip("novaphy.nova")


@pytest.fixture
def model() -> novaphy.Model:
    builder = novaphy.ModelBuilder()
    builder.add_particle((0, 0, 1), (0, 0, 0), 1.0)
    return builder.finalize()


@pytest.fixture
def solver(model):
    return novaphy.solvers.DiffSemiImplicitSolver(model)


CALLS = {
    "diff.Trajectory, steps: expected an integer, got 1.5": lambda m, s: diff.Trajectory(m, 1.5),
    "diff.Trajectory, steps: expected an int32, got 1000000000000": lambda m, s: diff.Trajectory(
        m, 10**12
    ),
    "diff.Trajectory, steps: expected an integer, got str": lambda m, s: diff.Trajectory(
        m, steps="a"
    ),
    "Trajectory, checkpoint: expected an integer, got float": lambda m, s: diff.Trajectory(
        m, 10, checkpoint=float("nan")
    ),
    "diff.Trajectory: no argument is called 'stepz'; expected model, steps, ": (
        lambda m, s: diff.Trajectory(m, stepz=4)
    ),
    "diff.Trajectory: argument 'steps' is missing": lambda m, s: diff.Trajectory(m),
    "diff.Trajectory, model: expected a novaphy.Model, got None": lambda m, s: diff.Trajectory(
        None, 3
    ),
    "solvers.DiffSolverConfig, strict: expected True or False, got str": (
        lambda m, s: novaphy.solvers.DiffSolverConfig(strict="x")
    ),
    "solvers.DiffSolverConfig: expected at most 0 positional arguments, got 1": (
        lambda m, s: novaphy.solvers.DiffSolverConfig(True)
    ),
    "ShapeConfig, ke: expected a number, got str": lambda m, s: novaphy.ShapeConfig(ke="x"),
    "Model.soft_contact_ke: expected a number, got str": lambda m, s: setattr(
        m, "soft_contact_ke", "x"
    ),
    "solvers.SolverBase.step: argument 'dt' is missing": lambda m, s: s.step(
        m.state(), m.state(), None, None
    ),
    "solvers.SolverBase.step, dt: expected a number, got str": lambda m, s: s.step(
        m.state(), m.state(), None, None, "0.1"
    ),
    "solvers.SolverBase.step, dt: expected a number, got None": lambda m, s: s.step(
        m.state(), m.state(), None, None, None
    ),
    "rollout, trajectory: expected a novaphy.diff.Trajectory, got novaphy.SimState": (
        lambda m, s: s.rollout(m.state(), None, None, 0.1)
    ),
    "nova.sqrt, x: expected a novaphy.nova.Tensor or a novaphy.nova.Real, got str": (
        lambda m, s: nova.sqrt("x")
    ),
    "nova.Tape.backward, loss: expected a novaphy.nova.Tensor, got 3": (
        lambda m, s: nova.Tape().backward(3)
    ),
    "nova.gradcheck, fn: expected a function, got None": lambda m, s: nova.gradcheck(None, []),
    "nova.concat, parts: expected a sequence with a novaphy.nova.Tensor in each place, got list": (
        lambda m, s: nova.concat([nova.ones(1), None])
    ),
    "nova.Tape.jvp, tangents: expected a sequence, got 3": lambda m, s: nova.Tape().jvp([], [], 3),
    "Model.collide, state: expected a novaphy.SimState, got None": lambda m, s: m.collide(None),
    "set_num_threads, count: expected an integer, got None": (
        lambda m, s: novaphy.set_num_threads(None)
    ),
}


@pytest.mark.parametrize("message", CALLS)
def test_a_wrong_argument_is_named(message, model, solver):
    with pytest.raises(TypeError) as caught:
        CALLS[message](model, solver)
    assert message in str(caught.value) and "Invoked with" not in str(caught.value)


def test_what_cannot_be_explained_stays_as_it_was():
    message = "f(): incompatible function arguments. ...:\n    1. (x: Odd[int]) -> None\n\nInvoked"
    assert explain("f", message, [3], {}) == message


def test_an_operator_still_leaves_the_other_operand_a_chance():
    class Other:
        def __radd__(self, other):
            return "asked"

    assert nova.tensor([1.0]) + Other() == "asked"
    with pytest.raises(TypeError, match="unsupported operand"):
        nova.tensor([1.0]) + "x"


@pytest.mark.filterwarnings("error")
def test_a_type_error_of_a_callback_is_left_alone():
    def body(c):
        raise TypeError("(): incompatible shoes")

    with pytest.raises(TypeError, match="incompatible shoes"):
        nova.make_indexed_kernel("broken", [("x", nova.float32)], 1, body)


def test_a_rollout_that_does_not_fit_names_checkpoint(model):
    builder = novaphy.ModelBuilder()
    builder.add_particle_grid(dim_x=100, dim_y=10, dim_z=10, cell_x=1, cell_y=1, cell_z=1, mass=1)
    with pytest.raises((ValueError, novaphy.Error), match="a checkpoint interval keeps fewer"):
        diff.Trajectory(builder.finalize(), 2**31 - 2)
    with pytest.raises(ValueError, match="the states need at least"):
        diff.Trajectory(model, 1000, checkpoint="1KiB")


def test_step_inside_a_capture_points_at_rollout(model, solver):
    for one in (solver, novaphy.solvers.SolverSemiImplicit(model)):
        with pytest.raises(novaphy.Error, match="capture .*rollout"), nova.ScopedCapture():
            one.step(model.state(), model.state(), None, None, 1e-3)
