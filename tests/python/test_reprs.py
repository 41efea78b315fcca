"""What objects print: sizes, device, values."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import solvers


def scene() -> tuple[novaphy.ModelBuilder, novaphy.Model]:
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    body = builder.add_body(xform=((0, 0, 1), (0, 0, 0, 1)))
    builder.add_shape_sphere(body, radius=0.1)
    return builder, builder.finalize()


def test_an_array_shows_its_values():
    array = novaphy.DeviceArray(np.float32([[1, 2, 3], [4, 5, 6.5]]), dtype=novaphy.vec3)
    assert repr(array) == (
        "DeviceArray([[1. , 2. , 3. ],\n"
        "             [4. , 5. , 6.5]], shape=(2, 3), dtype=vec3, device='cpu')"
    )
    long = repr(novaphy.DeviceArray(np.arange(1000, dtype=np.int32)))
    assert "..." in long and len(long) < 200 and "shape=(1000,), dtype=int32" in long
    assert "shape=(0, 3)" in repr(novaphy.DeviceArray.zeros(0, novaphy.vec3))


def test_a_capture_shows_no_values():
    nova = pytest.importorskip("novaphy.nova")
    array = novaphy.DeviceArray.zeros(2)
    contacts = novaphy.CollisionPipeline(scene()[1]).contacts()
    with nova.ScopedCapture():
        assert repr(array) == "DeviceArray(shape=(2,), dtype=float32, device='cpu')"
        assert " of " not in repr(contacts)


def test_objects_show_what_they_are_made_of():
    builder, model = scene()
    pipeline = novaphy.CollisionPipeline(model)
    assert repr(builder).startswith("ModelBuilder(body_count=1, shape_count=2")
    assert repr(novaphy.ModelBuilder()) == "ModelBuilder()"
    for thing, text in {
        pipeline: "CollisionPipeline(broad_phase='explicit', rigid_contact_max=",
        pipeline.contacts(): "Contacts(rigid: 0 of ",
        solvers.SolverSemiImplicit(model): "SolverSemiImplicit(body_count=1, shape_count=2, ",
        novaphy.ShapeConfig(mu=0.25): "ShapeConfig(",
        novaphy.JointDofConfig((1, 0, 0), target_q=0.5): "JointDofConfig(",
    }.items():
        shown = repr(thing)
        assert shown.startswith(text) and shown.endswith(")") and "0x" not in shown, shown
    assert "mu=0.25" in repr(novaphy.ShapeConfig(mu=0.25))
    assert "mu_torsional=0.005, mu_rolling=1e-04," in repr(novaphy.ShapeConfig())  # as given
    assert "limit_upper=1e+10," in repr(novaphy.JointDofConfig((1, 0, 0)))
    assert "target_q=0.5" in repr(novaphy.JointDofConfig((1, 0, 0), target_q=0.5))


def test_differentiable_objects_do_so_too():
    diff = pytest.importorskip("novaphy.diff")
    model = scene()[1]
    assert repr(diff.Trajectory(model, 6, checkpoint=2)).startswith(
        "Trajectory(steps=6, checkpoint_interval=2, body_count=1"
    )
    assert "angular_damping=0.05," in repr(solvers.DiffSolverConfig())
    assert repr(solvers.DiffSemiImplicitSolver(model)).startswith("DiffSemiImplicitSolver(body_")


def test_tapes_graphs_and_optimizers_show_their_sizes():
    nova = pytest.importorskip("novaphy.nova")
    x = nova.tensor([[1.0, 2.0]], requires_grad=True)
    tape = nova.Tape()
    assert repr(tape).startswith("Tape(size=0, memory_bytes=")
    with tape:
        nova.sum(x * x)
    assert repr(tape).startswith("Tape(size=2, last='sum', memory_bytes="), repr(tape)
    capture = nova.ScopedCapture()
    assert repr(capture) == "ScopedCapture()"
    with capture:
        _ = x * 2.0
    assert repr(capture.graph) == f"Graph(size={len(capture.graph)})"
    assert repr(capture) == f"ScopedCapture(graph={capture.graph!r})"
    for name in ("SGD", "Adam"):
        optimizer = getattr(nova.optim, name)([x, nova.zeros(3)], lr=0.1)
        assert repr(optimizer) == f"{name}(params=[(1, 2), (3,)], lr=0.1)"
