"""Names that users of Newton 1.8 and of upstream NovaPhy write: they are here, or say what to use.

tests/data/names.json has the public names of both projects, by owner.
"""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import numpy as np
import pytest

import novaphy
from novaphy import solvers
from novaphy._planned import INSTEAD, NOT_BUILT, NOT_BUILT_IN

NAMES = json.loads((Path(__file__).parents[1] / "data" / "names.json").read_text())
LISTS = [(project, owner) for project, owners in NAMES.items() for owner in owners]


SOLVERS = [
    name
    for name in ("SolverFeatherstone", "SolverSemiImplicit", "SolverVBD", "DiffFeatherstoneSolver",
                 "DiffSemiImplicitSolver", "DiffSolverVBD")
    if hasattr(solvers, name)
]  # fmt: skip


def owner_named(owner: str) -> object:
    """The module or an object of the class that a list is about."""
    builder = novaphy.ModelBuilder()
    if owner.startswith("Solver") or owner in SOLVERS:
        if owner == "SolverBase":
            owner = "SolverFeatherstone"
        if not hasattr(solvers, owner):
            pytest.skip(f"this build has no {owner}")
        if owner.endswith("VBD"):
            builder.add_particle(pos=(0, 0, 0), vel=(0, 0, 0), mass=1.0)
            builder.color()
        else:
            builder.add_body(mass=1.0, inertia=np.eye(3))
        return getattr(solvers, owner)(builder.finalize())
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model)
    objects: dict[str, object] = {
        "ModelBuilder": builder,
        "Model": model,
        "State": model.state(),
        "Control": model.control(),
        "Contacts": pipeline.contacts(),
        "CollisionPipeline": pipeline,
        "ShapeConfig": novaphy.ShapeConfig(),
        "JointDofConfig": novaphy.JointDofConfig((1, 0, 0)),
    }
    return objects[owner] if owner in objects else importlib.import_module(owner)


@pytest.mark.parametrize(("project", "owner"), LISTS)
def test_a_name_is_there_or_says_what_to_do_without_it(project: str, owner: str) -> None:
    for asked in map(owner_named, SOLVERS if owner == "SolverBase" else [owner]):
        assert not silent_names(asked, NAMES[project][owner])


def silent_names(asked: object, names: str) -> list[str]:
    silent = []
    for name in names.split():
        if name in dir(asked):
            continue
        with pytest.raises((NotImplementedError, AttributeError)) as raised:
            getattr(asked, name)
        text = str(raised.value)
        if not ("use " in text or "not supported" in text):
            silent.append(f"{name}: {text}")
    return silent


def test_a_name_of_another_project_is_not_an_attribute() -> None:
    contacts = owner_named("Contacts")
    assert not hasattr(contacts, "rigid_contact_penetration")
    with pytest.raises(
        AttributeError, match=r"has no rigid_contact_penetration: use rigid_contacts"
    ):
        _ = contacts.rigid_contact_penetration
    with pytest.raises(NotImplementedError, match=r"Model\.tendon_count is not supported: tendons"):
        _ = owner_named("Model").tendon_count
    with pytest.raises(
        AttributeError, match="Model has no rigid_contact_max: use rigid_contact_max"
    ):
        owner_named("Model").rigid_contact_max = 1000
    with pytest.raises(AttributeError, match="Control has no joint_target_pos: use joint_target_q"):
        owner_named("Control").joint_target_pos = [0.0]
    with pytest.raises(AttributeError, match="no setter"):
        owner_named("Model").body_count = 1
    with pytest.raises(NotImplementedError, match=r"SolverVBD\.rigid_avbd_gamma is not supported"):
        _ = owner_named("SolverVBD").rigid_avbd_gamma
    with pytest.raises(AttributeError, match="SolverFeatherstone has no H: use eval_mass_matrix"):
        _ = owner_named("SolverFeatherstone").H
    with pytest.raises(AttributeError, match="body_mass of the model that finalize"):
        _ = novaphy.ModelBuilder().body_mass
    with pytest.raises(NotImplementedError, match=r"use novaphy\.io\.Mesh"):
        from novaphy import Mesh  # noqa: F401
    with pytest.raises(NotImplementedError, match=r"novaphy\.solvers\.SolverVBD"):
        _ = novaphy.SolverVBD


@pytest.mark.parametrize(
    "owner", ["Model", "State", "Control", "Contacts", "CollisionPipeline", *SOLVERS]
)
def test_a_misspelled_name_is_an_attribute_error_that_python_can_complete(owner: str) -> None:
    asked = owner_named(owner)
    with pytest.raises(
        AttributeError, match=f"{owner!r} object has no attribute 'devize'"
    ) as raised:
        _ = asked.devize
    assert raised.value.name == "devize" and raised.value.obj is asked
    with pytest.raises(AttributeError, match=f"{owner!r} object has no attribute 'devize'"):
        asked.devize = "cpu"


@pytest.mark.parametrize("owner", sorted(INSTEAD | NOT_BUILT_IN))
def test_no_table_has_a_name_that_is_there(owner: str) -> None:
    there = dir(owner_named(owner))
    tables = (INSTEAD.get(owner, {}), NOT_BUILT_IN.get(owner, {}), NOT_BUILT)
    for names in (names for table in tables for names in table.values()):
        wrong = [name for name in names.split() if name in there]
        assert not wrong, f"{owner}: take {wrong} out of novaphy/_planned.py"


@pytest.mark.parametrize(
    ("call", "hint"),
    [
        (lambda: novaphy.JointDofConfig((1, 0, 0), target_pos=1.0), "use target_q"),
        (lambda: novaphy.ModelBuilder().add_ground_plane(y=1.0), "use height"),
        (
            lambda: novaphy.CollisionPipeline(
                novaphy.ModelBuilder().finalize(), contact_report=True
            ),
            r"use Contacts\.match",
        ),
        (
            lambda: solvers.SolverFeatherstone(
                novaphy.ModelBuilder().finalize(), deterministic=True
            ),
            "same bits",
        ),
    ],
)
def test_an_argument_of_another_project_says_what_to_use(call, hint: str) -> None:
    with pytest.raises(TypeError, match=hint):
        call()
