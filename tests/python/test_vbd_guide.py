"""The table of the guide to VBD, row by row: what it says is there works, what raises raises."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_vbd(), reason="built with NOVAPHY_BUILD_VBD=OFF")
GUIDE = Path(__file__).parents[2] / "docs" / "guide" / "vbd.md"
DT = 1 / 60
HAS_CUDA = novaphy.is_device_available("cuda")


def builder(**options) -> novaphy.ModelBuilder:
    """A cloth that is held at one side, a block on the ground, and a spring between them."""
    b = novaphy.ModelBuilder()
    elastic = {"tri_ke": 50.0, "tri_ka": 50.0, "tri_kd": 0.01, "edge_ke": 0.05, "edge_kd": 1e-4}
    b.add_cloth_grid(
        pos=(0, 0, 1), dim_x=3, dim_y=3, cell_x=0.1, cell_y=0.1, mass=0.01, fix_left=True,
        **(elastic | options),
    )  # fmt: skip
    b.add_soft_grid(
        pos=(0, 0, 0.02), dim_x=1, dim_y=1, dim_z=1, cell_x=0.1, cell_y=0.1, cell_z=0.1,
        density=100, k_mu=100, k_lambda=100, k_damp=0.1, particle_radius=0.03,
    )  # fmt: skip
    b.add_spring(5, 20, 10.0, 0.1)
    b.add_ground_plane(cfg=novaphy.ShapeConfig(ke=10.0, kd=1.0, mu=0.5))
    return b


def finalized(b: novaphy.ModelBuilder) -> novaphy.Model:
    b.color()
    model = b.finalize()
    model.soft_contact_ke, model.soft_contact_kd = 10.0, 1.0
    return model


def step(solver, model, captured=False, **options):
    """One step with contacts, or the replay of one; the state after it."""
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    before, after = model.state(), model.state()
    before.particle_qd.assign(np.full((model.particle_count, 3), (0.3, 0.1, -0.5), np.float32))
    pipeline.collide(before, contacts)
    assert contacts.active_soft_contact_count > 0
    if captured:
        nova = pytest.importorskip("novaphy.nova")
        with nova.ScopedCapture() as capture:
            solver.step(before, after, None, contacts, DT, **options)
        assert (after.particle_q.numpy() == model.particle_q.numpy()).all()
        capture.graph.launch()
    else:
        solver.step(before, after, None, contacts, DT, **options)
    return after


def gradients(arrays: tuple[str, ...], **options) -> Callable[[str], None]:
    """Whether every array has a gradient that is not 0."""

    def check(kind: str) -> None:
        nova, diff = pytest.importorskip("novaphy.nova"), pytest.importorskip("novaphy.diff")
        model = finalized(builder())
        solver = novaphy.solvers.DiffSolverVBD(model, iterations=20, gradient=kind, **options)
        for name in arrays:
            getattr(model, name).requires_grad = True
        with nova.Tape() as tape:
            after = step(solver, model)
            weights = np.random.default_rng(1).normal(size=(model.particle_count, 3))
            weights = nova.tensor(weights.astype(np.float32))
            loss = nova.sum(diff.state_particle_q_tensor(after) * weights)
        tape.backward(loss)
        for name in arrays:
            assert np.abs(getattr(model, name).grad.numpy()).max() > 0, name
        assert (
            solver.gradient_info().label
            == {
                "unrolled": "exact of the code",
                "implicit": "implicit",
            }[kind]
        )

    return check


def target_gradient(kind: str) -> None:
    nova, diff = pytest.importorskip("novaphy.nova"), pytest.importorskip("novaphy.diff")
    model = finalized(builder())
    solver = novaphy.solvers.DiffSolverVBD(model, iterations=20, gradient=kind)
    held = model.particle_q.numpy()[model.particle_mass.numpy() == 0]
    targets = nova.tensor(held + np.float32(0.01), requires_grad=True)
    with nova.Tape() as tape:
        loss = nova.sum(diff.state_particle_q_tensor(step(solver, model, targets=targets)))
    tape.backward(loss)
    assert np.abs(targets.grad.numpy()).max() > 0.5


def forward(**options) -> Callable[[], None]:
    """Whether SolverVBD steps with the options."""

    def check() -> None:
        model = finalized(builder())
        solver = novaphy.solvers.SolverVBD(model, **options)
        assert np.isfinite(step(solver, model).particle_q.numpy()).all()

    return check


def both_ways(device: str, captured: bool, **options) -> None:
    """A step with contacts on a device, or the replay of one, has the bits of one on the cpu."""
    b = builder()
    model = finalized(b)
    expected = step(novaphy.solvers.SolverVBD(model, **options), model).particle_q.numpy()
    there = b.finalize(device)
    there.soft_contact_ke, there.soft_contact_kd = model.soft_contact_ke, model.soft_contact_kd
    solver = novaphy.solvers.SolverVBD(there, **options)
    found = step(solver, there, captured=captured)
    assert (found.particle_q.numpy() == expected).all()


def with_targets() -> None:
    model = finalized(builder())
    held = model.particle_q.numpy()[model.particle_mass.numpy() == 0] + np.float32(0.01)
    after = step(novaphy.solvers.SolverVBD(model), model, targets=held)
    assert (after.particle_q.numpy()[model.particle_mass.numpy() == 0] == held).all()


def each_number(solver: Callable) -> Callable[[], None]:
    """Steps with drag, adhesion and a lowered largest velocity, each of which is refused."""

    def check() -> None:
        with pytest.raises(NotImplementedError, match="drag"):
            solver(finalized(builder(tri_drag=1.0)))
        for name, value in (
            ("particle_adhesion", 0.1),
            ("particle_max_velocity", 1.0),
            ("soft_contact_kf", 10.0),
        ):
            model = finalized(builder())
            setattr(model, name, value)
            with pytest.raises(NotImplementedError, match=name):
                step(solver(model), model)
        raise NotImplementedError

    return check


def with_body() -> novaphy.Model:
    b = builder()
    body = b.add_body(xform=((9, 0, 0), (0, 0, 0, 1)))
    b.add_shape_sphere(body, radius=0.1)
    return finalized(b)


def bodies() -> None:
    model = with_body()
    step(plain(model), model)


def body_gradient(kind: str) -> None:
    differentiable(with_body(), gradient=kind)


def body_captured() -> None:
    model = with_body()
    step(plain(model), model, captured=True)


def pendulum() -> novaphy.Model:
    b = novaphy.ModelBuilder()
    link = b.add_link(mass=1.0, inertia=np.diag([0.1, 0.1, 0.1]))
    b.add_joint_revolute(-1, link, axis=(0, 1, 0), child_xform=((-0.5, 0, 0), (0, 0, 0, 1)))
    return b.finalize()


def swing(solver, model, captured=False):
    nova = pytest.importorskip("novaphy.nova")
    before, after = model.state(), model.state()
    if captured:
        with nova.ScopedCapture():
            solver.step(before, after, None, None, DT)
    solver.step(before, after, None, None, DT)
    assert after.body_qd.numpy()[0, 4] > 0
    return after


def swing_gradient(kind: str) -> None:
    nova, diff = pytest.importorskip("novaphy.nova"), pytest.importorskip("novaphy.diff")
    model = pendulum()
    solver = differentiable(model, gradient=kind)
    model.body_mass.requires_grad = True
    with nova.Tape() as tape:
        loss = nova.sum(diff.state_body_qd_tensor(swing(solver, model)))
    tape.backward(loss)
    assert np.abs(model.body_mass.grad.numpy()).max() > 0
    assert solver.gradient_info().label == "implicit"


def plain(model, **options):
    return novaphy.solvers.SolverVBD(model, **options)


def differentiable(model, **options):
    pytest.importorskip("novaphy.diff")
    return novaphy.solvers.DiffSolverVBD(model, **options)


def option_gradient(**option) -> Callable[[str], None]:
    """An option that has no gradient: refused by name, or no argument at all."""

    def check(kind: str) -> None:
        try:
            differentiable(finalized(builder()), gradient=kind, **option)
        except (NotImplementedError, TypeError) as error:
            assert next(iter(option)) in str(error)
            raise NotImplementedError from error

    return check


SELF_CONTACT = {"particle_enable_self_contact": True, "particle_self_contact_radius": 0.005}


@dataclass
class Row:
    """How the cells of a row are tried."""

    cpu: Callable[[], None]
    gradient: Callable[[str], None]
    options: dict | None = None  # options of the solver; None: no test on another device
    captured: Callable[[], None] | None = None  # replaces the test of a capture

    def on(self, device: str, captured: bool) -> None:
        if captured and self.captured is not None:
            self.captured()
        elif self.options is None:
            self.cpu()
        else:
            both_ways(device, captured, **self.options)


# By the begin of the row.
ROWS = {
    "springs, triangles": Row(
        forward(),
        gradients((
            "particle_spring_stiffness", "particle_spring_damping", "particle_tri_material",
            "particle_tet_material", "particle_edge_material", "particle_tri_activation",
            "particle_tet_activation",
        )),
        {},
    ),
    "rest shapes": Row(
        forward(),
        gradients((
            "particle_spring_rest_length", "particle_edge_rest_length", "particle_edge_rest_angle",
            "particle_tri_pose", "particle_tri_area", "particle_tet_pose",
        )),
        {},
    ),
    "masses, radii": Row(forward(), gradients(("particle_mass", "particle_radius", "gravity")), {}),
    "contacts with world-owned shapes": Row(
        forward(),
        gradients(("shape_margin", "shape_material_ke", "shape_material_kd", "shape_material_mu")),
        {},
    ),
    "targets of kinematic particles": Row(with_targets, target_gradient, {}),
    "`acceleration`": Row(
        forward(acceleration=0.5), option_gradient(acceleration=0.5), {"acceleration": 0.5}
    ),
    "`safeguard`": Row(
        forward(safeguard=True), option_gradient(safeguard=True), {"safeguard": True}
    ),
    "`coarse": Row(
        forward(coarse="auto"),
        gradients(("particle_mass", "gravity"), coarse="auto"),
        {"coarse": "auto"},
    ),
    "`initial_guess": Row(
        forward(initial_guess="adaptive"),
        gradients(("particle_mass", "gravity"), initial_guess="adaptive"),
        {"initial_guess": "adaptive"},
    ),
    "`tolerance`": Row(
        forward(tolerance=1e-3), option_gradient(tolerance=1e-3), {"tolerance": 1e-3}
    ),
    "`solve": Row(
        forward(solve="converged"), option_gradient(solve="converged"), {"solve": "converged"}
    ),
    "drag and lift": Row(each_number(plain), lambda kind: each_number(differentiable)()),
    "rigid bodies": Row(
        lambda: swing(plain(model := pendulum()), model),
        swing_gradient,
        None,
        lambda: swing(plain(model := pendulum()), model, captured=True),
    ),
    "bodies beside particles": Row(bodies, body_gradient, None, body_captured),
    "self-contact": Row(
        forward(**SELF_CONTACT), option_gradient(particle_enable_self_contact=True), SELF_CONTACT
    ),
}  # fmt: skip


def table() -> list[list[str]]:
    """The cells of the rows of "What is covered"."""
    text = GUIDE.read_text("utf-8").split("## What is covered")[1].split("\n\n")[1]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()[2:]]


def try_cell(cell: str, check: Callable[[], None]) -> None:
    assert cell in ("yes", "raises"), cell
    if cell == "yes":
        check()
    else:
        with pytest.raises(NotImplementedError):
            check()


@pytest.mark.parametrize("begin", ROWS)
def test_a_row_of_the_table_is_as_it_says(begin):
    (cells,) = [row for row in table() if row[0].startswith(begin)]
    _, cpu, cuda, captured, gradient, label = cells
    row = ROWS[begin]
    try_cell(cpu, row.cpu)
    assert (label != "") == (gradient == "yes")
    for kind, in_label in (("unrolled", "exact"), ("implicit", "implicit")):
        try_cell("yes" if in_label in label else "raises", lambda kind=kind: row.gradient(kind))
    try_cell(captured, lambda: row.on("cpu", True))
    if HAS_CUDA:
        for replayed in (False, True):
            try_cell(cuda, lambda replayed=replayed: row.on("cuda", replayed))


def test_every_row_of_the_table_is_tested():
    rows = [row[0] for row in table()]
    assert len(rows) == len(ROWS)
    for row in rows:
        assert sum(row.startswith(begin) for begin in ROWS) == 1, row


def differentiate(device: str, captured: bool, kind: str, way: str) -> np.ndarray:
    """The derivative of a step, or of its replay, by the positions."""
    nova, diff = pytest.importorskip("novaphy.nova"), pytest.importorskip("novaphy.diff")
    b = builder()
    b.color()
    model = b.finalize(device)
    solver = novaphy.solvers.DiffSolverVBD(model, iterations=20, gradient=kind)
    before, after = model.state(), model.state()
    q = diff.state_particle_q_tensor(before, True)
    model.particle_tet_material.requires_grad = way == "train"

    def run():
        with nova.Tape() as tape:
            solver.step(before, after, None, None, DT)
            loss = nova.sum(
                diff.state_particle_q_tensor(after) * diff.state_particle_q_tensor(after)
            )
        if way != "jvp":
            tape.backward(loss)
            return q.grad
        (slope,) = tape.jvp([loss], [q], [nova.tensor(np.ones(q.shape, np.float32), device=device)])
        return slope

    if captured:
        with nova.ScopedCapture() as capture:
            found = run()
        capture.graph.launch()
    else:
        found = run()
    if way in ("edit", "train"):
        model.particle_tet_material.assign(2 * model.particle_tet_material.numpy())
        if captured:
            capture.graph.launch()
        else:
            found = run()
    return found.numpy()


def on_device(begin: str, captured: bool) -> None:
    """What a row of "On a device" says is there has the bits of the cpu."""
    kind = "implicit" if "implicit" in begin else "unrolled"
    ways = {"`Tape.jvp`": "jvp", "training of": "train", "after another": "edit"}
    way = ways.get(begin, "backward")
    try:
        found = differentiate("cuda", captured, kind, way)
    except novaphy.Error as error:
        if way != "edit":
            raise
        assert "was modified after the capture" in str(error)
        raise NotImplementedError from error
    assert (found == differentiate("cpu", False, kind, way)).all()


@pytest.mark.skipif(not HAS_CUDA, reason="no CUDA device")
@pytest.mark.parametrize("captured", [False, True], ids=["direct", "captured"])
@pytest.mark.parametrize(
    "begin",
    [
        '`gradient="unrolled"`',
        '`gradient="implicit"`',
        "`Tape.jvp`",
        "training of",
        "after another",
    ],
)
def test_a_row_of_the_table_of_devices_is_as_it_says(begin, captured):
    text = GUIDE.read_text("utf-8").split("## Gradients on devices")[1].split("\n\n")[2]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()[2:]]
    assert len(rows) == 5
    (cells,) = [row for row in rows if row[0].startswith(begin)]
    try_cell(cells[2 if captured else 1], lambda: on_device(begin, captured))
