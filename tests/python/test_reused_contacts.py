"""What gradients do with contacts that are found once and used again, and found in every step."""

from __future__ import annotations

import numpy as np
import pytest
from test_articulation_contact_gradients import walker
from test_body_contacts import (
    CLOTH,
    SHAPES,
    TWO_BODIES,
    along_unit_quaternions,
    diff_solver,
    make_model,
    particle_and_body,
    weighted,
)

import novaphy
from novaphy import diff, nova, solvers
from novaphy.testing import assert_same_bits

DT = 1 / 500
STEPS = 5
SIZE = 2e-4  # step of the differences, within which no contact begins
TOUCHING = ["a box on a box", "a sphere on a box", "two spheres"]


class Steps:
    """Steps of two bodies, each with the contacts that `contacts_of(k, state)` gives."""

    def __init__(self, name, contacts_of=None):
        self.model = make_model(*TWO_BODIES[name], ground=False)
        self.pipeline = novaphy.CollisionPipeline(self.model)
        self.solver = diff_solver(self.model)
        self.state = self.model.state()
        self.contacts_of = contacts_of or (lambda _, state: self.find(state))

    def find(self, state):
        contacts = self.pipeline.contacts()
        self.pipeline.collide(state, contacts)
        return contacts

    def labels(self, contacts, state=None):
        found = diff.rigid_contact_gradient_labels(self.model, state or self.state, contacts)
        assert found
        return set(found)

    def leaves(self):
        return [
            getattr(diff, f"state_{name}_tensor")(self.state, requires_grad=True)
            for name in ("body_q", "body_qd", "body_f")
        ]

    def run(self):
        state = self.state
        for k in range(STEPS):
            after = self.model.state()
            self.solver.step(state, after, None, self.contacts_of(k, state), DT)
            state = after
        return state

    def __call__(self, *_):
        return weighted(self.run(), 2)

    def gradients(self):
        leaves = self.leaves()
        with nova.Tape() as tape:
            tape.backward(self())
        return [x.grad.numpy() for x in leaves]


@pytest.mark.parametrize("name", TOUCHING)
def test_contacts_of_another_state_are_held_in_every_step(name):
    steps = Steps(name)
    contacts = steps.find(steps.model.state())
    steps.contacts_of = lambda *_: contacts
    assert steps.labels(contacts) == {"frozen"}
    found = nova.gradcheck(steps, steps.leaves()[:2], epsilon=SIZE, rtol=2e-2, atol=2e-3)
    assert found.ok, found.worst
    assert found.dot_product_error < 1e-4


@pytest.mark.parametrize("name", TOUCHING)
def test_the_first_step_follows_the_state_of_its_contacts_and_later_ones_hold_them(name):
    """Differences find them anew for the first step, and keep those of the middle for others."""
    steps = Steps(name)
    middle, own = steps.find(steps.state), []

    def contacts_of(k, state):
        if k == 0:
            own.append(steps.find(state))
        first = len(own) == 1  # the run on the tape uses one Contacts in all of its steps
        assert not first or (steps.labels(own[0], state) == {"exact"}) == (k == 0)
        return own[-1] if k == 0 or first else middle

    steps.contacts_of = contacts_of
    got, ahead, behind = along_unit_quaternions(steps, SIZE).T
    assert len(own) > 40
    largest = np.abs(ahead + behind).max() / 2
    np.testing.assert_allclose(got, (ahead + behind) / 2, rtol=2e-3, atol=1e-3 * largest)


@pytest.mark.parametrize("name", TOUCHING)
def test_contacts_found_in_every_step_follow_every_state(name):
    steps = Steps(name)
    got, ahead, behind = along_unit_quaternions(steps, SIZE).T
    largest = np.abs(ahead + behind).max() / 2
    np.testing.assert_allclose(got, (ahead + behind) / 2, rtol=2e-3, atol=1e-3 * largest)
    # Holding those of the first step would be another gradient.
    follows, once = Steps(name).gradients()[0], Steps(name)
    held = once.find(once.model.state())
    once.contacts_of = lambda *_: held
    assert np.abs(once.gradients()[0] - follows).max() > 0.01 * np.abs(follows).max()


@pytest.mark.parametrize("name", TOUCHING)
@pytest.mark.parametrize("path", ["rollout", "checkpoints", "captured"])
def test_a_rollout_with_a_pipeline_is_the_loop_that_finds_its_contacts(name, path):
    steps = Steps(name)
    expected = steps.gradients()
    trajectory = diff.Trajectory(steps.model, STEPS, checkpoint=2 if path == "checkpoints" else 1)
    leaves = [
        getattr(diff, f"state_{n}_tensor")(trajectory[0], requires_grad=True)
        for n in ("body_q", "body_qd")
    ]

    def run():
        with nova.Tape() as tape:
            steps.solver.rollout(trajectory, None, None, DT, pipeline=steps.pipeline)
            tape.backward(weighted(trajectory[STEPS], 2))
            kept = [x.grad * 1.0 for x in leaves]
            tape.zero()
        return kept

    if path == "captured":
        with nova.ScopedCapture() as capture:
            found = run()
        for _ in range(2):
            capture.graph.launch()
    else:
        found = run()
    for got, want in zip(found, expected, strict=False):
        np.testing.assert_allclose(got.numpy(), want, rtol=1e-5, atol=1e-6 * np.abs(want).max())


def test_states_of_a_trajectory_are_known_again():
    steps = Steps("a box on a box")
    trajectory = diff.Trajectory(steps.model, 2)
    contacts = steps.find(trajectory[0])
    assert steps.labels(contacts, trajectory[0]) == {"exact"}
    assert steps.labels(contacts, trajectory[1]) == {"frozen"}
    steps.solver.rollout(trajectory, None, contacts, DT)
    assert steps.labels(contacts, trajectory[0]) == {"exact"}
    trajectory[0].body_q.assign(trajectory[0].body_q.numpy())
    assert steps.labels(contacts, trajectory[0]) == {"frozen"}


def edit_rows(array):
    def edit(steps, contacts):
        rows = getattr(contacts, f"rigid_contact_{array}")
        rows.assign(rows.numpy())
        return contacts

    return edit


def write_state(steps, contacts):
    steps.state.body_q.assign(steps.state.body_q.numpy())
    return contacts


def write_shapes(steps, contacts):
    steps.model.shape_scale.assign(steps.model.shape_scale.numpy())
    return contacts


def view_state(steps, contacts):
    steps.view = steps.state.body_q.numpy(copy=False, writable=True)
    return contacts


def copy_in(steps, contacts):
    loaded = steps.pipeline.contacts()
    loaded.assign(contacts)
    return loaded


def find_of_another_state(steps, contacts):
    steps.pipeline.collide(steps.model.state(), contacts)
    return contacts


def find_captured(steps, contacts):
    with nova.ScopedCapture() as capture:
        steps.pipeline.collide(steps.state, contacts)
    assert steps.labels(contacts) == {"exact"}  # nothing was written
    capture.graph.launch()
    return contacts


ROWS = ("count", "shape0", "shape1", "point0", "point1", "normal", "margin0", "margin1")
HELD = {
    **{f"edited {name}": edit_rows(name) for name in ROWS},
    "state was written": write_state,
    "shapes were written": write_shapes,
    "state can be written from outside": view_state,
    "copied in": copy_in,
    "of another state": find_of_another_state,
    "found by a captured graph": find_captured,
}
FOLLOWS = {
    "as found": lambda steps, contacts: contacts,
    "a clone": lambda steps, contacts: contacts.clone(),
    "forces were written": edit_rows("force"),
    "found again": lambda steps, contacts: steps.find(steps.state),
}


@pytest.mark.parametrize("case", [*HELD, *FOLLOWS])
def test_rows_that_are_not_as_they_were_found_are_held(case):
    """The values are the same in all of these cases, only what is known of them is not."""

    def gradient_of_a_step(make):
        steps = Steps("a box on a box")
        contacts = make(steps, steps.find(steps.state))
        after, q = steps.model.state(), steps.leaves()[0]
        with nova.Tape() as tape:
            steps.solver.step(steps.state, after, None, contacts, DT)
            tape.backward(weighted(after, 2))
        return steps.labels(contacts), q.grad.numpy(), after.body_q.numpy()

    labels, got, end = gradient_of_a_step((HELD | FOLLOWS)[case])
    held = gradient_of_a_step(lambda steps, _: steps.find(steps.model.state()))
    follows = gradient_of_a_step(lambda steps, contacts: contacts)
    assert (held[0], follows[0]) == ({"frozen"}, {"exact"})
    assert np.abs(held[1] - follows[1]).max() > 0.05 * np.abs(follows[1]).max()
    assert labels == ({"frozen"} if case in HELD else {"exact"})
    assert_same_bits(got, (held if case in HELD else follows)[1])
    assert_same_bits(end, held[2])
    assert_same_bits(end, follows[2])


@pytest.mark.parametrize("again", [False, True], ids=["found once", "found in every step"])
@pytest.mark.parametrize("shape", SHAPES, ids=[s[0] for s in SHAPES])
def test_contacts_of_particles_with_bodies_are_held_as_they_were_found(shape, again):
    """In their bodies, with the normal in the world. Differences keep the rows of the middle."""
    height = 1.07 if shape[0] == "cone" else 1.12
    model = particle_and_body(shape, height, 1.0, spin=(0.5, -0.3, 1.0), material=CLOTH)
    pipeline, solver = novaphy.CollisionPipeline(model), diff_solver(model)
    state = model.state()

    def find(at):
        contacts = pipeline.contacts()
        pipeline.collide(at, contacts)
        return contacts

    rows, at = [], model.state()
    for _ in range(STEPS):
        rows.append(find(at) if again or not rows else rows[0])
        after = model.state()
        solver.step(at, after, None, rows[-1], DT)
        at = after
    assert all(contacts.active_soft_contact_count == 1 for contacts in rows)
    on_tape = []

    def run(*_):
        now, first = state, not on_tape
        for k in range(STEPS):
            after = model.state()
            now.clear_forces()
            # The run on the tape finds its contacts itself.
            contacts = find(now) if first and (again or k == 0) else rows[k]
            contacts = on_tape[0] if first and not again and k > 0 else contacts
            on_tape.append(contacts)
            solver.step(now, after, None, contacts, DT)
            now = after
        weights = nova.tensor(np.float32([[0.3, -0.5, 0.8]]))
        x, v = diff.state_particle_q_tensor(now), diff.state_particle_qd_tensor(now)
        return weighted(now, 1) + nova.sum(x * weights) + nova.sum(v * weights)

    leaves = [
        getattr(diff, f"state_{n}_tensor")(state, requires_grad=True)
        for n in ("particle_q", "particle_qd", "body_q", "body_qd")
    ]
    found = nova.gradcheck(run, leaves, epsilon=1e-3, rtol=2e-2, atol=2e-3)
    assert found.ok, found.worst


@pytest.mark.parametrize("way", ["steps", "rollout", "checkpoints"])
def test_articulations_hold_contacts_that_are_given_once(way):
    model = walker().finalize(requires_grad=True)
    solver = solvers.DiffFeatherstoneSolver(model, pgs_iterations=2000, contact_gradient="code")
    pipeline = novaphy.CollisionPipeline(model)
    contacts, dt = pipeline.contacts(), 2e-3

    def run(qd=None):
        """The first state and the last."""
        trajectory = diff.Trajectory(model, STEPS, checkpoint=2 if way == "checkpoints" else 1)
        states = [model.state() for _ in range(STEPS + 1)]
        start = states[0] if way == "steps" else trajectory[0]
        with nova.no_grad():
            novaphy.eval_fk(model, start.joint_q, start.joint_qd, start)
        if qd is None:
            pipeline.collide(start, contacts)
        else:
            start.joint_qd.assign(qd)
        if way != "steps":
            solver.rollout(trajectory, None, contacts, dt)
            return start, trajectory[STEPS]
        for before, after in zip(states, states[1:], strict=False):
            solver.step(before, after, None, contacts, dt)
        return start, states[-1]

    with nova.Tape() as tape:
        start, end = run()
        tape.backward(nova.sum(diff.state_joint_q_tensor(end)))
    assert contacts.active_rigid_contact_count > 2
    gradient, qd = start.joint_qd.grad.numpy(), model.joint_qd.numpy()

    def value(k, change):
        moved = qd.copy()
        moved[k] += np.float32(change)
        return float(run(moved)[1].joint_q.numpy().astype(float).sum())

    expected = np.array([(value(k, 4e-3) - value(k, -4e-3)) / 8e-3 for k in range(gradient.size)])
    np.testing.assert_allclose(gradient, expected, atol=3e-3 * np.abs(expected).max())


@pytest.mark.skipif(not novaphy.has_vbd(), reason="built with NOVAPHY_BUILD_VBD=OFF")
@pytest.mark.parametrize("again", [False, True], ids=["found once", "found in every step"])
def test_vbd_holds_contacts_as_they_were_found(again):
    builder = novaphy.ModelBuilder()
    builder.add_cloth_grid(
        pos=(0, 0, 0.52), dim_x=3, dim_y=3, cell_x=0.1, cell_y=0.1, mass=0.02,
        tri_ke=50.0, tri_ka=50.0, tri_kd=0.01, edge_ke=0.05, edge_kd=1e-4,
    )  # fmt: skip
    surface = novaphy.ShapeConfig(ke=200.0, kd=0.0, mu=0.3)
    builder.add_shape_sphere(
        -1, xform=(0.15, 0.15, 0.0, 0.0, 0.0, 0.0, 1.0), radius=0.48, cfg=surface
    )
    builder.color()
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model, soft_contact_margin=0.1)
    solver = solvers.DiffSolverVBD(model, iterations=20)
    dt = 1 / 120
    weights = np.random.default_rng(3).normal(size=(model.particle_count, 3))

    def run(start, contacts_of):
        for k in range(STEPS):
            after = model.state()
            solver.step(start, after, None, contacts_of(k, start), dt)
            start = after
        return start

    rows = []

    def find(k, state):
        if again or not rows:
            rows.append(pipeline.contacts())
            with nova.no_grad():
                pipeline.collide(state, rows[-1])
        return rows[-1]

    start = model.state(requires_grad=True)
    start.particle_qd.assign(np.full((model.particle_count, 3), (0.1, 0.05, -0.5), np.float32))
    with nova.Tape() as tape:
        loss = nova.sum(
            diff.state_particle_q_tensor(run(start, find)) * nova.tensor(weights.astype(np.float32))
        )
    tape.backward(loss)
    assert all(contacts.active_soft_contact_count > 4 for contacts in rows)
    assert len(rows) == (STEPS if again else 1)
    differences = np.random.default_rng(5)
    for name, size in (("particle_q", 1e-4), ("particle_qd", 5e-3)):
        gradient = getattr(start, name).grad.numpy().astype(float)
        for _ in range(4):
            along = differences.normal(size=gradient.shape)
            ends = []
            for sign in (1, -1):
                moved = model.state()
                moved.particle_q.assign(start.particle_q.numpy())
                moved.particle_qd.assign(start.particle_qd.numpy())
                array = getattr(moved, name)
                array.assign((array.numpy() + sign * size * along).astype(np.float32))
                end = run(moved, lambda k, _: rows[k if again else 0])
                ends.append((end.particle_q.numpy().astype(float) * weights).sum())
            expected = (ends[0] - ends[1]) / (2 * size)
            scale = np.linalg.norm(gradient)
            assert (gradient * along).sum() == pytest.approx(expected, rel=2e-2, abs=1e-2 * scale)


@pytest.mark.parametrize("given", ["contacts", "pipeline"])
def test_a_rollout_of_the_forward_solver_has_no_gradient_and_says_so(given):
    steps = Steps("a box on a box")
    trajectory = diff.Trajectory(steps.model, STEPS)
    contacts = steps.find(trajectory[0]) if given == "contacts" else None
    pipeline = steps.pipeline if given == "pipeline" else None
    forward = solvers.SolverSemiImplicit(steps.model)
    start = trajectory[0].body_q.numpy()
    with nova.Tape(), pytest.raises(novaphy.Error, match="rollout inside an active Tape"):
        forward.rollout(trajectory, None, contacts, DT, pipeline=pipeline)
    assert_same_bits(trajectory[1].body_q.numpy(), np.zeros_like(start))
    forward.rollout(trajectory, None, contacts, DT, pipeline=pipeline)
    assert (trajectory[STEPS].body_q.numpy() != start).any()
