"""Springs, triangles, bending edges and tetrahedra from Python."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import golden, soft_body_model

import novaphy
from novaphy import diff, nova, solvers
from novaphy.testing import assert_same_bits

DT = 1.0 / 60.0 / 16.0
CORNERS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
CUBE = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], np.float32)
CUBE_TETS = np.array([(0, 1, 2, 4), (3, 2, 1, 7), (5, 4, 7, 1), (6, 7, 4, 2), (1, 2, 4, 7)])


def with_corners() -> novaphy.ModelBuilder:
    """A builder with four particles."""
    builder = novaphy.ModelBuilder()
    for x in CORNERS:
        builder.add_particle(x, (0, 0, 0), 1.0)
    return builder


def test_the_model_has_newtons_arrays_under_both_names():
    newton, model = golden("newton_soft_body_strict"), soft_body_model()
    names = {
        "tri_indices": "particle_tri_indices",
        "tri_poses": "particle_tri_pose",
        "tri_materials": "particle_tri_material",
        "tri_activations": "particle_tri_activation",
        "tri_areas": "particle_tri_area",
        "tet_indices": "particle_tet_indices",
        "tet_poses": "particle_tet_pose",
        "tet_materials": "particle_tet_material",
        "tet_activations": "particle_tet_activation",
        "edge_indices": "particle_edge_indices",
        "edge_rest_angle": "particle_edge_rest_angle",
        "edge_bending_properties": "particle_edge_material",
    }
    for alias, name in names.items():
        assert_same_bits(getattr(model, alias).numpy(), newton[f"model_{alias}"], alias)
        assert getattr(model, alias).ptr == getattr(model, name).ptr
    model.tet_activations = np.full(40, 0.5, np.float32)
    assert model.control().tet_activations.numpy().tolist() == [0.5] * 40


def test_rollout_loss_and_gradient_are_newtons():
    newton, model = golden("newton_soft_body_strict"), soft_body_model()
    config = solvers.DiffSolverConfig(
        enable_tetrahedra=True,
        enable_triangles=True,
        enable_static_contacts=True,
        static_contact_margin=0.001,
    )
    solver = solvers.DiffSemiImplicitSolver(model, config)
    trajectory = diff.Trajectory(model, 960)
    materials = diff.model_tet_material_tensor(model)
    base = nova.tensor(materials.numpy())
    params = nova.tensor(newton["params0"], requires_grad=True)
    with nova.Tape() as tape:
        materials.copy_(diff.assign_tet_materials_generated(params, base, model.tet_count))
        solver.rollout(trajectory, None, None, DT)
        centroid = diff.particle_centroid_generated(diff.state_particle_q_tensor(trajectory[-1]))
        loss = diff.vec3_point_loss_generated(centroid, 0.0, -1.0, 1.5)
        tape.backward(loss)
    assert_same_bits(trajectory.particle_q.numpy()[::16], newton["particle_q_frames"])
    assert loss.item() == pytest.approx(float(newton["loss"][0]), rel=1e-6)
    error = np.linalg.norm(params.grad.numpy() - newton["grad_ad"])
    assert error < 1e-4 * np.linalg.norm(newton["grad_ad"])


def test_single_elements():
    builder = with_corners()
    assert builder.add_spring(0, 1, ke=10.0, kd=1.0) == 0
    assert builder.add_triangle(0, 1, 2, tri_ke=7.0) == 0.5
    assert builder.add_tetrahedron(0, 1, 2, 3, k_mu=5.0) == pytest.approx(1 / 6)
    assert builder.add_edge(1, 3, 0, 2, rest=0.5) == 0
    assert builder.add_triangles([0, 0], [2, 3], [3, 1], tri_drag=[1.0, 2.0], tri_ke=3) == [0.5] * 2
    assert builder.add_tetrahedra([0], [1], [2], [3], k_lambda=[4.0]) == [pytest.approx(1 / 6)]
    builder.add_edges([1], [3], [0], [2], edge_ke=2.0)
    counts = builder.spring_count, builder.tri_count, builder.edge_count, builder.tet_count
    assert counts == (1, 3, 2, 2)
    model = builder.finalize()
    assert model.tri_materials.shape == (3, 5) and model.tet_poses.shape == (2, 3, 3)
    assert model.tri_materials.numpy()[:, 0].tolist() == [7.0, 3.0, 3.0]
    assert model.tri_materials.numpy()[:, 3].tolist() == [0.0, 1.0, 2.0]
    assert model.tet_materials.numpy()[:, 1].tolist() == [1000.0, 4.0]
    assert model.edge_rest_angle.numpy()[0] == 0.5


@pytest.mark.parametrize(
    ("call", "error", "match"),
    [
        (lambda b: b.add_triangle(0, 1, 1), ValueError, r"triangle 0 \(particles 0, 1, 1\)"),
        (lambda b: b.add_triangle(0, 1, 9), IndexError, "got 9"),
        (lambda b: b.add_tetrahedron(0, 2, 1, 3), ValueError, "inverted"),
        (lambda b: b.add_tetrahedron(0, 1, 2, 3, k_mu=float("nan")), ValueError, "k_mu"),
        (lambda b: b.add_spring(1, 1, 1.0, 0.0), ValueError, "spring 0"),
        (lambda b: b.add_spring("a", 1, 1.0, 0.0), TypeError, "add_spring"),
        (lambda b: b.add_edge(1, 3, 0, -1), IndexError, "got -1"),
        (lambda b: b.add_triangles([0], [1, 2], [3]), ValueError, "j: expected 1"),
        (lambda b: b.add_triangles([0], [1], [2], tri_ke=[1, 2]), ValueError, "one value or 1"),
        (lambda b: b.add_soft_mesh(), ValueError, "`mesh`, or `vertices` and `indices`"),
        (lambda b: b.add_soft_mesh(vertices=[], indices=[]), ValueError, "empty mesh"),
        (
            lambda b: b.add_soft_mesh(vertices=CORNERS, indices=[(0, 1, 2)]),
            ValueError,
            r"\(n,\) or \(n, 4\)",
        ),
        (
            lambda b: b.add_soft_mesh(vertices=[*CORNERS, (3, 3, 3)], indices=[0, 1, 2, 3]),
            ValueError,
            r"vertices\[4\]",
        ),
        (
            lambda b: b.add_soft_mesh(vertices=CORNERS, indices=[0, 1, 2, 3.5]),
            TypeError,
            "indices",
        ),
        (
            lambda b: b.add_soft_mesh(vertices=CORNERS, indices=[0, 1, 2, 3] * 3),
            ValueError,
            "manifold",
        ),
        (
            lambda b: b.add_cloth_mesh(vertices=CORNERS, indices=[0, 1, 2], density=1.0),
            ValueError,
            r"vertices\[3\]",
        ),
        (
            lambda b: b.add_soft_grid(
                dim_x=0, dim_y=1, dim_z=1, cell_x=1, cell_y=1, cell_z=1, density=1
            ),
            ValueError,
            "dim_x",
        ),
    ],
)
def test_bad_elements_are_refused(call, error, match):
    builder = with_corners()
    with pytest.raises(error, match=match):
        call(builder)
    assert builder.particle_count == 4
    assert builder.tri_count == builder.tet_count == builder.spring_count == builder.edge_count == 0


def test_meshes_come_from_arrays_and_objects():
    class Mesh:
        vertices, indices = CUBE, CUBE_TETS
        density, k_mu, k_lambda, k_damp = 10.0, 50.0, np.arange(1.0, 6.0), None

    a, b = novaphy.ModelBuilder(), novaphy.ModelBuilder()
    a.add_soft_mesh(mesh=Mesh, k_mu=60.0)
    b.add_soft_mesh(
        vertices=CUBE, indices=CUBE_TETS.ravel(), density=10.0, k_mu=60.0, k_lambda=[1, 2, 3, 4, 5]
    )
    for left, right in zip((a.finalize(), a.finalize()), (b.finalize(), b.finalize())):
        assert_same_bits(left.tet_materials.numpy(), right.tet_materials.numpy())
        assert_same_bits(left.particle_mass.numpy(), right.particle_mass.numpy())
        assert left.tri_count == 12
        assert left.particle_mass.numpy().sum() == pytest.approx(10.0, rel=1e-6)


def test_a_grid_has_the_mass_of_its_volume():
    builder = novaphy.ModelBuilder()
    builder.add_soft_grid(
        dim_x=4, dim_y=2, dim_z=1, cell_x=0.5, cell_y=0.25, cell_z=2.0, density=3.0
    )
    mass, q = np.array(builder.particle_mass), np.array(builder.particle_q)
    assert mass.sum() == pytest.approx(3.0 * 2.0 * 0.5 * 2.0, rel=1e-6)
    assert mass @ q == pytest.approx(mass.sum() * np.array([1.0, 0.25, 1.0]), rel=1e-6)
    # Each axis of n cells of the size c: the trapezoidal sum of x^2 is L^2/3 + c^2/6.
    expected = [4.0 / 3 + 0.25 / 6, 0.25 / 3 + 0.0625 / 6, 4.0 / 3 + 4.0 / 6]
    assert mass @ q**2 == pytest.approx(mass.sum() * np.array(expected), rel=1e-6)


def test_operators_and_views_share_the_models_memory():
    model = soft_body_model()
    view = diff.model_tet_material_tensor(model)
    assert view is diff.model_tet_material_tensor(model)
    assert view.shape == (40, 3) and view.data_ptr == model.tet_materials.ptr
    assert diff.model_tri_material_tensor(model).shape == (48, 5)
    assert diff.model_tet_activation_tensor(model).shape == (40,)
    assert diff.model_tri_activation_tensor(model).shape == (48,)
    assert diff.model_edge_material_tensor(model).shape == (72, 2)
    assert diff.model_edge_rest_angle_tensor(model).shape == (72,)
    assert diff.model_spring_stiffness_tensor(model).shape == (0,)
    control = model.control()
    assert diff.control_tet_activation_tensor(control).data_ptr == control.tet_activations.ptr
    q, qd = diff.model_gravity_tensor(model), nova.zeros((27, 3))
    with pytest.raises(ValueError, match="particle_q"):
        diff.eval_tetrahedra_forces_generated(
            model, q, qd, qd, diff.model_tet_activation_tensor(model), view
        )
    with pytest.raises(ValueError, match="tri_materials"):
        diff.eval_triangle_forces_generated(
            model, qd, qd, qd, diff.model_tri_activation_tensor(model), view
        )


def test_springs_and_bending_have_gradients():
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.add_cloth_grid(
        dim_x=2, dim_y=2, cell_x=0.5, cell_y=0.5, mass=1.0, add_springs=True, edge_ke=1.0
    )
    model = builder.finalize()
    rng = np.random.default_rng(1)
    q = nova.tensor(model.particle_q.numpy() + 0.05 * rng.standard_normal((9, 3)).astype("f4"))
    zero = nova.zeros((9, 3))
    weights = nova.tensor(rng.standard_normal((9, 3)).astype("f4"))

    def springs(x, rest):
        stiffness = diff.model_spring_stiffness_tensor(model)
        damping = diff.model_spring_damping_tensor(model)
        f = diff.eval_spring_forces_generated(model, x, zero, zero, stiffness, damping, rest)
        return nova.dot(f, weights)

    def bending(x, rest):
        material = diff.model_edge_material_tensor(model)
        f = diff.eval_bending_forces_generated(model, x, zero, zero, material, rest)
        return nova.dot(f, weights)

    rest = nova.tensor(model.spring_rest_length.numpy())
    assert nova.gradcheck(springs, [q, rest], rtol=1e-2).ok
    rest = nova.tensor(model.edge_rest_angle.numpy())
    assert nova.gradcheck(bending, [q, rest], rtol=1e-2).ok


def test_elements_that_would_be_left_out_are_refused():
    model = soft_body_model()
    with pytest.raises(NotImplementedError, match="enable_triangles"):
        solvers.DiffSemiImplicitSolver(model)
    with pytest.raises(NotImplementedError, match="enable_tetrahedra"):
        solvers.DiffSemiImplicitSolver(model, solvers.DiffSolverConfig(enable_triangles=True))
    solvers.DiffSemiImplicitSolver(model, solvers.DiffSolverConfig(strict=False))
