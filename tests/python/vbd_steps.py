"""Steps of SolverVBD with contacts, for the tests of bodies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import novaphy
from novaphy.solvers import SolverVBD

H = 1 / 120  # s


def run(
    model: novaphy.Model,
    steps: int,
    dt: float = H,
    see: Callable[[int, novaphy.State], None] | None = None,
    control: novaphy.Control | None = None,
    **options: Any,
) -> novaphy.State:
    """Return the state after the steps; contacts are found in each step."""
    solver = SolverVBD(model, **options)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    for k in range(steps):
        pipeline.collide(state, contacts)
        solver.step(state, after, control, contacts, dt)
        state, after = after, state
        if see is not None:
            see(k, state)
    return state


def rotation(q: np.ndarray) -> np.ndarray:
    x, y, z, w = (float(v) for v in q)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross
