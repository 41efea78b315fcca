"""A rollout has the same bits plain, recorded, captured, with checkpoints: states and gradients."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy.testing import assert_same_bits

nova = pytest.importorskip("novaphy.nova")
diff = pytest.importorskip("novaphy.diff")
solvers = pytest.importorskip("novaphy.solvers")

STEPS = 5
# With 2,048 particles or more, a rollout of kernels collects the launches of several steps.
PARTICLES = [(2047, 1), (2048, 1), (5000, 1), (36, 64)]  # particles of a world, and worlds
WORLDS = [1, 64, 2048]  # worlds with bodies
OF_PARTICLES = {"particle_qd": ("particle_q", "particle_qd")}
OF_BODIES = {"body_qd": ("body_q", "body_qd")}
OF_JOINTS = {"joint_qd": ("joint_q", "joint_qd", "body_q")}


def particles(count: int, worlds: int, bodies: int = 0) -> novaphy.Model:
    """Particles that slide, in pairs on springs, beside bodies; as many in each world."""
    scene = novaphy.ModelBuilder()
    at = np.zeros((count, 3))
    at[:, 0], at[:, 2] = 0.1 * np.arange(count), 0.0199
    scene.default_particle_radius = 0.02
    scene.add_particles(at, np.full((count, 3), (0.3, 0.0, -0.1)), np.full(count, 0.02))
    for k in range(0, count - 1, 2):
        scene.add_spring(k, k + 1, ke=20.0, kd=0.1)
    surface = novaphy.ShapeConfig(density=125.0, ke=2e3, kd=0.0, mu=0.4, gap=0.01)
    scene.add_ground_plane(cfg=surface)
    for k in range(bodies):
        add_box(scene, (k, 1.0, 0.0995), surface)
    builder = novaphy.ModelBuilder()
    builder.replicate(scene, worlds)
    builder.color()
    model = builder.finalize(requires_grad=True)
    model.soft_contact_ke, model.soft_contact_kd = 2e3, 0.0
    return model


def add_box(builder, position, surface):
    body = builder.add_body(xform=(position, (0, 0, 0, 1)))
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=surface)


def boxes(worlds: int) -> novaphy.Model:
    """A box that slides in each world."""
    scene = novaphy.ModelBuilder()
    surface = novaphy.ShapeConfig(density=125.0, ke=2e3, kd=10.0, kf=50.0, mu=0.5, gap=0.01)
    add_box(scene, (0, 0, 0.0995), surface)
    scene.add_ground_plane(cfg=surface)
    builder = novaphy.ModelBuilder()
    builder.replicate(scene, worlds)
    model = builder.finalize(requires_grad=True)
    for array in (model.body_qd, model.joint_qd):
        array.assign(np.tile(np.float32([0.3, 0, -0.1, 0, 0, 0]), worlds).reshape(array.shape))
    return model


def check(model, solver, followed, contacts, dt):
    """Every way on one and two threads."""
    (velocity, results), *_ = followed.items()
    pipeline = None if contacts == "static" else novaphy.CollisionPipeline(model)
    rng = np.random.default_rng(1)

    def tensors(state):
        return [getattr(diff, f"state_{name}_tensor")(state) for name in results]

    weights = [
        nova.tensor(rng.normal(size=tensor.shape).astype(np.float32))
        for tensor in tensors(model.state())
    ]

    def run(way):
        """The states that are kept, and the gradient."""
        trajectory = diff.Trajectory(model, STEPS, checkpoint=2 if way == "checkpoints" else None)
        found, options = None, {}
        if contacts == "pipeline":
            options = {"pipeline": pipeline}
        elif contacts == "contacts":
            found = pipeline.contacts()
            pipeline.collide(trajectory[0], found)
        if hasattr(solver, "reset"):
            solver.reset()  # forgets the velocity that the adaptive guess reads
        if way == "plain":
            solver.rollout(trajectory, None, found, dt, **options)
            return kept(trajectory), None
        start = getattr(diff, f"state_{velocity}_tensor")(trajectory[0], requires_grad=True)

        def once():
            with nova.Tape() as tape:
                solver.rollout(trajectory, None, found, dt, **options)
                terms = zip(tensors(trajectory[STEPS]), weights, strict=True)
                tape.backward(sum(nova.sum(tensor * weight) for tensor, weight in terms))

        if way == "captured":
            with nova.ScopedCapture() as capture:
                once()
            start.zero_grad()
            capture.graph.launch()
        else:
            once()
        return kept(trajectory), start.grad.numpy()

    def kept(trajectory):
        return {t: [x.numpy() for x in tensors(trajectory[t])] for t in trajectory.kept_steps}

    before = novaphy.num_threads()
    try:
        novaphy.set_num_threads(1)
        (states, _), (_, gradient) = run("plain"), run("recorded")
        for threads in (1, 2):
            novaphy.set_num_threads(threads)
            for way in ("plain", "recorded", "checkpoints", "captured"):
                found, again = run(way)
                for t, values in found.items():
                    for one, two in zip(states[t], values, strict=True):
                        assert_same_bits(one, two)
                if again is not None:
                    assert_same_bits(gradient, again)
    finally:
        novaphy.set_num_threads(before)
    assert np.abs(states[STEPS][0] - states[0][0]).max() > 1e-6
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0.0
    return states, gradient


@pytest.mark.skipif(not novaphy.has_vbd(), reason="built with NOVAPHY_BUILD_VBD=OFF")
@pytest.mark.parametrize("contacts", ["contacts", "pipeline"])
@pytest.mark.parametrize(("count", "worlds"), PARTICLES)
@pytest.mark.parametrize("guess", ["inertia", "previous", "adaptive"])
@pytest.mark.parametrize("gradient", ["unrolled", "implicit"])
def test_of_vbd(gradient, guess, count, worlds, contacts):
    model = particles(count, worlds)
    options = {"allow_unconverged": True} if gradient == "implicit" else {}
    solver = solvers.DiffSolverVBD(
        model, iterations=4, gradient=gradient, initial_guess=guess, **options
    )
    check(model, solver, OF_PARTICLES, contacts, 1 / 240)


@pytest.mark.parametrize("contacts", ["contacts", "pipeline", "static"])
@pytest.mark.parametrize(("count", "worlds"), PARTICLES)
def test_of_particles(count, worlds, contacts):
    model = particles(count, worlds)
    config = solvers.DiffSolverConfig(
        enable_springs=True, enable_static_contacts=contacts == "static"
    )
    solver = solvers.DiffSemiImplicitSolver(model, config)
    check(model, solver, OF_PARTICLES, contacts, 1e-3)


def test_of_particles_beside_bodies():
    model = particles(2048, 1, bodies=2)
    config = solvers.DiffSolverConfig(enable_springs=True)
    solver = solvers.DiffSemiImplicitSolver(model, config)
    check(model, solver, OF_BODIES, "pipeline", 1e-3)


@pytest.mark.parametrize("contacts", ["contacts", "pipeline", "static"])
@pytest.mark.parametrize("worlds", WORLDS)
def test_of_bodies(worlds, contacts):
    model = boxes(worlds)
    config = solvers.DiffSolverConfig(enable_static_contacts=contacts == "static")
    solver = solvers.DiffSemiImplicitSolver(model, config)
    check(model, solver, OF_BODIES, contacts, 1e-3)


@pytest.mark.parametrize("contacts", ["contacts", "pipeline"])
@pytest.mark.parametrize("worlds", WORLDS)
def test_of_articulations(worlds, contacts):
    model = boxes(worlds)
    check(model, solvers.DiffFeatherstoneSolver(model), OF_JOINTS, contacts, 2e-3)


def test_contacts_that_overflow_raise_however_many_particles_there_are():
    for count in (2047, 2048):
        model = particles(count, 1)
        solver = solvers.DiffSemiImplicitSolver(
            model, solvers.DiffSolverConfig(enable_springs=True)
        )
        pipeline = novaphy.CollisionPipeline(model, soft_contact_max=100)
        with pytest.raises(novaphy.Error, match="more contacts were found than the 100 slots"):
            solver.rollout(diff.Trajectory(model, 2), None, None, 1e-3, pipeline=pipeline)
