"""A step of articulations that fails: it names the dof, and leaves the new state as it was."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
STATE = ("joint_q", "joint_qd", "body_q", "body_qd")


def worlds(count: int, touching: bool):
    """Pendulums of two links, one a world; touching: each beside a ball in the ground."""
    one = novaphy.ModelBuilder()
    links = [one.add_link(mass=1.0, inertia=np.diag([0.02, 0.03, 0.04])) for _ in range(2)]
    one.add_articulation(
        [
            one.add_joint_revolute(
                parent,
                link,
                axis=(0.0, 1.0, 0.0),
                parent_xform=((0.3, 0.0, 1.0), UPRIGHT),
                label=label,
            )
            for parent, link, label in zip((-1, links[0]), links, ("upper", "lower"), strict=True)
        ]
    )
    if touching:
        one.add_ground_plane()
        ball = one.add_body(xform=((2.0, 0.0, 0.099), UPRIGHT))
        one.add_shape_sphere(ball, radius=0.1)
    builder = novaphy.ModelBuilder()
    builder.replicate(one, count)
    return builder.finalize()


@pytest.mark.parametrize("touching", [False, True], ids=["free", "touching"])
@pytest.mark.parametrize("count", [1, 3, 40])
@pytest.mark.parametrize("fault", ["coordinate", "velocity", "pivot", "contact"])
def test_a_failing_step_leaves_the_new_state_as_it_was(fault, count, touching) -> None:
    model = worlds(count, touching)
    solver = novaphy.solvers.SolverFeatherstone(model)
    state, after = model.state(), model.state()
    contacts = None
    if touching:
        pipeline = novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        pipeline.collide(state, contacts)
    solver.step(state, after, None, contacts, 1e-3)  # a good one before
    dofs = model.joint_dof_count // count
    dof = dofs * (count - 1) + 1
    if fault == "pivot":
        for array in (model.body_mass, model.body_inertia):  # the lower link
            numbers = array.numpy()
            numbers[model.body_count // count * (count - 1) + 1] = 0.0
            array.assign(numbers)
    elif fault == "contact":
        if not touching:
            pytest.skip("there are no contacts")
        velocity = state.joint_qd.numpy()
        velocity[dofs * (count - 1) + 2 : dofs * count] = np.inf  # the ball's
        state.joint_qd.assign(velocity)
        dof += 1
    else:
        array = state.joint_q if fault == "coordinate" else state.joint_qd
        row = (array.numpy().size // count) * (count - 1) + 1
        numbers = array.numpy()
        numbers[row] = np.nan
        array.assign(numbers)
    rng = np.random.default_rng(2)
    for name in STATE:
        array = getattr(after, name)
        array.assign(rng.normal(size=array.numpy().shape).astype(np.float32))
    before = {name: getattr(after, name).numpy() for name in STATE}
    joint = {"velocity": "upper", "contact": ""}.get(fault, "lower")
    dof -= fault == "velocity"  # the first whose acceleration is not finite
    world = f" of world {count - 1}" if count > 1 else ""
    named = rf"dof {dof} \(joint '.*{joint}.*'{world}\): .*not finite"
    with pytest.raises(novaphy.Error, match=named):
        solver.step(state, after, None, contacts, 1e-3)
    for name in STATE:
        np.testing.assert_array_equal(getattr(after, name).numpy(), before[name], err_msg=name)


@pytest.mark.parametrize("count", [1, 3, 40])
@pytest.mark.parametrize("recorded", [False, True])
@pytest.mark.parametrize("checkpoint", [None, 3])
@pytest.mark.parametrize("solver", ["SolverFeatherstone", "DiffFeatherstoneSolver"])
def test_a_rollout_tells_of_a_step_in_its_middle_that_fails(solver, checkpoint, recorded, count):
    diff = pytest.importorskip("novaphy.diff")
    from novaphy import nova

    model = worlds(count, False)
    if recorded and solver == "SolverFeatherstone":
        pytest.skip("it records nothing")
    made = getattr(novaphy.solvers, solver)(model)
    trajectory = diff.Trajectory(model, 6, checkpoint=checkpoint)
    good, bad = model.control(), model.control()
    made.rollout(trajectory, good, None, 1e-3)
    bad.joint_f[model.joint_dof_count - 1] = np.inf
    with nova.Tape() if recorded else nova.no_grad():
        with pytest.raises(novaphy.Error, match="step 2 of.*joint '.*not finite"):
            made.rollout(trajectory, [good, bad, good], None, 1e-3)
    made.rollout(trajectory, good, None, 1e-3)  # the solver still works
    assert np.isfinite(trajectory[6].joint_q.numpy()).all()
