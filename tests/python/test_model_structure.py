"""Which joints and articulations there are does not change once a model is made."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import novaphy
from novaphy import solvers

ARRAYS = (
    "joint_type",
    "joint_parent",
    "joint_child",
    "joint_dof_dim",
    "joint_q_start",
    "joint_qd_start",
    "joint_articulation",
    "joint_ancestor",
    "joint_world",
    "joint_mimic",
    "joint_mimic_coef",
    "articulation_start",
    "articulation_end",
)
DT = 1e-3


def arm() -> novaphy.Model:
    builder = novaphy.ModelBuilder()
    links = [builder.add_link(mass=1.0, inertia=np.eye(3)) for _ in range(2)]
    joints = [builder.add_joint_revolute(-1, links[0]), builder.add_joint_revolute(*links)]
    builder.add_articulation(joints)
    return builder.finalize()


def uses(model: novaphy.Model) -> dict:
    """What walks the joints, made before they are edited."""
    state, after = model.state(), model.state()
    calls = {
        "eval_fk": lambda: novaphy.eval_fk(model, state.joint_q, state.joint_qd, state),
        "eval_ik": lambda: novaphy.eval_ik(model, state, state.joint_q, state.joint_qd),
        "eval_mass_matrix": lambda: novaphy.eval_mass_matrix(model, state),
        "pickle": lambda: pickle.dumps(model),
    }
    names = ["SolverFeatherstone", "SolverSemiImplicit"]
    if novaphy.has_diff():
        names += ["DiffFeatherstoneSolver", "DiffSemiImplicitSolver"]
    for name in names:
        made = getattr(solvers, name)(model)
        calls[name] = lambda made=made: made.step(state, after, None, None, DT)
        calls[f"{name} made"] = lambda name=name: getattr(solvers, name)(model)
    return calls


USES = list(uses(arm()))


@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize("array", ARRAYS)
@pytest.mark.parametrize("value", [-7, 1, 1 << 30])
def test_an_edit_is_refused_by_array_and_row_and_may_be_taken_back(
    array: str, use: str, value: int
) -> None:
    model = arm()
    call = uses(model)[use]
    call()
    made = getattr(model, array).numpy().copy()
    edited = made.copy()
    row = len(made) - 1
    edited[row] = value if (edited[row] != value).all() else value + 1
    getattr(model, array).assign(edited)
    for _ in range(2):
        with pytest.raises(ValueError, match=rf"model.{array}\[{row}\]: expected .* got"):
            call()
    getattr(model, array).assign(made)
    call()


@pytest.mark.parametrize("copy", [lambda m: m.clone(), lambda m: pickle.loads(pickle.dumps(m))])
def test_copies_know_their_joints(copy) -> None:
    model = copy(arm())
    state = model.state()
    novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
    model.joint_parent.assign(np.int32([-1, 5]))
    with pytest.raises(ValueError, match=r"eval_fk: model.joint_parent\[1\]: expected 0 .* got 5"):
        novaphy.eval_fk(model, state.joint_q, state.joint_qd, state)
