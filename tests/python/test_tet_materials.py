"""Young's modulus and Poisson's ratio of tetrahedra, in both solvers of soft bodies."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], np.float32)
GRID = {"dim_x": 1, "dim_y": 1, "dim_z": 1, "cell_x": 0.1, "cell_y": 0.1, "cell_z": 0.1}
NAN = float("nan")


def lame(young, ratio):
    return young / (2 * (1 + ratio)), young * ratio / ((1 + ratio) * (1 - 2 * ratio))


def corners() -> novaphy.ModelBuilder:
    builder = novaphy.ModelBuilder(gravity=0.0)
    for x in CORNERS:
        builder.add_particle(tuple(x), (0, 0, 0), 1.0)
    return builder


def one(**material) -> novaphy.Model:
    builder = corners()
    builder.add_tetrahedron(0, 1, 2, 3, **material)
    builder.color()
    return builder.finalize()


def forces(model, q):
    """Those of SolverSemiImplicit on the corners (N)."""
    before, after = model.state(), model.state()
    before.particle_q.assign(q.astype(np.float32))
    novaphy.solvers.SolverSemiImplicit(model).step(before, after, None, None, 1e-3)
    return after.particle_qd.numpy().astype(float) / 1e-3


@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.45, -0.5])
def test_the_elasticity_is_hookes_law_in_both_solvers(ratio):
    vbd = pytest.importorskip("novaphy.solvers").SolverVBD
    young, strain = 1e4, 1e-3
    model = one(youngs_modulus=young, poisson_ratio=ratio)
    mu, lam = lame(young, ratio)
    assert model.particle_tet_material.numpy()[0] == pytest.approx([mu, lam, 0], rel=1e-6)
    # A strain along x in SolverSemiImplicit: stress (2 mu + lambda) e, and lambda e across.
    pull = np.array([1, 0, 0]) * strain * CORNERS
    slope = -3 * (forces(model, CORNERS + pull) - forces(model, CORNERS - pull))[1:]
    expected = np.diag([2 * mu + lam, lam, lam]) * strain
    assert np.abs(slope - expected).max() < 1e-3 * young * strain
    # SolverVBD stays at this strain under the forces of this stress.
    solver, found = vbd(model, iterations=400, initial_guess="previous"), []
    for sign in (1, -1):
        before, after = model.state(), model.state()
        before.particle_q.assign((CORNERS + sign * pull).astype(np.float32))
        f = np.concatenate([[-expected.sum(0)], expected]) * sign / 6
        before.particle_f.assign(f.astype(np.float32))
        solver.step(before, after, None, None, 0.1)
        found.append(after.particle_q.numpy().astype(float))
    assert np.abs((found[0] - found[1]) / 2 - pull).max() < 3e-3 * strain


def test_the_law_of_the_semi_implicit_solver_has_its_own_coefficients():
    mu, lam = lame(1e4, 0.3)
    physical = one(youngs_modulus=1e4, poisson_ratio=0.3, k_damp=2.0)
    same = one(k_mu=4 / 3 * mu, k_lambda=lam + 5 / 6 * mu, k_damp=2.0)
    raw = one(k_mu=mu, k_lambda=lam, k_damp=2.0)
    q = CORNERS + np.random.default_rng(1).normal(0, 0.1, (4, 3))
    expected = forces(same, q)
    scale = np.abs(expected).max()
    assert np.abs(forces(physical, q) - expected).max() < 1e-5 * scale
    assert np.abs(forces(raw, q) - expected).max() > 0.1 * scale
    assert physical.particle_tet_is_lame.numpy().tolist() == [1]
    assert same.particle_tet_is_lame.numpy().tolist() == [0]
    limits = [
        novaphy.solvers.SolverSemiImplicit(m).stable_dt(m.state()) for m in (physical, same, raw)
    ]
    assert limits[0] == pytest.approx(limits[1], rel=1e-5)
    assert limits[2] > 1.05 * limits[0]


def rolled(kind, model, values, wanted):
    """The loss of three steps with these materials, and its gradient if it is wanted."""
    from novaphy import diff, nova, solvers

    if kind == "vbd":
        solver = solvers.DiffSolverVBD(model, iterations=30)
    else:
        config = solvers.DiffSolverConfig(enable_tetrahedra=True)
        solver = solvers.DiffSemiImplicitSolver(model, config)
    model.particle_tet_material.requires_grad = wanted
    model.particle_tet_material.assign(values)
    trajectory = diff.Trajectory(model, 3)
    speed = np.array([(0.5, -0.2, 0.1), (-0.8, 0.3, 0.2), (0.1, -0.6, 0.4), (0.3, 0.2, -0.9)])
    trajectory[0].particle_qd.assign(speed.astype(np.float32))
    weights = nova.tensor(np.arange(12, dtype=np.float32).reshape(4, 3) ** 2 / 20)
    with nova.Tape() as tape:
        solver.rollout(trajectory, None, None, 0.02)
        loss = nova.dot(diff.state_particle_q_tensor(trajectory[3]), weights)
        if wanted:
            tape.backward(loss)
    gradient = model.particle_tet_material.grad.numpy()[0].astype(float) if wanted else None
    q = trajectory[3].particle_q.numpy().astype(float)
    return (q * weights.numpy()).sum(), gradient


@pytest.mark.parametrize("kind", ["vbd", "semi-implicit"])
@pytest.mark.parametrize("ratio", [0.3, -0.3])
def test_gradients_by_the_stored_numbers_are_those_of_differences(kind, ratio):
    pytest.importorskip("novaphy.diff")
    if kind == "vbd":
        pytest.importorskip("novaphy.solvers").DiffSolverVBD  # noqa: B018
    model = one(youngs_modulus=3e3, poisson_ratio=ratio, k_damp=1.0)
    start = model.particle_tet_material.numpy()
    _, gradient = rolled(kind, model, start, True)
    assert np.abs(gradient).min() > 0
    for column, step in enumerate((100.0, 100.0, 0.2)):
        change = np.zeros((1, 3), np.float32)
        change[0, column] = step
        up, down = (rolled(kind, model, start + s * change, False)[0] for s in (1, -1))
        assert gradient[column] == pytest.approx((up - down) / (2 * step), rel=1e-2), column


def test_all_ways_to_add_tetrahedra_take_physical_numbers():
    builder = corners()
    builder.add_tetrahedra(
        [0, 0], [1, 1], [2, 2], [3, 3], youngs_modulus=[100, 200], poisson_ratio=0.25
    )
    mesh = {"vertices": CORNERS, "indices": [(0, 1, 2, 3)]}
    builder.add_soft_mesh(**mesh, youngs_modulus=300, poisson_ratio=[0.25], k_damp=3.0)

    class WithNumbers:
        vertices, indices, density = CORNERS, [(0, 1, 2, 3)], 10.0
        k_mu, k_lambda, k_damp = 1.0, 2.0, 4.0

    builder.add_soft_mesh(mesh=WithNumbers, youngs_modulus=400, poisson_ratio=0.25)
    builder.add_soft_mesh(mesh=WithNumbers)
    builder.add_soft_grid(**GRID, density=1.0, youngs_modulus=500, poisson_ratio=0.25)
    worlds = novaphy.ModelBuilder()
    worlds.add_world(builder)
    worlds.add_world(builder)
    model = worlds.finalize()
    shear = [40.0, 80.0, 120.0, 160.0, 1.0] + 5 * [200.0]
    material = model.particle_tet_material.numpy()
    assert material[:, 0].tolist() == pytest.approx(2 * shear)
    assert material[:4, 1].tolist() == pytest.approx(shear[:4])  # nu = 1/4: lambda = mu
    assert material[:5, 2].tolist() == [0, 0, 3, 4, 4]
    assert model.particle_tet_is_lame.numpy().tolist() == 2 * (4 * [1] + [0] + 5 * [1])


WAYS = {
    "add_tetrahedron": lambda b, m: b.add_tetrahedron(0, 1, 2, 3, **m),
    "add_tetrahedra": lambda b, m: b.add_tetrahedra([0], [1], [2], [3], **m),
    "add_soft_grid": lambda b, m: b.add_soft_grid(**GRID, density=1.0, **m),
    "add_soft_mesh": lambda b, m: b.add_soft_mesh(vertices=CORNERS, indices=[0, 1, 2, 3], **m),
}
BOTH = "expected either k_mu and k_lambda, or youngs_modulus and poisson_ratio, got k_"


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("material", "message"),
    [
        ({"youngs_modulus": 1.0}, "together, got only youngs_modulus"),
        ({"poisson_ratio": 0.3}, "together, got only poisson_ratio"),
        ({"youngs_modulus": 1.0, "poisson_ratio": 0.3, "k_mu": 1.0}, BOTH + "mu"),
        ({"youngs_modulus": 1.0, "poisson_ratio": 0.3, "k_lambda": 1.0}, BOTH + "lambda"),
        ({"youngs_modulus": 0.0, "poisson_ratio": 0.3}, "youngs_modulus: .* > 0, got 0"),
        ({"youngs_modulus": NAN, "poisson_ratio": 0.3}, "youngs_modulus: .* > 0, got nan"),
        ({"youngs_modulus": 1e38, "poisson_ratio": 0.4999999}, "within float32, got 1e"),
        ({"youngs_modulus": 1.0, "poisson_ratio": 0.5}, "poisson_ratio: .* below 0.5, got 0.5"),
        ({"youngs_modulus": 1.0, "poisson_ratio": -1.0}, "poisson_ratio: .* above -1 .* got -1"),
        ({"youngs_modulus": 1.0, "poisson_ratio": NAN}, "poisson_ratio: .* got nan"),
    ],
)
def test_bad_numbers_raise_by_name_and_leave_the_builder(way, material, message):
    builder = corners()
    with pytest.raises(ValueError, match=way + ".*" + message):
        WAYS[way](builder, material)
    assert (builder.tet_count, builder.particle_count) == (0, 4)


def test_a_negative_lambda_needs_lame_parameters_and_a_bulk_modulus():
    raw, physical = one(k_mu=300.0, k_lambda=10.0), one(youngs_modulus=300.0, poisson_ratio=0.2)
    negative, worse = np.float32([[300, -150, 0]]), np.float32([[300, -250, 0]])
    physical.particle_tet_material.assign(negative)
    forces(physical, CORNERS)
    for model, values, message in (
        (raw, negative, r"\[0\]: expected finite numbers >= 0, got -150"),
        (physical, worse, r"\[0\]: expected finite numbers with k_lambda >= -2/3 k_mu, got -250"),
    ):
        model.particle_tet_material.assign(values)
        with pytest.raises(ValueError, match="particle_tet_material" + message):
            forces(model, CORNERS)
