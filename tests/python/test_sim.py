"""Model, SimState, Control, Contacts and the collision pipeline from Python."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from scenes import ball_contacts, ball_model

import novaphy
from novaphy import CollisionPipeline, Contacts, SimState


def test_fields_are_the_arrays_themselves():
    state = ball_model(3).state()
    assert state.particle_q.shape == (3, 3) and state.particle_q.ptr == state.particle_q.ptr
    before = state.particle_q.version
    state.particle_q = np.ones((3, 3), np.float32)
    assert state.particle_q.version > before
    np.testing.assert_array_equal(state.particle_q.numpy(), np.ones((3, 3)))
    state.particle_q = [(1, 2, 3)] * 3
    state.particle_q[1] = (7, 8, 9)
    np.testing.assert_array_equal(state.particle_q.numpy(), [[1, 2, 3], [7, 8, 9], [1, 2, 3]])
    state.particle_q.fill_(0.0)
    assert not state.particle_q.numpy().any()


@pytest.mark.parametrize(
    ("value", "error"),
    [
        (np.zeros((3, 4), np.float32), ValueError),
        (np.zeros((2, 3), np.float32), ValueError),
        (np.zeros((4, 3), np.float32), ValueError),
        (np.zeros((3, 3), np.complex64), TypeError),
        (None, TypeError),
        ("abc", (TypeError, ValueError)),
        (object(), TypeError),
    ],
)
def test_a_bad_assignment_is_refused_and_changes_nothing(value, error):
    state = ball_model(3).state()
    before, version = state.particle_q.numpy(), state.particle_q.version
    with pytest.raises(error):
        state.particle_q = value
    np.testing.assert_array_equal(state.particle_q.numpy(), before)
    assert state.particle_q.version == version


def test_arrays_of_what_the_model_does_not_have_are_empty():
    model = ball_model()
    state, control = model.state(), model.control()
    assert state.body_q.shape == (0, 7) and state.body_qd.shape == (0, 6)
    assert state.joint_q.shape == (0,) and control.joint_f.shape == (0,)
    assert control.particle_tet_activation.shape == control.tri_activations.shape == (0,)
    assert model.body_count == state.body_count == 0 and model.world_count == 1


def test_every_field_is_documented():
    for owner in (novaphy.Model, SimState, novaphy.Control, Contacts):
        for name in dir(owner):
            member = getattr(owner, name)
            if not name.startswith("_"):
                assert member.__doc__, f"{owner.__name__}.{name}"
    doc = SimState.particle_qd.__doc__
    assert "vec3 {particle_count}" in doc and "m/s" in doc and "world frame" in doc


def test_settings_are_plain_numbers():
    model = ball_model()
    assert model.soft_contact_ke == 1e4 and model.soft_contact_restitution == 1
    assert model.particle_max_velocity == 1e5 and model.particle_max_radius == np.float32(0.1)
    model.particle_adhesion = 0.5
    assert model.particle_adhesion == 0.5 and model.up_axis == 2 and str(model.device) == "cpu"
    with pytest.raises(TypeError):
        model.soft_contact_ke = "stiff"
    with pytest.raises(AttributeError):
        model.particle_count = 3
    for name, bad in [
        ("soft_contact_ke", float("nan")),
        ("soft_contact_mu", -3.0),
        ("particle_max_velocity", -1.0),
        ("particle_adhesion", float("inf")),
    ]:
        before = getattr(model, name)
        with pytest.raises(ValueError, match=rf"Model\.{name}: expected a .*number >= 0, got"):
            setattr(model, name, bad)
        assert getattr(model, name) == before
    model.particle_max_velocity = float("inf")


def test_inverse_masses_follow_the_masses():
    model = ball_model(2)
    model.particle_mass.assign(np.array([4.0, 0.0], np.float32))
    np.testing.assert_array_equal(model.particle_inv_mass.numpy(), [0.25, 0.0])
    # The last assignment stays: of both arrays here, and of the masses in the copy.
    model.particle_mass.assign(np.array([2.0, 5.0], np.float32))
    model.particle_inv_mass = np.zeros(2, np.float32)
    assert not model.particle_inv_mass.numpy().any()
    model.particle_mass = np.array([1.0, 2.0], np.float32)
    np.testing.assert_array_equal(model.particle_inv_mass.numpy(), [1.0, 0.5])


def test_gravity_can_be_set():
    model = ball_model()
    model.set_gravity((0, 0, -1))
    np.testing.assert_array_equal(model.gravity.numpy(), [[0, 0, -1]])
    model.set_gravity(np.array([1.0, 0, 0]), world=0)
    with pytest.raises(IndexError, match="world"):
        model.set_gravity((0, 0, 0), world=1)
    with pytest.raises(ValueError, match="finite"):
        model.set_gravity((0, float("nan"), 0))
    np.testing.assert_array_equal(model.gravity.numpy(), [[1, 0, 0]])


def test_states_are_cleared_assigned_and_cloned():
    model = ball_model(2)
    a, b = model.state(), model.state()
    a.particle_q.fill_(3.0)
    a.particle_f.fill_(2.0)
    b.assign(a)
    copy = a.clone()
    a.clear_forces()
    assert not a.particle_f.numpy().any()
    for other in (b, copy):
        assert (other.particle_q.numpy() == 3).all() and (other.particle_f.numpy() == 2).all()
    with pytest.raises(ValueError, match="particle_q"):
        a.assign(ball_model(3).state())
    with pytest.raises(TypeError):
        a.assign(None)
    assert novaphy.State is SimState


def test_models_are_copied():
    model = ball_model()
    copy, other = model.clone(), model.to("cpu")
    copy.particle_mass.fill_(5.0)
    copy.soft_contact_ke = 1.0
    assert model.particle_mass[0] == other.particle_mass[0] == 1 and model.soft_contact_ke == 1e4
    assert copy.shape_label == model.shape_label


def test_removed_names_say_the_new_one():
    control = ball_model().control()
    control.clear()
    control.clear(ball_model())
    with pytest.raises(AttributeError, match="use joint_target_q"):
        _ = control.joint_target_pos
    with pytest.raises(AttributeError, match="joint_target_qd"):
        _ = control.joint_target_vel
    with pytest.raises(NotImplementedError):
        ball_model().control(clone_variables=False)


# ---------------------------------------------------------------------------- contacts


def test_contacts_have_a_row_for_each_contact():
    model = ball_model(2)
    state = model.state()
    contacts = ball_contacts(model, state)
    rows = contacts.soft_contacts()
    assert rows.dtype.names == ("particle", "shape", "body_pos", "body_vel", "normal")
    assert list(rows["particle"]) == [0, 1, 0, 1] and list(rows["shape"]) == [0, 0, 1, 1]
    np.testing.assert_array_equal(rows["normal"][2], [0, 0, 1])
    assert contacts.soft_contact_count[0] == contacts.active_soft_contact_count == 4
    assert contacts.soft_contact_max == contacts.soft_contact_pair_count == 4
    assert not contacts.overflowed
    generation = contacts.contact_generation[0]
    contacts.clear()
    assert contacts.contact_generation[0] > generation and len(contacts.soft_contacts()) == 0
    assert (contacts.soft_contact_particle.numpy() == -1).all()


def test_more_contacts_than_slots_are_reported():
    model = ball_model(3)
    pipeline = CollisionPipeline(model, soft_contact_margin=10.0, soft_contact_max=2)
    contacts = pipeline.contacts()
    pipeline.collide(model.state(), contacts)
    assert contacts.soft_contact_count[0] == 6 and contacts.overflowed
    assert contacts.active_soft_contact_count == len(contacts.soft_contacts()) == 2
    solver = novaphy.solvers.DiffSemiImplicitSolver(model)
    with pytest.raises(novaphy.Error, match="soft_contact_max"):
        solver.step(model.state(), model.state(), None, contacts, 0.01)


def test_the_pipeline_says_what_it_does_not_take():
    model = ball_model()
    for options, error, message in [
        ({"broad_phase": "grid"}, ValueError, "broad_phase"),
        ({"soft_contact_margin": -1.0}, ValueError, "margin"),
        ({"soft_contact_margin": float("nan")}, ValueError, "margin"),
        ({"soft_contact_margin": 1.0, "soft_contact_gap": 1.0}, ValueError, "soft_contact_gap"),
        ({"soft_contact_max": -1}, ValueError, "soft_contact_max"),
        ({"rigid_contact_max": -5}, ValueError, "rigid_contact_max"),
        ({"margin": 1.0}, TypeError, "margin"),
    ]:
        with pytest.raises(error, match=message):
            CollisionPipeline(model, **options)
    with pytest.raises(TypeError):
        CollisionPipeline(None)
    with pytest.raises(TypeError):
        CollisionPipeline(model, "explicit")
    assert CollisionPipeline(model, soft_contact_gap=2.0).soft_contact_margin == 2.0
    pipeline = CollisionPipeline(model, broad_phase="nxn")
    assert pipeline.model is model and pipeline.broad_phase == "nxn"
    assert pipeline.rigid_contact_max == 0 and pipeline.soft_contact_pair_count == 2


def test_states_and_contacts_of_another_model_are_refused():
    model, other = ball_model(), ball_model()
    pipeline = CollisionPipeline(model)
    contacts = pipeline.contacts()
    before = contacts.soft_contact_particle.version
    for arguments in (
        (other.state(), contacts),
        (model.state(), CollisionPipeline(other).contacts()),
        (model.state(), Contacts(0, 2)),
    ):
        with pytest.raises(ValueError):
            pipeline.collide(*arguments)
    with pytest.raises(ValueError, match="margin"):
        pipeline.collide(model.state(), contacts, soft_contact_margin=float("inf"))
    assert contacts.soft_contact_particle.version == before
    with pytest.raises(ValueError):
        Contacts(0, -1)
    with pytest.raises(ValueError):
        Contacts(-1, 0)


def test_a_model_finds_contacts_itself():
    model = ball_model()
    state = model.state()
    state.particle_q.assign([(0, 0, 0.05)])
    contacts = model.collide(state)
    assert len(contacts.soft_contacts()) == 1
    assert model.collide(state, contacts) is contacts
    pipeline = CollisionPipeline(model, soft_contact_margin=10.0)
    assert len(model.collide(state, collision_pipeline=pipeline).soft_contacts()) == 2
    assert model.contacts().soft_contact_max == model.contacts(pipeline).soft_contact_max == 2


# ---------------------------------------------------------------------------- solver checks


def bad_steps():
    """Arguments that no solver takes, with what the message names."""
    model, other = ball_model(), ball_model()
    a, b = model.state(), model.state()
    for dt in (0.0, -0.01, float("nan"), float("inf")):
        yield (a, b, None, None, dt), ValueError, "dt"
    yield (a, b, None, None, "0.1"), TypeError, "step"
    yield (a, b, None, None), TypeError, "step"
    yield (a, None, None, None, 0.01), TypeError, "step"
    yield (a, b, a, None, 0.01), TypeError, "step"
    yield (other.state(), b, None, None, 0.01), ValueError, "state_in"
    yield (a, other.state(), None, None, 0.01), ValueError, "state_out"
    yield (a, b, other.control(), None, 0.01), ValueError, "control"
    yield (a, b, None, other.contacts(), 0.01), ValueError, "contacts"
    yield model, None, None


@pytest.mark.parametrize("name", ["SolverSemiImplicit", "DiffSemiImplicitSolver"])
def test_a_bad_step_is_refused_and_changes_nothing(name):
    cases = list(bad_steps())
    model = cases.pop()[0]
    solver = getattr(novaphy.solvers, name)(model)
    for arguments, error, message in cases:
        states = [s for s in arguments[:2] if s is not None]
        before = [s.particle_q.version for s in states]
        with pytest.raises(error, match=message):
            solver.step(*arguments)
        assert [s.particle_q.version for s in states] == before


@pytest.mark.parametrize("name", ["SolverSemiImplicit", "DiffSemiImplicitSolver"])
def test_a_step_takes_keywords_and_any_real_number(name):
    model = ball_model()
    solver = getattr(novaphy.solvers, name)(model)
    a, b = model.state(), model.state()
    contacts = ball_contacts(model, a)
    results = []
    for call in (
        lambda: solver.step(a, b, None, contacts, 0.0078125),
        lambda: solver.step(a, b, model.control(), contacts, dt=np.float32(0.0078125)),
        lambda: solver.step(
            state_in=a, state_out=b, control=None, contacts=contacts, dt=np.float64(0.0078125)
        ),
    ):
        a.clear_forces()
        call()
        results.append(b.particle_q.numpy())
    assert (results[0] == results[1]).all() and (results[0] == results[2]).all()
    assert solver.model is model and str(solver.device) == "cpu"
    assert isinstance(solver, novaphy.solvers.SolverBase)
    assert solver.supports_graph_capture in (True, False)
    solver.notify_model_changed(novaphy.ModelFlags.SHAPE_PROPERTIES)
    with pytest.raises(TypeError):
        getattr(novaphy.solvers, name)(None)
    with pytest.raises(TypeError):
        getattr(novaphy.solvers, name)(model, unknown_option=1)


def test_both_solvers_give_the_same_bits():
    model = ball_model(5)
    contacts = ball_contacts(model, model.state())
    ends = []
    for name in ("SolverSemiImplicit", "DiffSemiImplicitSolver"):
        solver = getattr(novaphy.solvers, name)(model)
        a, b = model.state(), model.state()
        for _ in range(200):
            a.clear_forces()
            solver.step(a, b, None, contacts, 1 / 480)
            a, b = b, a
        ends.append(a)
    novaphy.testing.assert_same_bits(ends[0].particle_q, ends[1].particle_q)
    novaphy.testing.assert_same_bits(ends[0].particle_qd, ends[1].particle_qd)


def test_solver_options_are_checked():
    model = ball_model()
    solver = novaphy.solvers.SolverSemiImplicit(model, angular_damping=0.5)
    assert solver.angular_damping == 0.5 and solver.enable_tri_contact
    assert solver.friction_law == "viscous"
    assert (solver.joint_attach_ke, solver.joint_attach_kd) == (1e4, 1e2)
    with pytest.raises(ValueError, match="angular_damping"):
        novaphy.solvers.SolverSemiImplicit(model, angular_damping=-1.0)
    config = novaphy.solvers.DiffSolverConfig(enable_particle_contacts=False)
    config.strict = False
    made = novaphy.solvers.DiffSemiImplicitSolver(model, config)
    assert not made.config.strict and not made.config.enable_particle_contacts
    config = novaphy.solvers.DiffSolverConfig(static_contact_margin=-1.0)
    with pytest.raises(ValueError, match="static_contact_margin"):
        novaphy.solvers.DiffSemiImplicitSolver(model, config)
    with pytest.raises(TypeError):
        novaphy.solvers.DiffSolverConfig(True)


@pytest.mark.parametrize("law", ["huber", "newton17"])
def test_laws_that_take_a_friction_smoothing_read_it(law):
    """A sphere that slips on the ground."""
    surface = novaphy.ShapeConfig(ke=1e4, kd=300.0, kf=500.0, mu=0.5)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=surface)
    body = builder.add_body(xform=(0, 0, 0.0995, 0, 0, 0, 1))
    builder.add_shape_sphere(body, radius=0.1, cfg=surface)
    builder.body_qd[body] = (0.5, 0, 0, 0, 0, 0)
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model)
    contacts, state = pipeline.contacts(), model.state()
    pipeline.collide(state, contacts)
    speeds = []
    for smoothing in (None, 0.1, 1.0):
        after = model.state()
        solver = novaphy.solvers.SolverSemiImplicit(
            model, friction_law=law, friction_smoothing=smoothing
        )
        solver.step(state, after, None, contacts, 1e-3)
        speeds.append(float(after.body_qd.numpy()[0, 0]))
    assert speeds[0] == speeds[1] < 0.5
    assert speeds[2] > speeds[1] + 5e-5  # friction is weaker


def test_the_friction_law_of_a_differentiable_solver_is_checked():
    model, config = ball_model(), novaphy.solvers.DiffSolverConfig
    assert (config().friction_law, config().friction_smoothing) == ("viscous", None)
    made = novaphy.solvers.DiffSemiImplicitSolver(
        model, config(friction_law="huber", friction_smoothing=0.25)
    )
    assert (made.config.friction_law, made.config.friction_smoothing) == ("huber", 0.25)
    for name, value in (("friction_smoothing", 0.5), ("friction_law", "viscous"), ("strict", True)):
        with pytest.raises(AttributeError, match=f"DiffSolverConfig.{name}.*make another solver"):
            setattr(made.config, name, value)
    assert (made.config.friction_law, made.config.friction_smoothing) == ("huber", 0.25)
    with pytest.raises(ValueError, match='friction_law: expected "viscous".*got "coulomb"'):
        config(friction_law="coulomb")
    for given, error, message in (
        ({"friction_smoothing": 0.1}, ValueError, "friction_smoothing: expected none"),
        ({"friction_law": "huber", "friction_smoothing": -1.0}, ValueError, "finite number >= 0"),
        ({"friction_law": "newton17"}, NotImplementedError, "friction_law.*newton17"),
    ):
        with pytest.raises(error, match=message):
            novaphy.solvers.DiffSemiImplicitSolver(model, config(**given))


def test_what_an_object_refers_to_stays_alive():
    solver = novaphy.solvers.DiffSemiImplicitSolver(ball_model())
    pipeline = CollisionPipeline(solver.model)
    gc.collect()
    a, b = solver.model.state(), solver.model.state()
    solver.step(a, b, None, pipeline.contacts(), 0.01)
    state = novaphy.diff.Trajectory(ball_model(), 3)[0]
    gc.collect()
    state.clear_forces()
    assert state.particle_q.shape == (1, 3)
