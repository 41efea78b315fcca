"""Forward derivatives of rollouts with all that a solver has: the transpose of the gradient."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import novaphy
from novaphy import JointDofConfig, JointTargetMode, diff, nova, solvers

UPRIGHT = (0, 0, 0, 1)
CLOTH = {
    "dim_x": 3,
    "dim_y": 3,
    "cell_x": 0.07,
    "cell_y": 0.07,
    "mass": 0.02,
    "add_springs": True,
    "spring_ke": 20.0,
    "edge_ke": 0.05,
    "spring_kd": 0.02,
    "tri_ke": 50.0,
    "tri_ka": 40.0,
    "tri_kd": 0.01,
    "particle_radius": 0.015,
}
SOFT = {"dim_x": 1, "dim_y": 1, "dim_z": 1, "cell_x": 0.1, "cell_y": 0.1, "cell_z": 0.1}
SOFT |= {"density": 100.0, "k_mu": 2e3, "k_lambda": 3e3, "k_damp": 1.0}
MOTOR = {
    "target_ke": 15.0,
    "target_kd": 0.4,
    "target_q": 0.3,
    "damping": 0.1,
    "limit_ke": 30.0,
    "limit_kd": 0.3,
    "actuator_mode": JointTargetMode.POSITION_VELOCITY,
}
PARTICLES, BODIES, JOINTS = (
    tuple(f"{what}_{name}" for name in ("q", "qd")) for what in ("particle", "body", "joint")
)


def deformables(builder, height, **cloth):
    builder.add_cloth_grid(pos=(-0.1, -0.1, height), vel=(0.1, 0.05, -0.5), **(CLOTH | cloth))
    builder.add_soft_grid(pos=(1, 0, 0.01), vel=(0.5, 0.2, -0.3), **SOFT)


def falling():
    """A box with a capsule on a hinge, a ball that hits it, and a cloth and a block upon them."""
    surface = novaphy.ShapeConfig(ke=2e3, kd=10.0, kf=15.0, mu=0.5, density=300.0)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=surface)
    box = builder.add_link(xform=(0, 0.02, 0.095, 0.03, 0.02, 0.1, np.sqrt(0.9887)))
    builder.add_shape_box(box, hx=0.1, hy=0.08, hz=0.1, cfg=surface)
    arm = builder.add_link(xform=(0.3, 0.02, 0.2, 0.02, 0.7, 0.05, np.sqrt(0.5071)))
    builder.add_shape_capsule(arm, radius=0.05, half_height=0.1, cfg=surface)
    hinge = {"parent_xform": ((0.12, 0, 0.05), UPRIGHT), "child_xform": ((0, 0, -0.17), UPRIGHT)}
    joints = [
        builder.add_joint_free(box),
        builder.add_joint_revolute(box, arm, axis=(0, 1, 0), limit_upper=0.6, **hinge, **MOTOR),
    ]
    builder.add_articulation(joints)
    ball = builder.add_body(xform=(-0.16, 0, 0.11, *UPRIGHT))
    builder.add_shape_sphere(ball, radius=0.07, cfg=surface)
    builder.body_qd[ball] = (0.8, 0.1, -0.3, 0.5, 1.0, 0.2)
    deformables(builder, 0.205)
    elements = {f"enable_{e}": True for e in ("tetrahedra", "triangles", "springs", "bending")}
    config = solvers.DiffSolverConfig(
        joint_attach_ke=500.0, joint_attach_kd=5.0, **elements, contact_gradient="code"
    )
    model = builder.finalize()
    names = ("gravity", "particle_mass", "body_mass", "body_com", "shape_material_mu")
    return solvers.DiffSemiImplicitSolver(model, config), PARTICLES + BODIES, names, 1 / 600


def draped(gradient):
    surface = novaphy.ShapeConfig(ke=500.0, kd=1.0, mu=0.4)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=surface)
    deformables(builder, 0.06, fix_left=True, cell_x=0.1, cell_y=0.1, mass=0.05)
    builder.color()
    options = {"gradient_tolerance": 1e-5, "iterations": 30} if gradient == "implicit" else {}
    solver = solvers.DiffSolverVBD(builder.finalize(), gradient=gradient, **options)
    names = ("gravity", "particle_mass", "spring_stiffness", "tet_material", "shape_material_mu")
    return solver, PARTICLES, names, 1 / 400


def tree(touches):
    builder = novaphy.ModelBuilder()
    links = [
        builder.add_link(mass=0.8 + 0.2 * k, com=(0.02, 0.01 * k, -0.1), inertia=np.eye(3) * 0.02)
        for k in range(4)
    ]
    below = {"parent_xform": ((0.05, 0.02, -0.2), UPRIGHT)}
    axes = [JointDofConfig(axis=axis, **MOTOR) for axis in ((1, 0, 0), (0, 1, 0))]
    joints = [
        builder.add_joint_free(links[0]),
        builder.add_joint_revolute(links[0], links[1], axis=(0, 1, 0), **below, **MOTOR),
        builder.add_joint_ball(links[1], links[2], **below),
        builder.add_joint_d6(links[0], links[3], angular_axes=axes, **below),
    ]
    builder.add_articulation(joints)
    if touches:
        surface = novaphy.ShapeConfig(mu=0.4, density=0.0)
        builder.add_ground_plane(cfg=surface)
        for link in links[1:]:
            builder.add_shape_sphere(link, xform=((0, 0, -0.15), UPRIGHT), radius=0.06, cfg=surface)
    random = np.random.default_rng(1)
    builder.joint_q = [0.1, 0.2, 0.62, *UPRIGHT, 0.1, *UPRIGHT, -0.1, 0.2]
    builder.joint_qd = list(random.normal(size=len(builder.joint_qd)) * 0.5)
    solver = solvers.DiffFeatherstoneSolver(builder.finalize(), contact_gradient="code")
    return solver, JOINTS, ("gravity", "body_mass", "body_com", "joint_target_ke"), 1 / 200


VBD = {f"VBD, {g}": (lambda g=g: draped(g)) for g in ("unrolled", "implicit")}
SCENES = {
    "semi-implicit": falling,
    **(VBD if novaphy.has_vbd() else {}),
    "articulation": lambda: tree(False),
    "articulation on the ground": lambda: tree(True),
}


class Rollout:
    """A weighted sum of the states in the middle and at the end, and its inputs."""

    def __init__(self, scene, checkpoint, steps=8):
        self.solver, states, names, self.dt = SCENES[scene]()
        model, random = self.solver.model, np.random.default_rng(5)
        self.pipeline = novaphy.CollisionPipeline(model) if model.shape_count else None
        self.trajectory = diff.Trajectory(model, steps, checkpoint=checkpoint)
        self.inputs = [getattr(diff, f"state_{name}_tensor")(self.trajectory[0]) for name in states]
        self.inputs += [getattr(diff, f"model_{name}_tensor")(model) for name in names]
        self.forces = {}
        for count, what in ((model.particle_count, "forces"), (model.body_count, "body_forces")):
            shape = (steps, count, 3 if what == "forces" else 6)
            values = random.normal(size=shape).astype(np.float32) * 0.05
            if count:
                self.forces[what] = nova.tensor(values)
        self.inputs += list(self.forces.values())
        for tensor in self.inputs:
            tensor.requires_grad = True
        ends = [self.trajectory[t] for t in (steps // 2, steps)]
        self.ends = [
            getattr(diff, f"state_{name}_tensor")(s) for s, name in itertools.product(ends, states)
        ]
        self.weights, self.directions = (
            [nova.tensor(random.normal(size=t.shape).astype(np.float32)) for t in tensors]
            for tensors in (self.ends, self.inputs)
        )
        self.directions = [
            nova.tensor(d.numpy() * np.maximum(np.abs(t.numpy()), 1e-2))
            for d, t in zip(self.directions, self.inputs, strict=True)
        ]

    def tangents(self, tape):
        """By each of the inputs."""
        self.solver.rollout(
            self.trajectory, None, None, self.dt, pipeline=self.pipeline, **self.forces
        )
        loss = nova.zeros((1,))
        for end, weight in zip(self.ends, self.weights, strict=True):
            loss = loss + nova.sum(end * weight)
        slopes = [
            tape.jvp([loss], [t], [d])[0] for t, d in zip(self.inputs, self.directions, strict=True)
        ]
        tape.backward(loss)
        return slopes

    def check(self, slopes):
        found = []
        for t, d, slope in zip(self.inputs, self.directions, slopes, strict=True):
            gradient, along = t.grad.numpy().astype(float), d.numpy().astype(float)
            scale = np.linalg.norm(gradient) * np.linalg.norm(along)
            assert slope.item() == pytest.approx((gradient * along).sum(), abs=1e-4 * scale)
            assert scale > 0
            found.append(slope.item())
            t.grad.zero_()
        return found


@pytest.mark.parametrize("checkpoint", [1, 4])
@pytest.mark.parametrize("scene", SCENES)
def test_a_rollout_has_the_tangents_that_its_gradient_says(scene, checkpoint):
    """Also with checkpoints, one after the other, before a backward and after one."""
    rollout = Rollout(scene, checkpoint)
    with nova.Tape() as tape:
        slopes = rollout.tangents(tape)
    rollout.check(slopes)


@pytest.mark.parametrize("checkpoint", [1, 4])
@pytest.mark.parametrize("scene", [s for s in SCENES if s not in VBD])
def test_a_captured_tangent_is_that_of_the_inputs_of_the_launch(scene, checkpoint):
    rollout = Rollout(scene, checkpoint)

    def once():
        with nova.Tape() as tape:
            return rollout.tangents(tape)

    once()
    for t in rollout.inputs:
        t.grad.zero_()
    with nova.ScopedCapture() as capture:
        slopes = once()
    capture.graph.launch()
    before = rollout.check(slopes)
    rollout.inputs[1].assign(rollout.inputs[1].numpy() * np.float32(1.1))  # velocities
    capture.graph.launch()
    moved = rollout.check(slopes)
    assert rollout.check(once()) == moved != before
