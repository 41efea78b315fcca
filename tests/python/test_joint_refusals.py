"""What ModelBuilder refuses of joints and articulated bodies; it stays as it was."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

INERTIA = 0.1 * np.eye(3)
# The link 7 of the FR3 as published (kg m^2): its smallest principal moment is 5.6e-7, and the
# largest two differ from their bound by rounding.
FR3_LINK_7 = np.array(
    [
        [2.1092389150104718e-4, -2.433299114461931e-5, 4.564480393778983e-5],
        [-2.433299114461931e-5, 1.7718568002411474e-4, 8.744070223226438e-5],
        [4.564480393778983e-5, 8.744070223226438e-5, 5.993190599659971e-5],
    ]
)
NAN, INF = float("nan"), float("inf")


def two_links(**last: object) -> novaphy.ModelBuilder:
    builder = novaphy.ModelBuilder()
    builder.add_link(mass=1.0, inertia=INERTIA)
    builder.add_link(**({"mass": 1.0, "inertia": INERTIA} | last))
    return builder


def chain(**last: object) -> novaphy.ModelBuilder:
    builder = two_links(**last)
    joints = [builder.add_joint_revolute(-1, 0), builder.add_joint_revolute(0, 1, axis="y")]
    builder.add_articulation(joints)
    return builder


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, NAN) for name in ("limit_lower", "limit_upper", "target_q", "target_qd")),
        ("limit_lower", -INF),
        *(
            (name, value)
            for name in (
                "limit_ke", "limit_kd", "target_ke", "target_kd", "damping", "armature",
                "effort_limit", "velocity_limit", "friction",
            )
            for value in (-1.0, NAN, INF)
        ),
    ],
)  # fmt: skip
def test_bad_numbers_of_a_joint_are_named(kind, name, value):
    builder = two_links()
    with pytest.raises(ValueError, match=f"add_joint_{kind}: {name}: expected a finite number"):
        getattr(builder, f"add_joint_{kind}")(-1, 0, **{name: value})
    assert builder.joint_count == builder.joint_dof_count == len(builder.joint_q) == 0


def test_reversed_limits_are_refused_where_they_are_given_and_where_they_are_edited():
    builder = chain()
    with pytest.raises(ValueError, match=r"expected the lower one first, got 1 and 0\.5"):
        builder.add_joint_revolute(-1, 1, limit_lower=1.0, limit_upper=0.5)
    builder.joint_limit_lower[1], builder.joint_limit_upper[1] = 2.0, 1.0
    with pytest.raises(ValueError, match=r"joint_limit_lower\[1\]: expected at most"):
        builder.finalize()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("joint_q", NAN), ("joint_qd", INF), ("joint_limit_upper", NAN), ("joint_target_ke", -1.0),
        ("joint_target_kd", -1.0), ("joint_armature", -1.0), ("joint_friction", -1.0),
        ("joint_damping", NAN), ("joint_effort_limit", -1.0), ("joint_velocity_limit", -1.0),
    ],
)  # fmt: skip
def test_bad_edits_are_found_by_finalize(name, value):
    builder = chain()
    getattr(builder, name)[1] = value
    with pytest.raises(ValueError, match=rf"finalize: {name}\[1\]: expected"):
        builder.finalize()


@pytest.mark.parametrize(
    ("inertia", "expected"),
    [
        (np.zeros((3, 3)), "positive definite"),
        (np.diag([1.0, 1.0, -1.0]), "positive definite"),
        (np.diag([1.0, 1.0, 0.0]), "positive definite"),
        (np.diag([1.0, 1.0, 3.0]), "none of which exceeds the sum"),
        (np.diag([1.0, 1.0, NAN]), "finite numbers"),
        (np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), "a symmetric matrix"),
    ],
)
def test_an_inertia_that_no_body_has_is_refused(inertia, expected):
    builder = novaphy.ModelBuilder()
    builder.balance_inertia = False
    with pytest.raises(ValueError, match=f"add_link: inertia: expected .*{expected}"):
        builder.add_link(mass=1.0, inertia=inertia)
    assert builder.body_count == 0


def test_an_articulated_point_mass_is_refused():
    with pytest.raises(ValueError, match=r"body_inertia\[1\]: expected a positive definite"):
        chain(inertia=None).finalize()


def test_the_last_link_of_the_fr3_is_taken_in_any_orientation():
    draw = np.random.default_rng(0)
    for _ in range(200):
        q, _ = np.linalg.qr(draw.normal(size=(3, 3)))
        turned = q @ FR3_LINK_7 @ q.T
        model = chain(mass=0.6271432862, inertia=0.5 * (turned + turned.T)).finalize()
        moments = np.linalg.eigvalsh(model.body_inertia.numpy()[1].astype(float))
        np.testing.assert_allclose(moments[1:], [2.236e-4, 2.238e-4], rtol=2e-3)


def test_a_massless_last_link_without_armature_is_named_by_its_joint():
    model = chain(mass=0.0, inertia=None).finalize()
    solver = novaphy.solvers.SolverFeatherstone(model)
    state, after = model.state(), model.state()
    before = np.array(after.joint_qd.numpy())
    with pytest.raises(novaphy.Error, match=r"dof 1 \(joint 'joint_1'\): .*mass or armature"):
        solver.step(state, after, None, None, 1e-3)
    assert (after.joint_qd.numpy() == before).all()


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ([(0, 1), (1, 0)], "expected the root, with the parent -1"),  # a cycle
        ([(-1, 0), (0, 1), (-1, 1)], "expected one root"),  # two parents
        ([(-1, 0), (0, 1), (1, 0)], "expected a child that no other joint"),
        ([(0, 1), (-1, 0)], "expected the root"),  # the child first
    ],
)
def test_what_is_no_tree_is_no_articulation(joints, message):
    builder = two_links()
    added = [builder.add_joint_revolute(parent, child) for parent, child in joints]
    with pytest.raises(ValueError, match=message):
        builder.add_articulation(added)
    assert builder.articulation_count == 0


def test_a_joint_is_of_one_articulation():
    builder = chain()
    with pytest.raises(ValueError, match="expected one of no articulation, got one of 0"):
        builder.add_articulation([0, 1])
