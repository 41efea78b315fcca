"""Losses of thrown balls in batches of worlds, for tests of smoothed gradients and certificates."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import novaphy
from novaphy import diff, nova

STEPS, RATE = 240, 240


@cache
def _scene(worlds: int, mode: str) -> Any:
    """A model of balls 0.4 m above the ground, without gravity, with restitution 1."""
    surface = novaphy.ShapeConfig(mu=0.0, restitution=1.0, density=0, gap=0.05)
    one = novaphy.ModelBuilder(gravity=0.0)
    pose = ((0.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0))
    body = one.add_body(xform=pose, mass=1.0, inertia=np.eye(3) * 0.004)
    one.add_shape_sphere(body, radius=0.1, cfg=surface)
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.replicate(one, worlds)
    builder.add_ground_plane(cfg=surface)
    model = builder.finalize(requires_grad=True)
    solver = novaphy.solvers.DiffFeatherstoneSolver(
        model, angular_damping=0.0, pgs_slop=0.0, pgs_erp=1.0, contact_gradient=mode
    )
    return model, solver, novaphy.CollisionPipeline(model)


def last_height(theta: nova.Tensor, contact_gradient: str = "motion") -> nova.Tensor:
    """The height (m) after 1 s of balls that start with the vertical speeds theta {worlds, 1}."""
    worlds = theta.shape[0]
    model, solver, pipeline = _scene(worlds, contact_gradient)
    path = diff.Trajectory(model, STEPS)
    rates = nova.concat([nova.zeros((worlds, 2)), theta, nova.zeros((worlds, 3))], axis=1)
    diff.state_joint_qd_tensor(path[0]).copy_(rates.reshape(6 * worlds))
    solver.rollout(path, None, None, 1 / RATE, pipeline=pipeline)
    return diff.state_joint_q_tensor(path[STEPS]).reshape(worlds, 7)[:, 2]


def last_height_of_the_code(theta: nova.Tensor) -> nova.Tensor:
    """The same, with the gradient of the code."""
    return last_height(theta, "code")
