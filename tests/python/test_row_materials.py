"""Rows of contacts with a stiffness, a damping and a coefficient of friction of their own."""

from __future__ import annotations

import numpy as np
import pytest
from test_articulation_contact_gradients import walker
from test_body_contacts import SURFACE, TWO_BODIES, Step, diff_solver, make_model

import novaphy
from novaphy import diff, nova, solvers
from novaphy.testing import assert_same_bits

DT = 1 / 960
OTHER = novaphy.ShapeConfig(ke=4e3, kd=90.0, kf=500.0, mu=0.2)
# For each array: its setting, that of OTHER, and the step of the differences.
ARRAYS = {
    "rigid_contact_stiffness": ("ke", 4e3, 20.0),
    "rigid_contact_damping": ("kd", 90.0, 2.0),
    "rigid_contact_friction": ("mu", 0.2, 2e-3),
}
LAWS = {"viscous": {}, "huber": {"friction_law": "huber"}, "newton17": {"friction_law": "newton17"}}


def sliding(surface):
    """A box that slides in on its lower corners, so that all of a material acts."""
    pose = (0, 0, 0.095, 0.02, 0.01, 0.3, np.sqrt(1 - 0.0905))
    return make_model(("box", pose, (0.6, 0.1, -0.2, 0.3, 0.1, -0.4)), surface=surface)


def found(model, of_rows, state=None):
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts(per_contact_shape_properties=of_rows)
    pipeline.collide(state or model.state(), contacts)
    return contacts


def stepped(solver, model, contacts):
    state, after = model.state(), model.state()
    solver.step(state, after, None, contacts, DT)
    return np.concatenate([after.body_q.numpy(), after.body_qd.numpy()], axis=1)


def write_other(contacts):
    for array, (_, value, _) in ARRAYS.items():
        getattr(contacts, array).fill_(value)


@pytest.mark.parametrize("law", LAWS)
def test_a_row_with_the_material_of_other_shapes_has_their_bits(law):
    """And one with zeros those of its own shapes, in the forward and the differentiable solver."""
    model, other = sliding(SURFACE), sliding(OTHER)
    ways = [lambda m: solvers.SolverSemiImplicit(m, **LAWS[law])]
    if law != "newton17":
        config = solvers.DiffSolverConfig(**LAWS[law])
        ways.append(lambda m: solvers.DiffSemiImplicitSolver(m, config))
    for make in ways:
        contacts = found(model, True)
        assert contacts.per_contact_shape_properties
        plain = stepped(make(model), model, found(model, False))
        assert_same_bits(stepped(make(model), model, contacts), plain)
        write_other(contacts)
        theirs = stepped(make(other), other, found(other, False))
        assert_same_bits(stepped(make(model), model, contacts), theirs)
        assert (theirs != plain).any()


def test_one_row_alone_may_differ():
    """The stiffness of one corner of four: the box turns towards the others."""
    model = make_model(("box", (0, 0, 0.095, 0, 0, 0, 1), (0,) * 6), gravity=(0, 0, 0))
    contacts = found(model, True)
    stiffness = np.zeros(contacts.rigid_contact_max, np.float32)
    stiffness[0] = 3e4
    contacts.rigid_contact_stiffness = stiffness
    stepped(solvers.SolverSemiImplicit(model), model, contacts)
    lift = contacts.rigid_contacts()["force"][:, 2]
    np.testing.assert_allclose(lift, [150.0, 50.0, 50.0, 50.0], rtol=1e-5)


def test_materials_belong_to_the_rows_of_one_search():
    model = sliding(SURFACE)
    contacts = found(model, True)
    write_other(contacts)
    copy = contacts.clone()
    assert (copy.rigid_contact_friction.numpy() == np.float32(0.2)).all()
    novaphy.CollisionPipeline(model).collide(model.state(), contacts)
    copy.clear()
    for name in ARRAYS:
        assert not getattr(contacts, name).numpy().any() and not getattr(copy, name).numpy().any()
    with pytest.raises(ValueError, match="rigid_contact_stiffness"):
        contacts.assign(found(model, False))
    assert len(found(model, False).rigid_contact_stiffness) == 0
    made = novaphy.Contacts(rigid_contact_max=5, per_contact_shape_properties=True)
    assert len(made.rigid_contact_damping) == 5


class OwnStep(Step):
    """A step whose rows have materials of their own."""

    def __init__(self, model, smoothing):
        super().__init__(model, again=False, smoothing=smoothing)
        self.contacts = found(model, True)
        for k, (array, (_, value, _)) in enumerate(ARRAYS.items()):
            rows = np.arange(self.contacts.rigid_contact_max)
            values = value * (1 + 0.1 * np.cos(rows + k))
            values[1::3] = 0.0  # these have their shapes' material
            setattr(self.contacts, array, np.float32(values))


@pytest.mark.filterwarnings("ignore:DiffSemiImplicitSolver. dt")  # one step of 0.01 s
@pytest.mark.parametrize("smoothing", [0.0, 0.1], ids=["viscous", "huber"])
@pytest.mark.parametrize("name", ["a box on a box", "edges of two boxes", "on the ground"])
def test_gradients_equal_the_differences(name, smoothing):
    ground = name == "on the ground"
    model = sliding(SURFACE) if ground else make_model(*TWO_BODIES[name], ground=False)
    step = OwnStep(model, smoothing)
    rows = step.contacts.rigid_contact_count.numpy()[0]
    for array in ARRAYS:
        getattr(step.contacts, array).requires_grad = True
    model.shape_material_ke.requires_grad = True
    with nova.Tape() as tape:
        tape.backward(step())
    some = False
    for array, (_, _, size) in ARRAYS.items():
        values = getattr(step.contacts, array).numpy()
        got = getattr(step.contacts, array).grad.numpy()[:rows].astype(float)
        assert not got[values[:rows] == 0].any(), "the shapes' material has that gradient"
        differences = np.zeros(rows)
        for row in np.flatnonzero(values[:rows]):
            ends = []
            for sign in (1, -1):
                moved = values.copy()
                moved[row] += np.float32(sign * size)
                setattr(step.contacts, array, moved)
                ends.append(step().item())
            differences[row] = (ends[0] - ends[1]) / (2 * size)
        setattr(step.contacts, array, values)
        some = some or differences.any()
        largest = np.abs(differences).max()
        np.testing.assert_allclose(
            got, differences, rtol=2e-2, atol=2e-2 * largest + 4e-7 / size, err_msg=array
        )
    assert some
    assert model.shape_material_ke.grad.numpy().any() == (rows > 1)


def test_a_rollout_with_given_contacts_reads_them_as_its_steps_do():
    model = sliding(SURFACE)
    contacts = found(model, True)
    write_other(contacts)
    trajectory = diff.Trajectory(model, 5)
    diff_solver(model).rollout(trajectory, None, contacts, DT)
    forward = diff.Trajectory(model, 5)
    law = {"friction_law": "huber", "friction_smoothing": 0.1}
    solvers.SolverSemiImplicit(model, **law).rollout(forward, None, contacts, DT)
    with_shapes = diff.Trajectory(model, 5)
    diff_solver(model).rollout(with_shapes, None, found(model, False), DT)
    end = trajectory[5].body_qd.numpy()
    assert_same_bits(forward[5].body_qd.numpy(), end)
    assert (with_shapes[5].body_qd.numpy() != end).any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
@pytest.mark.parametrize("array", ARRAYS)
def test_a_material_that_no_row_has_is_named(array, bad):
    model = sliding(SURFACE)
    contacts = found(model, True)
    values = getattr(contacts, array).numpy()
    values[2] = bad
    setattr(contacts, array, values)
    for solver in (solvers.SolverSemiImplicit(model), diff_solver(model)):
        with pytest.raises(ValueError, match=rf"contacts.{array}\[2\]: expected a finite number"):
            stepped(solver, model, contacts)


def test_where_they_are_not_read_they_are_refused():
    model = sliding(SURFACE)
    pipeline = novaphy.CollisionPipeline(model)
    contacts, state = pipeline.contacts(per_contact_shape_properties=True), model.state()
    with (
        pytest.raises(NotImplementedError, match="per_contact_shape_properties cannot be rec"),
        nova.ScopedCapture(),
    ):
        pipeline.collide(state, contacts)
    tree = walker().finalize()
    contacts = novaphy.CollisionPipeline(tree).contacts(per_contact_shape_properties=True)
    for make in (solvers.SolverFeatherstone, solvers.DiffFeatherstoneSolver):
        with pytest.raises(NotImplementedError, match="per_contact_shape_properties"):
            make(tree).step(tree.state(), tree.state(), None, contacts, DT)
