"""CUDA devices: the bits of the CPU, and exchange of memory."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import (
    DT,
    LEARNING_RATE,
    STEPS,
    TARGET,
    Ball,
    ball_builder,
    ball_contacts,
    golden,
    soft_body_model,
)

import novaphy
from novaphy import diff, nova, solvers
from novaphy.testing import assert_same_bits


def why_not() -> str:
    """Why there is no CUDA device, or nothing."""
    if novaphy.is_device_available("cuda:0"):
        return ""
    reasons = [f"{b.path}: {b.error}" for b in novaphy.backends() if "cuda" in b.name]
    return "; ".join(reasons) or "this build has no CUDA backend"


pytestmark = pytest.mark.skipif(bool(why_not()), reason=why_not() or "there is a CUDA device")


@pytest.fixture(autouse=True)
def _restored_default_device():
    """Leave the default device as it was."""
    before = novaphy.get_default_device()
    yield
    novaphy.set_default_device(before)


def on(device: str, balls: int = 1, steps: int = STEPS) -> Ball:
    """The ball scene on a device."""
    novaphy.set_default_device(device)
    ball = Ball(balls, steps)
    assert str(ball.model.device) == device
    return ball


def test_the_device_describes_itself():
    device = novaphy.get_device("cuda:0")
    assert device.is_cuda and device.name and device.arch >= 70
    assert 0 < device.free_memory <= device.total_memory
    assert device.supports_graph_capture


def test_events_measure_the_time_on_the_device():
    x = nova.tensor(np.ones(1 << 24, np.float32), device="cuda:0")
    start, middle, stop = (novaphy.Event("cuda:0") for _ in range(3))
    for repeats in (1, 10):
        start.record()
        for _ in range(repeats):
            x.fill_(1.0)
        middle.record()
        for _ in range(10 * repeats):
            x.fill_(1.0)
        stop.record()
    short, long = novaphy.Event.elapsed(start, middle), novaphy.Event.elapsed(middle, stop)
    assert short > 1e-5 and 5 < long / short < 20


def test_a_loop_of_steps_has_newtons_bits():
    newton = golden("newton_ball_strict")
    ball = on("cuda:0")
    loss = ball.forward()
    assert_same_bits(ball.array("particle_q"), newton["particle_q"], "particle_q")
    assert_same_bits(ball.array("particle_qd"), newton["particle_qd"], "particle_qd")
    assert_same_bits(ball.array("particle_f")[:-1], newton["particle_f"][:-1], "particle_f")
    assert_same_bits(loss, newton["loss"], "loss")


def gradients(device: str, balls: int, steps: int) -> dict[str, np.ndarray]:
    """States and gradients of a loop of steps."""
    ball = on(device, balls, steps)
    position = diff.state_particle_q_tensor(ball.states[0], requires_grad=True)
    with nova.Tape() as tape:
        loss = ball.forward()
        tape.backward(loss)
        return {
            "q": ball.array("particle_q"),
            "qd": ball.array("particle_qd"),
            "loss": loss.numpy(),
            "grad_qd": ball.velocity.grad.numpy(),
            "grad_q": position.grad.numpy(),
        }


def test_the_forward_solver_has_newtons_bits():
    newton = golden("newton_ball_strict")
    model = ball_builder().finalize("cuda:0")
    model.soft_contact_ke, model.soft_contact_kd = 1.0e4, 10.0
    model.soft_contact_kf, model.soft_contact_mu = 0.0, 0.2
    solver = solvers.SolverSemiImplicit(model)
    states = [model.state() for _ in range(STEPS + 1)]
    contacts = ball_contacts(model, states[0])
    for now, then in zip(states, states[1:]):
        solver.step(now, then, None, contacts, DT)
    q = np.stack([state.particle_q.numpy() for state in states])
    assert_same_bits(q, newton["particle_q"], "particle_q")


def test_the_forward_solver_moves_a_soft_body_with_the_bits_of_the_cpu():
    ends = []
    for device in ("cpu", "cuda:0"):
        model = soft_body_model(device)
        pipeline = novaphy.CollisionPipeline(model, soft_contact_margin=0.01)
        solver, contacts = solvers.SolverSemiImplicit(model), pipeline.contacts()
        now, then = model.state(), model.state()
        for _ in range(300):  # flight and bounce, with new contacts in every step
            now.clear_forces()
            pipeline.collide(now, contacts)
            solver.step(now, then, None, contacts, 1.0 / 960)
            now, then = then, now
        ends.append((now.particle_q.numpy(), now.particle_qd.numpy()))
    assert_same_bits(ends[1][0], ends[0][0], "particle_q")
    assert_same_bits(ends[1][1], ends[0][1], "particle_qd")


def test_a_soft_body_has_the_bits_of_the_cpu():
    results = []
    for device in ("cpu", "cuda:0"):
        model = soft_body_model(device)
        config = solvers.DiffSolverConfig(
            enable_tetrahedra=True, enable_triangles=True, enable_static_contacts=True
        )
        trajectory = diff.Trajectory(model, 300)  # flight and bounce
        materials = diff.model_tet_material_tensor(model, requires_grad=True)
        with nova.Tape() as tape:
            solver = solvers.DiffSemiImplicitSolver(model, config)
            solver.rollout(trajectory, None, None, 1.0 / 960)
            last = diff.particle_centroid_generated(diff.state_particle_q_tensor(trajectory[-1]))
            tape.backward(diff.vec3_point_loss_generated(last, 0.0, -1.0, 1.5))
        assert np.abs(materials.grad.numpy()).max() > 0
        results.append((trajectory.particle_q.numpy(), materials.grad.numpy()))
    assert_same_bits(results[1][0], results[0][0], "particle_q")
    assert_same_bits(results[1][1], results[0][1], "gradient of the materials")


@pytest.mark.parametrize(("balls", "steps"), [(1, STEPS), (7, 60), (3000, 20)])
def test_states_and_gradients_have_the_bits_of_the_cpu(balls, steps):
    cpu, cuda = gradients("cpu", balls, steps), gradients("cuda:0", balls, steps)
    assert np.abs(cpu["grad_qd"]).max() > 0
    for name, expected in cpu.items():
        assert_same_bits(cuda[name], expected, name)


def trained(
    device: str, balls: int, captured: bool, iterations: int, spheres: int = 0
) -> list[np.ndarray]:
    """Trajectory and velocity after some iterations of a rollout, recorded anew or replayed."""
    novaphy.set_default_device(device)
    builder = ball_builder(balls)
    for k in range(spheres):
        at = ((0.3 * k - 0.4, 0.9, 0.2 * k), (0.0, 0.0, 0.0, 1.0))
        builder.add_shape_sphere(-1, xform=at, radius=0.25)
    model = builder.finalize(device, requires_grad=True)
    model.soft_contact_ke, model.soft_contact_kd = 1.0e4, 10.0
    model.soft_contact_kf, model.soft_contact_mu = 0.0, 0.2
    trajectory = diff.Trajectory(model, STEPS)
    contacts = ball_contacts(model, trajectory[0])
    solver = solvers.DiffSemiImplicitSolver(
        model, solvers.DiffSolverConfig(contact_gradient="code")
    )
    velocity = diff.state_particle_qd_tensor(trajectory[0], requires_grad=True)
    target = nova.tensor(np.tile(np.float32(TARGET), (balls, 1)), device=device)

    def iterate():
        with nova.Tape() as tape:
            solver.rollout(trajectory, None, contacts, DT)
            delta = diff.state_particle_q_tensor(trajectory[STEPS]) - target
            loss = nova.dot(delta, delta)
            tape.backward(loss)
            nova.sgd_update_f32(velocity, LEARNING_RATE)
            tape.zero()
        return loss

    if captured:
        with nova.ScopedCapture() as capture:
            loss = iterate()
        capture.graph.prepare()
        for _ in range(iterations):
            capture.graph.launch()
    else:
        for _ in range(iterations):
            loss = iterate()
    return [trajectory.particle_q.numpy(), velocity.numpy(), loss.numpy()]


@pytest.mark.parametrize("balls", [1, 5000])
def test_a_captured_iteration_replays_with_the_bits_of_the_cpu(balls):
    expected = trained("cpu", balls, False, 3)
    for captured in (False, True):
        for name, a, b in zip(
            ("q", "velocity", "loss"), trained("cuda:0", balls, captured, 3), expected
        ):
            assert_same_bits(a, b, f"{name}, captured {captured}")


@pytest.mark.parametrize("spheres", [1, 4])
def test_contacts_beyond_those_in_registers_count_too(spheres):
    expected = trained("cpu", 9, False, 2, spheres)
    for name, a, b in zip(
        ("q", "velocity", "loss"), trained("cuda:0", 9, True, 2, spheres), expected
    ):
        assert_same_bits(a, b, name)


def test_a_loss_over_very_many_rows_has_the_bits_of_the_cpu():
    values = np.random.default_rng(3).standard_normal((70001, 3)).astype(np.float32)
    losses = []
    for device in ("cpu", "cuda:0"):
        x = nova.tensor(values, device=device)
        losses.append(nova.dot(x, x).numpy())
    assert_same_bits(losses[1], losses[0], "dot")


def trained_body(device: str, leaves: bool) -> list[np.ndarray]:
    """A soft body in flight and bounce: two captured iterations that change its materials."""
    model = soft_body_model(device)
    config = solvers.DiffSolverConfig(
        enable_tetrahedra=True, enable_triangles=True, enable_static_contacts=True
    )
    solver = solvers.DiffSemiImplicitSolver(model, config)
    trajectory = diff.Trajectory(model, 260)
    materials = diff.model_tet_material_tensor(model, requires_grad=True)
    with nova.ScopedCapture() as capture:
        with nova.Tape(leaf_gradients_only=leaves) as tape:
            solver.rollout(trajectory, None, None, 1.0 / 960)
            last = diff.particle_centroid_generated(diff.state_particle_q_tensor(trajectory[-1]))
            tape.backward(diff.vec3_point_loss_generated(last, 0.0, -1.0, 1.5))
    capture.graph.prepare()
    for _ in range(2):
        capture.graph.launch()
    return [trajectory.particle_q.numpy(), trajectory.particle_qd.numpy(), materials.grad.numpy()]


@pytest.mark.parametrize("leaves", [False, True])
def test_phases_have_the_bits_of_the_cpu_on_one_block_a_cluster_and_the_whole_device(
    leaves, monkeypatch
):
    expected = trained_body("cpu", leaves)
    assert np.abs(expected[2]).max() > 0
    for phases in ("0", "", "1x64", "4x32", "16x64", "20x96"):
        monkeypatch.setenv("NOVAPHY_DEVICE_PHASES", phases)
        for name, a, b in zip(("q", "qd", "materials"), trained_body("cuda:0", leaves), expected):
            assert_same_bits(a, b, f"{name}, phases {phases!r}")


AT_ONCE = """
import ctypes, sys
from novaphy import diff, nova, solvers
from scenes import soft_body_model

model = soft_body_model(sys.argv[1])
config = solvers.DiffSolverConfig(
    enable_tetrahedra=True, enable_triangles=True, enable_static_contacts=True
)
solver = solvers.DiffSemiImplicitSolver(model, config)
trajectory = diff.Trajectory(model, 40)
with nova.ScopedCapture() as capture:
    solver.rollout(trajectory, None, None, 1.0 / 960)
graph = capture.graph
ctypes.pythonapi.Py_IncRef(ctypes.py_object(graph))  # nobody destroys it
graph.launch()
print(trajectory.particle_q.numpy().tobytes().hex())
"""


def test_a_launch_does_not_wait_for_the_compiler_and_the_exit_does():
    def run(device: str) -> str:
        child = subprocess.run(
            [sys.executable, "-c", AT_ONCE, device],
            capture_output=True,
            text=True,
            cwd=Path(__file__).parent,
            env={**os.environ, "NOVAPHY_CACHE_DIR": "off"},
        )
        assert child.returncode == 0, child.stderr
        return child.stdout

    assert run("cuda:0") == run("cpu")


def test_replays_have_the_same_bits_before_and_after_their_kernels_are_fused():
    ball = on("cuda:0", 5)
    trajectory = diff.Trajectory(ball.model, STEPS)
    with nova.ScopedCapture() as capture:
        ball.solver.rollout(trajectory, None, ball.contacts, DT)
    results = []
    for _ in range(2):
        capture.graph.launch()
        results.append(trajectory.particle_q.numpy())
        only_first = results[-1].copy()
        only_first[1:] = 0.0
        trajectory.particle_q.assign(only_first)
        capture.graph.prepare()
    assert_same_bits(results[1], results[0], "particle_q")
    assert np.abs(results[0][-1, :, 1:]).min() > 0.1


CONTACT_FIELDS = [
    "soft_contact_count",
    "soft_contact_particle",
    "soft_contact_shape",
    "soft_contact_body_pos",
    "soft_contact_body_vel",
    "soft_contact_normal",
    "soft_contact_tids",
    "contact_generation",
]


def many_shapes() -> novaphy.ModelBuilder:
    """Particles among shapes of all covered types."""
    builder = novaphy.ModelBuilder()
    random = np.random.default_rng(5)
    n = 700
    builder.add_particles(
        random.uniform(-1.5, 1.5, (n, 3)).astype(np.float32),
        np.zeros((n, 3), np.float32),
        np.ones(n, np.float32),
    )
    turned = ((0.1, 0.2, 0.3), tuple(np.float32([0.5, 0.5, -0.5, 0.5])))
    builder.add_shape_box(-1, xform=turned, hx=0.5, hy=0.4, hz=0.3)
    builder.add_shape_sphere(-1, xform=((0.7, 0.0, 0.2), (0.0, 0.0, 0.0, 1.0)), radius=0.4)
    builder.add_shape_capsule(-1, xform=turned, radius=0.2, half_height=0.5)
    builder.add_ground_plane()
    return builder


@pytest.mark.parametrize("slots", [None, 50, 0])
def test_contacts_have_the_slots_and_bits_of_the_cpu(slots):
    found = {}
    for device in ("cpu", "cuda:0"):
        model = many_shapes().finalize(device)
        options = {} if slots is None else {"soft_contact_max": slots}
        pipeline = novaphy.CollisionPipeline(model, soft_contact_margin=0.1, **options)
        contacts, state = pipeline.contacts(), model.state()
        pipeline.collide(state, contacts)
        moved = state.particle_q.numpy() * np.float32(0.75)
        state.particle_q.assign(moved)
        pipeline.collide(state, contacts)
        found[device] = {name: getattr(contacts, name).numpy() for name in CONTACT_FIELDS}
    assert found["cpu"]["soft_contact_count"][0] > 100
    for name, expected in found["cpu"].items():
        assert_same_bits(found["cuda:0"][name], expected, name)


def test_arrays_move_between_devices():
    values = np.arange(12, dtype=np.float32).reshape(4, 3)
    array = novaphy.DeviceArray(values, novaphy.vec3, device="cuda:0")
    assert str(array.device) == "cuda:0"
    np.testing.assert_array_equal(array.numpy(), values)
    np.testing.assert_array_equal(array.to("cpu").numpy(), values)
    np.testing.assert_array_equal(array.to("cpu").to("cuda:0").numpy(), values)
    array[1] = (7.0, 8.0, 9.0)
    np.testing.assert_array_equal(array[1], np.float32([7, 8, 9]))
    with pytest.raises(novaphy.Error, match="cuda:0"):
        array.numpy(copy=False)
    with pytest.raises(AttributeError):
        _ = array.__array_interface__


def gather_kernel():
    """Value of the row that a table names."""
    return nova.make_indexed_kernel(
        "reads_where_it_is_told",
        [("at", nova.int32), ("value", nova.float32, 1, "indexed")],
        1,
        lambda c: c.f32("value", c.i32("at"), 0),
    )


@pytest.mark.parametrize("order", [0, 1, "mixed"])
def test_smoothed_gradients_have_the_bits_of_the_cpu(order):
    found = []
    for device in ("cpu", "cuda:0"):
        weights = nova.tensor([1.0, 2.0, 3.0], device=device)
        theta = nova.tensor([0.1, 0.2, 0.3], device=device, requires_grad=True)

        def losses(x, weights=weights):
            return nova.sum(x * x * weights, -1)

        with nova.Tape() as tape:
            loss = diff.smoothed(losses, theta, 0.1, order=order)
            tape.backward(loss)
        plain = diff.smoothed(losses, theta, 0.1)
        assert {str(x.device) for x in (loss, plain, theta.grad)} == {device}
        found.append((loss.numpy(), theta.grad.numpy(), plain.numpy()))
    for on_cpu, on_device in zip(*found, strict=True):
        assert_same_bits(on_device, on_cpu)


def test_a_certificate_has_the_verdict_of_the_cpu():
    """The entries of theta lie on two devices."""
    theta = {
        "a": nova.tensor([0.1, 0.2], device="cuda:0"),
        "b": nova.tensor([0.3], device="cpu"),
    }

    def losses(x):
        return nova.sum(x["a"] * x["a"], -1).to("cpu") + nova.sum(x["b"] * x["b"], -1)

    found = diff.certify(losses, theta, 0.1)
    assert found.verdict == "of the motion"
    assert np.allclose(found.gradient, [0.02, 0.04, 0.06])


def test_a_read_past_the_end_names_the_kernel_the_row_and_the_source():
    kernel = gather_kernel()
    value = nova.tensor(np.float32([1, 2, 3]), device="cuda:0")
    good = nova.tensor(np.int32([2, -1, 0]), device="cuda:0")
    bad = nova.tensor(np.int32([0, 9, 7]), device="cuda:0")
    (y,) = kernel(3, [bad, value])
    with pytest.raises(IndexError) as error:
        y.numpy()
    for part in ("reads_where_it_is_told", "i = 1 reads row 9", "'value'", "3 rows"):
        assert part in str(error.value)
    (y,) = kernel(3, [good, value])  # the device works on; a negative row reads 0
    np.testing.assert_array_equal(y.numpy(), np.float32([3, 0, 1]))


@pytest.mark.parametrize(("lists", "phases"), [("0", "0"), ("0", "1x32"), ("1", "0")])
def test_a_replay_reports_a_read_past_the_end(lists, phases, monkeypatch):
    monkeypatch.setenv("NOVAPHY_DEVICE_LISTS", lists)
    monkeypatch.setenv("NOVAPHY_DEVICE_PHASES", phases)
    step = nova.make_indexed_kernel(
        "a_step",
        [("x", nova.float32), ("at", nova.int32), ("value", nova.float32, 1, "indexed")],
        1,
        lambda c: c.f32("x") + c.f32("value", c.i32("at"), 0),
    )
    value = nova.tensor(np.float32([1, 2, 3]), device="cuda:0")
    at = nova.tensor(np.int32([0, 1, 2, 0]), device="cuda:0")
    x = nova.tensor(np.zeros(4, np.float32), device="cuda:0")
    with nova.ScopedCapture() as capture:
        y = x
        for _ in range(20):
            (y,) = step(4, [y, at, value])
    capture.graph.prepare()
    capture.graph.launch()
    np.testing.assert_array_equal(y.numpy(), np.float32([20, 40, 60, 20]))
    at.assign(np.int32([0, 1, 3, 0]))
    capture.graph.launch()
    with pytest.raises(IndexError, match="'a_step': row i = 2 reads row 3 of source 'value'"):
        novaphy.synchronize("cuda:0")


def test_memory_is_shared_with_cupy():
    cupy = pytest.importorskip("cupy")
    array = novaphy.DeviceArray(np.arange(6, dtype=np.float32), device="cuda:0")
    interface = array.__cuda_array_interface__
    assert interface["version"] == 3 and interface["shape"] == (6,)
    view = cupy.asarray(array)
    assert view.data.ptr == array.ptr
    np.testing.assert_array_equal(cupy.asnumpy(view), np.arange(6, dtype=np.float32))
    theirs = cupy.arange(5, dtype=cupy.float32) * 2
    ours = novaphy.DeviceArray.from_dlpack(theirs)
    assert ours.ptr == theirs.data.ptr and str(ours.device) == "cuda:0"
    np.testing.assert_array_equal(ours.numpy(), np.float32([0, 2, 4, 6, 8]))
    theirs += 1  # on CuPy's stream, then read on ours
    np.testing.assert_array_equal(ours.numpy(), np.float32([1, 3, 5, 7, 9]))


def test_streams_of_exports_are_those_of_the_protocols():
    array = novaphy.DeviceArray(np.arange(6, dtype=np.float32), device="cuda:0")
    assert array.__cuda_array_interface__["stream"] == 1
    assert array.__dlpack_device__() == (2, 0)
    for stream in (None, -1, 1, 2):
        assert "dltensor" in repr(array.__dlpack__(stream=stream))
    with pytest.raises(ValueError, match="expected None, -1, 1, 2 or a stream's address, got 0"):
        array.__dlpack__(stream=0)


def test_an_import_waits_for_the_stream_on_which_the_values_are_made():
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("this PyTorch sees no CUDA device")
    factor = nova.tensor(np.full(1, 2, np.float32), device="cuda:0")
    busy = torch.rand(4096, 4096, device="cuda")
    theirs = torch.zeros(1 << 20, device="cuda")
    torch.cuda.synchronize()
    with torch.cuda.stream(torch.cuda.Stream()):
        for _ in range(20):  # some milliseconds
            busy = busy @ busy * 1e-3
        theirs += 3
        ours = nova.from_dlpack(theirs)
    np.testing.assert_array_equal((ours * factor).numpy(), np.full(1 << 20, 6, np.float32))


def test_memory_is_shared_with_an_object_that_has_the_array_interface_only():
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("this PyTorch sees no CUDA device")
    theirs = torch.arange(6, dtype=torch.float32, device="cuda").reshape(2, 3)
    only = SimpleNamespace(__cuda_array_interface__=theirs.__cuda_array_interface__)
    ours = nova.from_cuda_array_interface(only)
    assert ours.shape == (2, 3) and str(ours.device) == "cuda:0"
    theirs.mul_(2)  # on the default stream
    np.testing.assert_array_equal((ours + ours).numpy(), 4 * np.arange(6.0).reshape(2, 3))


def test_an_export_is_whole_on_every_stream_of_the_consumer():
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("this PyTorch sees no CUDA device")
    x = nova.tensor(np.full(1 << 22, 1, np.float32), device="cuda:0")
    for _ in range(50):
        x = x + x * 0.5
    with torch.cuda.stream(torch.cuda.Stream()):
        total = torch.from_dlpack(x).clone().cpu()  # waits for this stream
    np.testing.assert_array_equal(total.numpy(), x.numpy())


def test_memory_is_shared_with_torch():
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("this PyTorch sees no CUDA device")
    theirs = torch.arange(6, dtype=torch.float32, device="cuda").reshape(2, 3)
    ours = novaphy.DeviceArray.from_dlpack(theirs)
    assert ours.ptr == theirs.data_ptr() and ours.shape == (2, 3)
    ours[0] = (5.0, 6.0, 7.0)
    novaphy.synchronize("cuda:0")
    assert theirs[0].tolist() == [5.0, 6.0, 7.0]
    theirs.mul_(2)
    np.testing.assert_array_equal(ours.numpy()[0], np.float32([10, 12, 14]))
    back = torch.as_tensor(ours, device="cuda")
    assert back.data_ptr() == theirs.data_ptr()


CONTRACTED = """
import sys
import numpy as np
from scenes import Ball
import novaphy
from novaphy import nova

novaphy.set_default_device("cuda:0")
ball = Ball()
with nova.Tape() as tape:
    loss = ball.forward()
    tape.backward(loss)
    np.savez(
        sys.argv[1],
        particle_q=ball.array("particle_q"),
        particle_qd=ball.array("particle_qd"),
        loss=loss.numpy(),
        grad_ad=ball.velocity.grad.numpy(),
    )
"""


def test_with_contraction_the_ball_has_newtons_bits_on_a_gpu(tmp_path):
    newton, strict = golden("newton_ball_contracted"), golden("newton_ball_strict")
    result = tmp_path / "ball.npz"
    run = subprocess.run(
        [sys.executable, "-c", CONTRACTED, str(result)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parent,
        env={**os.environ, "NOVAPHY_CUDA_CONTRACT": "on", "NOVAPHY_DEVICE_INTERPRETER": ""},
    )
    if "cannot be compiled" in run.stderr:
        pytest.skip("contraction needs NVRTC")
    assert run.returncode == 0, run.stderr
    with np.load(result) as ours:
        assert not np.array_equal(ours["particle_qd"], strict["particle_qd"])
        for name in ("particle_q", "particle_qd", "loss", "grad_ad"):
            assert_same_bits(ours[name].reshape(newton[name].shape), newton[name], name)
