"""Up to which dt elements and contacts of particles are stable, and the bound of their friction."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import novaphy
from novaphy import solvers

diff = pytest.importorskip("novaphy.diff")
nova = pytest.importorskip("novaphy.nova")
SolverSemiImplicit = solvers.SolverSemiImplicit


def said_of(run, *arguments):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        run(*arguments)
    return [str(w.message) for w in said if w.category is RuntimeWarning]


def chain(count, ke=1e3, kd=0.0, mass=0.1):
    """Particles in a row, a spring between neighbors, at rest."""
    builder = novaphy.ModelBuilder(gravity=0.0)
    for k in range(count):
        builder.add_particle((k, 0, 0), (0, 0, 0), mass)
    for k in range(count - 1):
        builder.add_spring(k, k + 1, ke=ke, kd=kd)
    return builder.finalize()


def longest(springs, dampers):
    """The dt with springs dt^2 + 2 dampers dt = 4."""
    return 4.0 / (dampers + np.sqrt(dampers**2 + 4.0 * springs))


def energy_grows(model, dt, steps=400, seed=0):
    """Whether a small push grows without end."""
    solver = SolverSemiImplicit(model)
    a, b = model.state(), model.state()
    rng = np.random.default_rng(seed)
    a.particle_qd.assign(rng.normal(0, 1e-3, (model.particle_count, 3)).astype(np.float32))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(steps):
            a.clear_forces()
            solver.step(a, b, None, None, dt)
            a, b = b, a
    qd = a.particle_qd.numpy()
    return not (np.isfinite(qd).all() and np.abs(qd).max() < 0.1)


@pytest.mark.parametrize(
    ("count", "ke", "kd"), [(2, 1e3, 0.0), (2, 0.0, 5.0), (2, 1e3, 5.0), (30, 1e3, 2.0)]
)
def test_of_springs_the_limit_is_that_of_two_and_of_a_long_chain(count, ke, kd):
    # The largest eigenvalue of two is 2 ke/m, of a long chain 4 ke/m.
    most = (2.0 if count == 2 else 4.0) / 0.1
    model = chain(count, ke, kd)
    solver = SolverSemiImplicit(model)
    limit = solver.stable_dt(model.state())
    assert limit == pytest.approx(longest(most * ke, most * kd), rel=1e-3)
    assert not energy_grows(model, 0.99 * limit) and energy_grows(model, 1.05 * limit)


def soft_block(**material):
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.add_soft_grid(
        dim_x=3, dim_y=2, dim_z=2, cell_x=0.1, cell_y=0.1, cell_z=0.1, density=1e3, **material
    )
    builder.particle_mass = [1.0] * builder.particle_count
    return builder.finalize()


def sheet(**material):
    builder = novaphy.ModelBuilder(gravity=0.0)
    builder.add_cloth_grid(dim_x=5, dim_y=4, cell_x=0.1, cell_y=0.1, mass=0.01, **material)
    return builder.finalize()


SCENES = {
    "soft": lambda: soft_block(
        k_mu=1e5, k_lambda=2e5, k_damp=0.0, tri_ke=0.0, tri_ka=0.0, tri_kd=0.0
    ),
    "damped soft": lambda: soft_block(k_mu=1e4, k_lambda=1e4, k_damp=200.0),
    "sheet": lambda: sheet(tri_ke=1e3, tri_ka=2e3, tri_kd=0.0, edge_ke=0.0, edge_kd=0.0),
    "damped sheet": lambda: sheet(tri_ke=1e2, tri_ka=1e2, tri_kd=5.0, edge_ke=0.0, edge_kd=0.0),
    "bending": lambda: sheet(tri_ke=1.0, tri_ka=1.0, tri_kd=0.0, edge_ke=5e3, edge_kd=0.0),
    "damped bending": lambda: sheet(tri_ke=1.0, tri_ka=1.0, tri_kd=0.0, edge_ke=1.0, edge_kd=50.0),
}


@pytest.mark.parametrize("name", SCENES)
def test_of_elements_the_limit_is_safe_and_a_warned_dt_diverges(name):
    model = SCENES[name]()
    limit = SolverSemiImplicit(model).stable_dt(model.state())
    assert np.isfinite(limit) and not energy_grows(model, limit)
    a, b = model.state(), model.state()
    for dt in limit * 1.2 ** np.arange(20):
        said = said_of(SolverSemiImplicit(model).step, a, b, None, None, float(dt))
        if said:
            break
    assert len(said) == 1 and "is stable with its mass and its elements" in said[0]
    assert "stable_dt" in said[0] and dt < 8.0 * limit
    assert energy_grows(model, float(dt))


def on_plane(mass=0.01, solver=SolverSemiImplicit, ke=1e3, kd=0.0, kf=0.0, **options):
    builder = novaphy.ModelBuilder()
    builder.add_particle((0, 0, 0.009), (0.5, 0, 0), mass, radius=0.01)
    builder.add_ground_plane(cfg=novaphy.ShapeConfig(ke=ke, kd=kd, kf=kf, mu=0.5))
    model = builder.finalize(requires_grad=True)
    model.soft_contact_ke, model.soft_contact_kd = ke, kd
    model.soft_contact_kf, model.soft_contact_mu = kf, 0.5
    if solver is not SolverSemiImplicit:
        options = {"config": solvers.DiffSolverConfig(enable_static_contacts=True, **options)}
    return model, solver(model, **options)


@pytest.mark.parametrize(("ke", "kd"), [(1e3, 0.0), (1e3, 3.0)])
def test_of_contacts_the_limit_is_the_closed_form_and_a_step_warns(ke, kd):
    for bound in (0.0, np.inf):
        model, solver = on_plane(ke=ke, kd=kd, particle_kf_bound=bound)
        pipeline = novaphy.CollisionPipeline(model)
        contacts = pipeline.contacts()
        pipeline.collide(model.state(), contacts)
        limit = solver.stable_dt(model.state(), contacts)
        assert limit == pytest.approx(longest(ke / 0.01, kd / 0.01), rel=1e-3)
        assert solver.stable_dt(model.state()) == np.inf
    # A damper of one side counts half where all is certain to diverge.
    certain = longest(ke / 0.01, 0.5 * kd / 0.01)
    for make in (SolverSemiImplicit, solvers.DiffSemiImplicitSolver):
        for factor, count in ((0.98, 0), (1.02, 1)):
            model, solver = on_plane(solver=make, ke=ke, kd=kd)
            given = contacts_of(model) if make is SolverSemiImplicit else None
            a, b = model.state(), model.state()
            said = said_of(solver.step, a, b, None, given, factor * certain)
            assert len(said) == count
            if said:
                assert "particle 0 is stable with its mass and ke and kd of its contacts" in said[0]


def contacts_of(model):
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(model.state(), contacts)
    return contacts


def test_kf_without_a_bound_warns():
    for bound, count in ((1.0, 0), (np.inf, 1)):
        model, solver = on_plane(kf=1e3, particle_kf_bound=bound)
        a, b = model.state(), model.state()
        said = said_of(solver.step, a, b, None, contacts_of(model), 1e-3)
        assert len(said) == count and all("kf of its contacts" in text for text in said)


@pytest.mark.parametrize("solver", [SolverSemiImplicit, solvers.DiffSemiImplicitSolver])
def test_friction_takes_at_most_the_bound_of_a_slip(solver):
    dt, mass = 1e-3, 0.01
    for bound in (0.25, 1.0, np.inf):
        for kf in (1.0, 5.0, 1e3):
            model, made = on_plane(mass, solver, kf=kf, particle_kf_bound=bound)
            model.shape_material_mu.assign(np.full(model.shape_count, 1e4, np.float32))
            a, b = model.state(), model.state()
            given = contacts_of(model) if solver is SolverSemiImplicit else None
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                made.step(a, b, None, given, dt)
            acting = min(kf, bound * mass / dt)
            assert b.particle_qd.numpy()[0, 0] == pytest.approx(
                0.5 * (1 - acting * dt / mass), rel=1e-4, abs=1e-6
            )


@pytest.mark.parametrize("kf", [2.0, 1e3])
def test_the_gradient_by_mass_goes_through_the_bound(kf):
    def speed(mass):
        model, solver = on_plane(mass, solvers.DiffSemiImplicitSolver, kf=kf, particle_kf_bound=0.5)
        model.shape_material_mu.assign(np.full(model.shape_count, 1e4, np.float32))
        trajectory = diff.Trajectory(model, 5)
        by_mass = diff.model_particle_mass_tensor(model, requires_grad=True)
        with nova.Tape() as tape:
            solver.rollout(trajectory, None, None, 1e-3)
            last = diff.state_particle_qd_tensor(trajectory[5])
            tape.backward(last[0, 0])
        return last.numpy()[0, 0], by_mass.grad.item()

    epsilon = 1e-4
    difference = (speed(0.01 + epsilon)[0] - speed(0.01 - epsilon)[0]) / (2 * epsilon)
    assert speed(0.01)[1] == pytest.approx(float(difference), rel=1e-2, abs=1e-3)


def test_a_soft_block_that_slides_with_default_materials_has_the_gradient_of_differences():
    def slide(velocity, with_gradient):
        builder = novaphy.ModelBuilder()
        builder.default_particle_radius = 0.01
        builder.add_soft_grid(
            pos=(0, 0, 0.011),
            vel=(velocity, 0, 0),
            dim_x=2,
            dim_y=2,
            dim_z=1,
            cell_x=0.05,
            cell_y=0.05,
            cell_z=0.05,
            density=300.0,
            k_mu=1e4,
            k_lambda=1e4,
            k_damp=5.0,
        )
        builder.particle_mass = [300.0 * 0.05**3] * builder.particle_count
        builder.add_ground_plane()
        model = builder.finalize(requires_grad=True)
        solver = solvers.DiffSemiImplicitSolver(
            model,
            solvers.DiffSolverConfig(enable_tetrahedra=True, enable_static_contacts=True),
        )
        steps = 600
        trajectory = diff.Trajectory(model, steps)
        if not with_gradient:
            solver.rollout(trajectory, None, None, 1 / 2400)
            return trajectory[steps].particle_q.numpy()[:, 0].mean(dtype=np.float64)
        with nova.Tape() as tape:
            solver.rollout(trajectory, None, None, 1 / 2400)
            last = diff.state_particle_q_tensor(trajectory[steps])
            tape.backward(nova.mean(last[:, 0]))
        return trajectory[0].particle_qd.grad.numpy()[:, 0].sum(dtype=np.float64)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gradient = slide(2.0, True)
        difference = (slide(2.4, False) - slide(1.6, False)) / 0.8
    # Corners bounce, so differences over short distances are noise.
    assert gradient == pytest.approx(difference, rel=5e-2)
