"""Numbers of worlds that are not there, in every solver and in collide."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import solvers


def two_worlds(particles=False):
    one = novaphy.ModelBuilder()
    if particles:
        one.add_particle((0, 0, 1), (0, 0, 0), 1.0)
    else:
        one.add_body(mass=1.0, inertia=np.eye(3))
        one.add_shape_sphere(0, radius=0.1)
    builder = novaphy.ModelBuilder()
    builder.replicate(one, 2)
    return builder.finalize()


def use(name, model):
    state = model.state()
    if name.startswith("collide"):
        pipeline = novaphy.CollisionPipeline(model, broad_phase=name.split()[1])
        contacts = pipeline.contacts()
        return lambda: pipeline.collide(state, contacts)
    if name == "DiffSemiImplicitSolver":
        config = solvers.DiffSolverConfig(enable_rigid_contacts=False)
        solver = solvers.DiffSemiImplicitSolver(model, config)
    else:
        solver = getattr(solvers, name)(model)
    after = model.state()
    return lambda: solver.step(state, after, None, None, 1e-3)


USERS = (
    "collide explicit",
    "collide nxn",
    "collide sap",
    "SolverSemiImplicit",
    "SolverFeatherstone",
)
if novaphy.has_diff():
    USERS += ("DiffSemiImplicitSolver", "DiffFeatherstoneSolver")


@pytest.mark.parametrize("value", [2, -2])
@pytest.mark.parametrize("name", ["body_world", "shape_world"])
@pytest.mark.parametrize("user", USERS)
def test_a_world_that_is_not_there_is_refused(user, name, value):
    model = two_worlds()
    call = use(user, model)
    call()
    field = getattr(model, name)
    field[:] = [0, value]
    with pytest.raises(IndexError, match=rf"model\.{name}\[1\]: expected .*1, got {value}"):
        call()
    field[:] = [0, 0]
    call()


def test_a_world_of_a_particle_that_is_not_there_is_refused():
    model = two_worlds(particles=True)
    call = use("SolverSemiImplicit", model)
    call()
    model.particle_world[:] = [0, 5]
    with pytest.raises(
        IndexError, match=r"step: model\.particle_world\[1\]: expected -1 to 1, got 5"
    ):
        call()
