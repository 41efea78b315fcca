"""Trajectories that keep some of their states."""

import gc

import numpy as np
import pytest
from scenes import ball_contacts, ball_model

import novaphy
from novaphy import diff, nova, solvers

STEPS = 20
DT = 1.0 / 240


def rollout(checkpoint):
    """A trajectory after a rollout, and the gradient of its initial velocity."""
    model = ball_model()
    trajectory = diff.Trajectory(model, STEPS, checkpoint=checkpoint)
    contacts = ball_contacts(model, trajectory[0])
    velocity = diff.state_particle_qd_tensor(trajectory[0], requires_grad=True)
    with nova.Tape() as tape:
        solvers.DiffSemiImplicitSolver(model).rollout(trajectory, None, contacts, DT)
        last = diff.state_particle_q_tensor(trajectory[STEPS])
        tape.backward(diff.particle_point_loss_generated(last, 0, 0.0, -2.0, 1.5))
    return trajectory, velocity.grad.numpy()


@pytest.mark.parametrize("checkpoint", [1, 3, STEPS, 100, "1KiB"])
def test_kept_and_recomputed_states_and_the_gradient_are_those_of_keeping_all(checkpoint):
    all_states, gradient = rollout(None)
    some, same_gradient = rollout(checkpoint)
    np.testing.assert_array_equal(same_gradient, gradient)
    everything = all_states.particle_q.numpy()
    np.testing.assert_array_equal(some.particle_q.numpy(), everything[some.kept_steps])
    assert some.particle_q.shape == (len(some.kept_steps), 1, 3)
    gc.collect()  # solver and contacts live on with the trajectory
    for t in range(STEPS + 1):
        np.testing.assert_array_equal(some.recompute(t).particle_q.numpy(), everything[t])
    assert len(some) == STEPS + 1 and len(list(some)) == len(some.kept_steps)


def test_memory_chooses_the_interval():
    trajectory, _ = rollout("1KiB")
    assert trajectory.checkpoint_interval == 1  # 21 states of 24 bytes
    model = novaphy.ModelBuilder()
    model.add_particles(
        np.zeros((100, 3), np.float32), np.zeros((100, 3), np.float32), np.ones(100)
    )
    model = model.finalize()
    assert diff.Trajectory(model, 100, checkpoint="50KiB").checkpoint_interval == 8


@pytest.mark.parametrize(
    ("checkpoint", "error", "message"),
    [
        (0, ValueError, "checkpoint: expected an interval >= 1, got 0"),
        (-3, ValueError, "checkpoint: expected an interval >= 1, got -3"),
        ("64", ValueError, 'expected an interval or memory as "64MiB"'),
        ("MiB", ValueError, 'got "MiB"'),
        ("-1KiB", ValueError, "checkpoint"),
        ("99999999999999999999KiB", ValueError, "checkpoint"),
    ],
)
def test_a_checkpoint_that_makes_no_sense_is_refused(checkpoint, error, message):
    with pytest.raises(error, match=message):
        diff.Trajectory(ball_model(), STEPS, checkpoint=checkpoint)
    with pytest.raises(ValueError, match="need at least"):
        builder = novaphy.ModelBuilder()
        builder.add_particles(
            np.zeros((1000, 3), np.float32), np.zeros((1000, 3), np.float32), np.ones(1000)
        )
        diff.Trajectory(builder.finalize(), STEPS, checkpoint="1KiB")


def test_a_state_that_is_not_kept_is_refused_by_name():
    trajectory, _ = rollout(8)
    with pytest.raises(RuntimeError, match=r"state 9 is not kept, but those of t = 0, 8, 16"):
        trajectory[9]
    with pytest.raises(IndexError):
        trajectory.recompute(21)
    with pytest.raises(RuntimeError, match="no rollout yet"):
        diff.Trajectory(ball_model(), STEPS, checkpoint=8).recompute(3)


def bodies(contacts, particles=1):
    """A box that lands, a pendulum, and particles beside them."""
    builder = novaphy.ModelBuilder()
    cfg = novaphy.ShapeConfig(density=125.0, ke=2e3, kd=10.0, kf=50.0, mu=0.5, gap=0.01)
    body = builder.add_body(xform=((0, 0, 0.0995), (0, 0, 0, 1)))
    of_body = cfg.copy()
    of_body.has_particle_collision = False  # static contacts support no shape of a body
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=of_body)
    link = builder.add_link(mass=0.5, inertia=np.eye(3) * 1e-2, com=(0.2, 0, 0))
    joint = builder.add_joint_revolute(-1, link, axis=(0, 1, 0), parent_xform=((2, 0, 1), UP))
    builder.add_articulation([joint])
    for _ in range(particles):
        builder.add_particle((1, 0, 0.0199), (0.3, 0, 0), 0.02, radius=0.02)
    builder.add_ground_plane(cfg=cfg)
    model = builder.finalize(requires_grad=True)
    config = solvers.DiffSolverConfig(enable_static_contacts=contacts == "static")
    return model, solvers.DiffSemiImplicitSolver(model, config)


def coordinates(contacts):
    """The same bodies in joint coordinates."""
    model, _ = bodies(contacts, particles=0)
    return model, solvers.DiffFeatherstoneSolver(model)


UP = (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("make", "contacts"),
    [(bodies, "static"), (bodies, "pipeline"), (bodies, "contacts"), (coordinates, "pipeline")],
)
def test_states_of_bodies_are_recomputed(make, contacts):
    model, solver = make(contacts)
    pipeline = novaphy.CollisionPipeline(model)
    forces = nova.tensor(np.full((STEPS, model.body_count, 6), 0.3, np.float32))
    states = []
    for checkpoint in (None, 7):
        trajectory = diff.Trajectory(model, STEPS, checkpoint=checkpoint)
        found, options = None, {"body_forces": forces}
        if contacts == "pipeline":
            options["pipeline"] = pipeline
        elif contacts == "contacts":
            found = pipeline.contacts()
            pipeline.collide(trajectory[0], found)
        solver.rollout(trajectory, None, found, 1e-3, **options)
        states.append(trajectory)
    whole, frugal = states
    for t in range(STEPS + 1):
        again = frugal.recompute(t)
        for name in ("body_q", "body_qd", "joint_q", "joint_qd", "particle_q", "particle_qd"):
            one, two = getattr(again, name).numpy(), getattr(whole[t], name).numpy()
            np.testing.assert_array_equal(one, two, err_msg=f"{name} at {t}")
    assert np.abs(whole[STEPS].body_qd.numpy() - whole[1].body_qd.numpy()).max() > 1e-3
    # Arrays that a step does not write may have any values. Arrays that it writes may not.
    if make is bodies:
        frugal[7].joint_q.assign(np.full(model.joint_coord_count, 9.0, np.float32))
        frugal.recompute(3)
    frugal[7].body_qd.assign(np.zeros((model.body_count, 6), np.float32))
    with pytest.raises(novaphy.Error, match="does not lead to the kept state 7"):
        frugal.recompute(3)
