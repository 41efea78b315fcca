"""What SolverVBD does with every array, number and option: it acts, raises by name, or has no part.

The names are those of the model and of the solver themselves, so one that is new fails until it is
in a table here.
"""

from __future__ import annotations

import hashlib
import re

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_vbd(), reason="built with NOVAPHY_BUILD_VBD=OFF")
DT = 1 / 60


def scene() -> novaphy.Model:
    """Two worlds: a cloth on a box and a mesh, a soft block and a spring that all move."""
    one = novaphy.ModelBuilder()
    one.add_cloth_grid(
        pos=(0, 0, 0.1), dim_x=4, dim_y=3, cell_x=0.1, cell_y=0.1, mass=0.01, fix_left=True,
        tri_ke=50.0, tri_ka=50.0, tri_kd=0.01, edge_ke=0.05, edge_kd=1e-4,
    )  # fmt: skip
    one.add_soft_grid(
        pos=(0, 0, 0.5), dim_x=1, dim_y=1, dim_z=1, cell_x=0.1, cell_y=0.1, cell_z=0.1,
        density=100, k_mu=100, k_lambda=100, k_damp=0.1,
    )  # fmt: skip
    one.add_spring(10, 24, 10.0, 0.1)
    config = novaphy.ShapeConfig(ke=10.0, kd=1.0, mu=0.5)
    turned = (0.0, 0.0, 0.0, 1.0)
    one.add_shape_box(-1, xform=((0.2, 0.15, 0.0), turned), hx=0.3, hy=0.3, hz=0.09, cfg=config)
    corners = np.array([(-0.2, -0.2, 0), (0.2, -0.2, 0), (0, 0.2, 0), (0, 0, 0.1)], np.float32)
    faces = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)], np.int32)
    one.add_shape_mesh(
        -1, xform=((0.3, 0.15, 0.0), turned), vertices=corners, indices=faces, cfg=config
    )
    both = novaphy.ModelBuilder()
    both.replicate(one, 2)
    both.color()
    model = both.finalize()
    model.soft_contact_ke, model.soft_contact_kd = 10.0, 1.0
    rng = np.random.default_rng(1)
    for array, mean, spread in ((model.particle_q, 0.0, 5e-3), (model.particle_qd, -0.2, 0.3)):
        array.assign(array.numpy() + rng.normal(mean, spread, array.shape).astype(np.float32))
    # The worlds are not alike.
    model.gravity.assign(model.gravity.numpy() * np.array([[1.0], [0.5]], np.float32))
    poses = model.shape_transform.numpy()
    poses[2:, :3] += (0.02, 0.0, 0.01)
    model.shape_transform.assign(poses)
    return model


def nearly_singular() -> novaphy.Model:
    """A light particle on a stiff spring, whose block is singular in float32."""
    builder = novaphy.ModelBuilder()
    builder.add_particle((0, 0, 0), (0, 0, 0), 0.0)
    builder.add_particle((1, 1, 1), (0, 0, 0), 1e-4)
    builder.add_spring(0, 1, 1e8, 0.0)
    builder.color()
    return builder.finalize()


def result(model: novaphy.Model, **options) -> str:
    """A hash of the state after two steps with contacts that are found anew."""
    solver = novaphy.solvers.SolverVBD(model, **{"iterations": 3} | options)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    states = [model.state(), model.state()]
    for _ in range(2):
        pipeline.collide(states[0], contacts)
        solver.step(*states, None, contacts, DT)
        states.reverse()
    found = states[0].particle_q.numpy().tobytes() + states[0].particle_qd.numpy().tobytes()
    return hashlib.sha256(found).hexdigest()


def scaled(values: np.ndarray) -> np.ndarray:
    if values.dtype.kind != "f":
        return np.where(values > 0, values - 1, values + 1).astype(values.dtype)
    return (values * np.float32(1.1) + np.float32(0.01)).astype(values.dtype)


def columns(first: int, end: int):
    def change(values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[:, first:end] = scaled(values[:, first:end])
        return values

    return change


def rows(row: int, value):
    def change(values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[row] = value
        return values

    return change


def swapped(values: np.ndarray) -> np.ndarray:
    """Two rows of indices in each other's place."""
    values = values.copy()
    values[[0, 4]] = values[[4, 0]]
    return values


def other_colors(values: np.ndarray) -> np.ndarray:
    return np.where(values < 2, 1 - values, values).astype(values.dtype)


# name: a change of the array, which changes the step.
ACTS = {
    "particle_q": scaled,
    "particle_qd": scaled,
    "particle_mass": scaled,
    "particle_inv_mass": rows(12, 0),
    "particle_radius": scaled,
    "particle_flags": rows(12, 0),
    "particle_world": lambda values: 1 - values,
    "particle_colors": other_colors,
    "particle_spring_indices": rows(0, (11, 25)),
    "particle_spring_rest_length": scaled,
    "particle_spring_stiffness": scaled,
    "particle_spring_damping": scaled,
    "particle_spring_tension_only": lambda values: 1 - values,
    "particle_tri_indices": swapped,
    "particle_tri_pose": scaled,
    "particle_tri_area": scaled,
    "particle_tri_activation": scaled,
    "particle_tri_material": columns(0, 3),
    "particle_edge_indices": lambda values: values[::-1].copy(),
    "particle_edge_rest_angle": scaled,
    "particle_edge_rest_length": scaled,
    "particle_edge_material": scaled,
    "particle_tet_indices": swapped,
    "particle_tet_pose": lambda values: values * np.float32(1.1),
    "particle_tet_activation": scaled,
    "particle_tet_material": scaled,
    "shape_transform": columns(0, 3),
    "shape_type": rows(0, int(novaphy.GeoType.SPHERE)),
    "shape_scale": scaled,
    "shape_flags": lambda values: 0 * values,
    "shape_world": lambda values: 1 - values,
    "shape_margin": scaled,
    "shape_material_ke": scaled,
    "shape_material_kd": scaled,
    "shape_material_mu": scaled,
    "mesh_vertices": scaled,
    "mesh_indices": lambda values: values[:, [0, 2, 1]].copy(),
    "gravity": scaled,
}
# name: a change of the array, and a part of the error message.
RAISES = {
    "particle_spring_control": (scaled, "particle_spring_control"),
    "shape_material_kf": (scaled, "shape_material_kf"),
    "shape_material_ka": (scaled, "shape_material_ka"),
    "shape_material_restitution": (scaled, "shape_material_restitution"),
    "shape_material_mu_torsional": (scaled, "shape_material_mu_torsional"),
    "shape_material_mu_rolling": (scaled, "shape_material_mu_rolling"),
    "shape_mesh_range": (rows(1, 0), "shape_mesh_range"),
    "shape_body": (rows(0, 0), "shape_body|body 0"),
    "fluid_density": (scaled, "fluid_density"),
    "fluid_viscosity": (scaled, "fluid_viscosity"),
}
# Arrays that do not act on particles, with the reason.
NO_PART = {
    "particle_tet_volume": "that of particle_tet_pose counts",
    "particle_tet_is_lame": "both kinds of numbers are Lame parameters in VBD",
    "shape_color": "looks",
    "shape_is_solid": "of the mass of bodies",
    "shape_gap": "of contacts of shapes with each other",
    "shape_mixing": "of contacts of shapes with each other",
    "shape_collision_group": "of contacts of shapes with each other",
    "shape_contact_pairs": "of contacts of shapes with each other",
    "shape_collision_radius": "found of the shapes when the model is made",
    "shape_aabb_lower": "found of the shapes when the model is made",
    "shape_aabb_upper": "found of the shapes when the model is made",
    "fluid_wind": "moves a fluid, and a model with one is refused",
}
# Without rows, because the scene has no bodies. test_avbd.py is about bodies.
OF_BODIES = ("body_", "joint_", "articulation_", "actuator_", "act", "ctrl")
NUMBERS_THAT_ACT = {"soft_contact_ke", "soft_contact_kd", "soft_contact_mu"}
NUMBERS_THAT_RAISE = {
    "soft_contact_kf": 10.0,
    "soft_contact_restitution": 0.5,
    "particle_adhesion": 0.01,
    "particle_max_velocity": 1.0,
}
NUMBERS_WITHOUT_A_PART = {"particle_max_radius"}  # told of particle_radius
OPTIONS = {
    "iterations": 4,
    "friction_epsilon": 0.5,
    "initial_guess": "previous",
    "acceleration": 0.5,
    "tolerance": 0.5,
    "safeguard": True,
    "coarse": "auto",
    "solve": "converged",
    "lhs_regularization": 0.1,
}
# Tested in test_self_contact.py.
SELF_CONTACT = {
    "particle_enable_self_contact",
    "particle_self_contact_radius",
    "particle_self_contact_margin",
    "particle_self_contact_gap",
}


def arrays(model: novaphy.Model) -> dict[str, novaphy.DeviceArray]:
    """Those of the model; of names of one array the one that is in a table."""
    found = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    found = {name: a for name, a in found.items() if isinstance(a, novaphy.DeviceArray)}
    known = [name for name in found if name in ACTS or name in RAISES or name in NO_PART]
    theirs = {found[name].ptr for name in known if found[name].size > 0}
    return {
        name: a for name, a in found.items() if name in known or a.ptr not in theirs or a.size == 0
    }


def test_every_array_is_in_one_table():
    model = scene()
    tables = [set(ACTS), set(RAISES), set(NO_PART)]
    assert sum(map(len, tables)) == len(set.union(*tables))
    names = arrays(model)
    assert set.union(*tables) <= set(names)
    for name, array in names.items():
        if name.startswith(OF_BODIES):
            assert array.size == 0 or name.endswith("_start"), name  # behind the last: 0
        elif name not in set.union(*tables):
            # A second name of an array without rows has no address to be known by.
            assert array.size == 0 and name in ("shape_contact_pairs",), name


@pytest.mark.parametrize("name", ACTS)
def test_an_array_acts(name):
    model = scene()
    before = result(model)
    array = getattr(model, name)
    assert array.size > 0
    array.assign(ACTS[name](array.numpy()))
    assert result(model) != before


@pytest.mark.parametrize("name", RAISES)
def test_an_array_that_has_no_rule_raises_by_name(name):
    model = scene()
    change, words = RAISES[name]
    array = getattr(model, name)
    assert array.size > 0
    array.assign(change(array.numpy()))
    with pytest.raises((NotImplementedError, ValueError, IndexError, novaphy.Error), match=words):
        result(model)


@pytest.mark.parametrize("name", NO_PART)
def test_an_array_without_a_part_changes_no_bit(name):
    model = scene()
    before = result(model)
    array = getattr(model, name)
    array.assign(scaled(array.numpy()))
    assert result(model) == before


def test_every_number_acts_or_raises_by_name():
    numbers = {n for n in dir(scene()) if isinstance(getattr(scene(), n), float)}
    assert numbers == NUMBERS_THAT_ACT | set(NUMBERS_THAT_RAISE) | NUMBERS_WITHOUT_A_PART
    model = scene()
    before = result(model)
    for name in NUMBERS_THAT_ACT:
        value = getattr(model, name)
        setattr(model, name, 1.5 * value)
        assert result(model) != before, name
        setattr(model, name, value)
    for name, value in NUMBERS_THAT_RAISE.items():
        default = getattr(model, name)
        setattr(model, name, value)
        with pytest.raises(NotImplementedError, match=name):
            result(model)
        setattr(model, name, default)
    assert result(model) == before


def test_every_option_acts():
    names = re.findall(r"(\w+): [^,]* = ", novaphy.solvers.SolverVBD.__init__.__doc__)
    assert set(names) == set(OPTIONS) | SELF_CONTACT
    for name, value in OPTIONS.items():
        model = nearly_singular() if name == "lhs_regularization" else scene()
        assert result(model, **{name: value}) != result(model), name
