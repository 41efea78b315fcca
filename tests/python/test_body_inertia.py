"""Inertias at the edge of what a body has: thin bodies, and what finalize mends."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import novaphy
from novaphy import solvers

SIDES = (1e-6, 1.0, 1e5)  # m, half extents


def of_one_body(settings=None, **body):
    builder = novaphy.ModelBuilder()
    for name, value in (settings or {}).items():
        setattr(builder, name, value)
    builder.add_body(**body)
    return builder


@pytest.mark.parametrize("sides", [SIDES, SIDES[::-1], (1.0, 1e5, 1.0)])
def test_a_thin_box_has_the_inertia_of_the_closed_form(sides):
    builder = of_one_body()
    builder.add_shape_box(0, hx=sides[0], hy=sides[1], hz=sides[2])
    model = builder.finalize()
    mass = 8000.0 * np.prod(sides)
    squares = np.square(sides)
    inertia = np.diag(mass / 3.0 * (squares.sum() - squares))
    np.testing.assert_allclose(model.body_inertia.numpy()[0], inertia, rtol=1e-6)
    inverse = np.diag(1.0 / np.diag(inertia))
    np.testing.assert_allclose(model.body_inv_inertia.numpy()[0], inverse, rtol=1e-6)


@pytest.mark.parametrize("solver", ["SolverSemiImplicit", "SolverFeatherstone"])
def test_a_thin_box_spins_about_its_long_axis(solver):
    builder = of_one_body()
    builder.add_shape_box(0, hx=SIDES[0], hy=SIDES[1], hz=SIDES[2])
    builder.body_qd[0] = (0, 0, 0, 0, 0, 3.0)
    model = builder.finalize()
    model.set_gravity((0, 0, 0))
    stepper = getattr(solvers, solver)(model, angular_damping=0.0)
    a, b = model.state(), model.state()
    for _ in range(100):
        stepper.step(a, b, None, None, 1e-3)
        a, b = b, a
    np.testing.assert_allclose(a.body_qd.numpy()[0], (0, 0, 0, 0, 0, 3.0), atol=3e-4)  # rounding
    half = 0.5 * 3.0 * 0.1
    turned = (0, 0, np.sin(half), np.cos(half))
    np.testing.assert_allclose(a.body_q.numpy()[0, 3:], turned, atol=1e-4)


def test_a_moment_that_rounding_loses_is_refused():
    turn = (0.0, 0.0, np.sin(np.pi / 8), np.cos(np.pi / 8))
    builder = of_one_body()
    builder.add_shape_box(0, xform=((0, 0, 0), turn), hx=SIDES[2], hy=SIDES[1], hz=SIDES[0])
    with pytest.raises(
        ValueError, match=r"body_inertia\[0\].*positive definite matrix, to float32"
    ):
        builder.finalize()


def rotated(diagonal):
    q, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    return q @ np.diag(diagonal) @ q.T


def moments_of(builder, warned):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        model = builder.finalize()
    assert [w.category for w in said] == [RuntimeWarning] * len(warned)
    for text, w in zip(warned, said, strict=True):
        assert text in str(w.message)
    inertia = model.body_inertia.numpy()[0].astype(np.float64)
    np.testing.assert_allclose(model.body_inv_inertia.numpy()[0] @ inertia, np.eye(3), atol=1e-5)
    return np.linalg.eigvalsh(inertia), model


def test_an_inertia_that_breaks_the_triangle_inequality_is_balanced_along_its_axes():
    before = rotated((1.0, 1.0, 3.0))
    moments, model = moments_of(of_one_body(mass=1.0, inertia=before), ["body_inertia[0] (body_0)"])
    np.testing.assert_allclose(moments, (2.0, 2.0, 4.0), rtol=1e-6)
    np.testing.assert_allclose(model.body_inertia.numpy()[0] - before, np.eye(3), atol=1e-6)
    moments, _ = moments_of(of_one_body({}, mass=1.0, inertia=rotated((1.0, 2.0, 3.0))), [])
    np.testing.assert_allclose(moments, (1.0, 2.0, 3.0), rtol=1e-6)


def test_shapes_may_mend_what_a_base_breaks():
    builder = of_one_body({}, mass=1.0, inertia=np.diag((1.0, 1.0, 3.0)))
    builder.add_shape_box(0, hx=0.1, hy=1.0, hz=1.0)
    moments_of(builder, [])


def test_without_balance_it_is_an_error():
    with pytest.raises(ValueError, match="add_body: inertia: .*none of which exceeds the sum"):
        of_one_body({"balance_inertia": False}, mass=1.0, inertia=np.diag((1.0, 1.0, 3.0)))
    builder = of_one_body({}, mass=1.0, inertia=np.diag((1.0, 1.0, 3.0)))
    builder.balance_inertia = False
    with pytest.raises(ValueError, match=r"finalize: body_inertia\[0\]: .*none of which exceeds"):
        builder.finalize()


def test_bounds_raise_small_masses_and_moments():
    settings = {"bound_mass": 0.5, "bound_inertia": 1e-2}
    inertia = rotated((1e-3, 2e-2, 2e-2))
    builder = of_one_body(settings, mass=0.25, inertia=inertia)
    moments, model = moments_of(builder, ["body_mass[0] (body_0)", "body_inertia[0]"])
    assert model.body_mass.numpy()[0] == 0.5
    assert model.body_inv_mass.numpy()[0] == 2.0
    np.testing.assert_allclose(moments, (1e-2, 2.9e-2, 2.9e-2), rtol=1e-5)
    point = of_one_body({"bound_inertia": 1e-2}, mass=1.0)
    np.testing.assert_allclose(moments_of(point, ["body_inertia[0]"])[0], [1e-2] * 3, rtol=1e-6)
    large = of_one_body(settings, mass=0.5, inertia=np.diag((1e-2, 2e-2, 2e-2)))
    moments_of(large, [])


def test_kinematic_bodies_and_links_without_mass_keep_what_they_have():
    builder = novaphy.ModelBuilder()
    builder.bound_mass, builder.bound_inertia = 1.0, 1.0
    builder.add_body(is_kinematic=True, mass=0.5, inertia=np.diag((1.0, 1.0, 1.9)))
    child = builder.add_link()
    builder.add_joint_fixed(0, child)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = builder.finalize()
    np.testing.assert_array_equal(model.body_mass.numpy(), (0.5, 0.0))


def test_moments_that_float32_cannot_invert_are_refused():
    for moment in (1e-31, 1e-40):
        with pytest.raises(
            ValueError, match=r"inertia: expected moments of at least 1e-30 kg m\^2"
        ):
            of_one_body(mass=1.0, inertia=np.eye(3) * moment)
    inverse = of_one_body(mass=1.0, inertia=np.eye(3) * 1e-30).finalize().body_inv_inertia.numpy()
    np.testing.assert_allclose(inverse[0], np.eye(3) * 1e30, rtol=1e-6)


@pytest.mark.parametrize("name", ["bound_mass", "bound_inertia"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_a_bound_that_is_none_is_refused(name, value):
    with pytest.raises(ValueError, match=f"finalize: {name}: expected a finite number > 0"):
        of_one_body({name: value}, mass=1.0).finalize()
