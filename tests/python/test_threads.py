"""Threads, processes and signals: the same bits for any number of threads, and Ctrl-C works."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest
from scenes import DT, TARGET, Ball, ball_contacts, ball_model

import novaphy
from novaphy import diff, nova, solvers
from novaphy.testing import assert_same_bits

HERE = os.path.dirname(__file__)


@pytest.fixture
def threads():
    """Set the number of threads for a test."""
    before = novaphy.num_threads()
    yield novaphy.set_num_threads
    novaphy.set_num_threads(before)


def rollout(balls: int, steps: int) -> list[np.ndarray]:
    """States and gradient of a rollout of many balls."""
    model = ball_model(balls)
    trajectory = diff.Trajectory(model, steps)
    contacts = ball_contacts(model, trajectory[0])
    velocity = diff.state_particle_qd_tensor(trajectory[0], requires_grad=True)
    with nova.Tape() as tape:
        solvers.DiffSemiImplicitSolver(model).rollout(trajectory, None, contacts, DT)
        loss = nova.sum(diff.state_particle_q_tensor(trajectory[steps]))
        tape.backward(loss)
    return [trajectory.particle_q.numpy(), velocity.grad.numpy(), loss.numpy()]


def test_any_number_of_threads_gives_the_same_bits(threads):
    results = []
    for count in (1, 2, 7):
        threads(count)
        results.append(rollout(5000, 20))
    for other in results[1:]:
        for one, two in zip(results[0], other):
            assert_same_bits(one, two)


def cloth_rollout(model, solver, seed):
    rng = np.random.default_rng(seed)
    state, after = model.state(), model.state()
    state.particle_qd.assign(rng.normal(size=(model.particle_count, 3)).astype(np.float32))
    for _ in range(50):
        state.clear_forces()
        solver.step(state, after, None, None, 5e-4)
        state, after = after, state
    return state.particle_q.numpy()


def diff_rollout(model, solver, seed):
    rng = np.random.default_rng(seed)
    trajectory = diff.Trajectory(model, 50)
    qd = rng.normal(size=(model.particle_count, 3)).astype(np.float32)
    trajectory[0].particle_qd.assign(qd)
    solver.rollout(trajectory, None, None, 5e-4)
    return trajectory[50].particle_q.numpy()


@pytest.mark.parametrize("rollout", [cloth_rollout, diff_rollout])
def test_one_solver_in_two_threads_gives_the_right_states_or_raises(rollout):
    builder = novaphy.ModelBuilder()
    builder.add_cloth_grid(
        dim_x=20, dim_y=20, cell_x=0.1, cell_y=0.1, mass=0.1, tri_ke=500, tri_ka=500, tri_kd=1.0
    )
    model = builder.finalize()
    if rollout is cloth_rollout:
        solver = solvers.SolverSemiImplicit(model)
    else:
        config = solvers.DiffSolverConfig(enable_triangles=True, strict=False)
        solver = solvers.DiffSemiImplicitSolver(model, config)
    expected = [rollout(model, solver, seed) for seed in range(4)]
    got, refused = {}, []

    def work(seed):
        try:
            got[seed] = rollout(model, solver, seed)
        except novaphy.Error as error:
            refused.append(str(error))

    for _ in range(5):
        workers = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        for seed, positions in got.items():
            assert_same_bits(positions, expected[seed])
        got.clear()
    assert all("the solver is in use by another call" in message for message in refused)
    assert_same_bits(rollout(model, solver, 0), expected[0])


def test_one_tape_in_two_threads_gives_the_right_gradient_or_raises():
    x = nova.tensor(np.ones(100_000, np.float32), requires_grad=True)
    with nova.Tape() as tape:
        y = x
        for _ in range(20):
            y = y * x
        loss = nova.sum(y)
    tape.backward(loss)
    once = x.grad.numpy()
    x.zero_grad()
    passes, refused = [], []

    def go():
        for _ in range(20):
            try:
                tape.backward(loss)
                passes.append(None)
            except RuntimeError as error:
                refused.append(str(error))

    threads = [threading.Thread(target=go) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(passes) + len(refused) == 40 and passes
    assert all("the tape is in use by another call" in text for text in refused)
    np.testing.assert_array_equal(x.grad.numpy(), len(passes) * once)


def test_two_threads_with_two_tapes_do_not_meet():
    alone = Ball()
    with nova.Tape() as tape:
        tape.backward(alone.forward())
    expected = alone.velocity.grad.numpy()
    results: dict[int, np.ndarray] = {}
    errors: list[BaseException] = []
    start = threading.Barrier(4)

    def work(index: int) -> None:
        try:
            ball = Ball()
            start.wait()
            for _ in range(5):
                with nova.Tape() as tape:
                    tape.backward(ball.forward())
                    results[index] = ball.velocity.grad.numpy()
                    tape.zero()
        except BaseException as error:
            errors.append(error)

    workers = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert not errors
    for result in results.values():
        assert_same_bits(result, expected)


@pytest.fixture
def no_forced_switches():
    """Another thread of Python runs only when the running one gives up the interpreter itself."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1000.0)
    yield
    sys.setswitchinterval(interval)


def test_python_runs_while_the_engine_computes(no_forced_switches):
    model = ball_model(2000)
    trajectory = diff.Trajectory(model, 500)
    contacts = ball_contacts(model, trajectory[0])
    solver = solvers.DiffSemiImplicitSolver(model)
    done, ticks = threading.Event(), [0]

    def tick() -> None:
        while not done.is_set():
            ticks[0] += 1
            time.sleep(0.0001)

    ticker = threading.Thread(target=tick)
    ticker.start()
    limit = time.perf_counter() + 30
    inside = 0
    # A rollout may end before the other thread is scheduled, so the test runs more than one.
    while inside < 3 and time.perf_counter() < limit:
        before = ticks[0]
        solver.rollout(trajectory, None, contacts, DT)
        inside += ticks[0] - before
    done.set()
    ticker.join()
    assert inside >= 3


def test_a_custom_backward_may_run_on_a_thread_that_has_no_python_work():
    x = nova.tensor([2.0], requires_grad=True)
    seen = []
    with nova.Tape() as tape:
        y = nova.tensor([4.0])
        tape.record_custom("square", [x], [y], lambda g: seen.append(1) or [g[0] * 4.0])
    worker = threading.Thread(target=tape.backward, args=(y,))
    worker.start()
    worker.join()
    assert seen == [1] and x.grad.tolist() == [4]


def run(code: str, **options) -> subprocess.CompletedProcess[str]:
    """Run code that may import scenes in a process of its own."""
    text = f"import sys; sys.path.insert(0, {HERE!r})\n" + code
    return subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, timeout=300, **options
    )


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
def test_a_forked_child_computes_the_same():
    result = run(
        """
import os, warnings
warnings.simplefilter("ignore")
import numpy as np
import novaphy
from scenes import ball_model, ball_contacts, DT
from novaphy import solvers
novaphy.set_num_threads(4)

def end():
    model = ball_model(5000)
    contacts = ball_contacts(model, model.state())
    solver = solvers.SolverSemiImplicit(model)
    a, b = model.state(), model.state()
    for _ in range(20):
        a.clear_forces()
        solver.step(a, b, None, contacts, DT)
        a, b = b, a
    return a.particle_q.numpy().tobytes()

expected = end()
read, write = os.pipe()
pid = os.fork()
if pid == 0:
    os.close(read)
    os.write(write, b"same" if end() == expected else b"other")
    os._exit(0)
os.close(write)
said = os.read(read, 100)
os.waitpid(pid, 0)
assert said == b"same", said
assert end() == expected
print("ok")
"""
    )
    assert result.stdout.strip() == "ok", result.stderr


LONG = {
    "rollout": """
        solver.rollout(trajectory, None, contacts, DT)
    """,
    "step": """
        solver.step(trajectory[0], trajectory[1], None, contacts, DT)
    """,
    "backward": """
        with nova.Tape() as tape:
            solver.rollout(trajectory, None, contacts, DT)
            tape.backward(nova.sum(last))
    """,
    "launch": """
        with nova.ScopedCapture() as capture:
            solver.rollout(trajectory, None, contacts, DT)
        while True:
            capture.graph.launch()
    """,
}
SCRIPT = """
import signal
from scenes import ball_model, ball_contacts, DT
from novaphy import diff, nova, solvers

signal.signal(signal.SIGINT, signal.default_int_handler)  # who started us may ignore it

model = ball_model(2000)
trajectory = diff.Trajectory(model, 4000)
velocity = diff.state_particle_qd_tensor(trajectory[0], requires_grad=True)
last = diff.state_particle_q_tensor(trajectory[4000])
contacts = ball_contacts(model, trajectory[0])
solver = solvers.DiffSemiImplicitSolver(model)
try:
    print("started", flush=True)
    while True:
{work}
except KeyboardInterrupt:
    # The engine works as before.
    solver.step(model.state(), model.state(), None, contacts, DT)
    print("interrupted")
"""


def cpu_seconds(pid: int) -> float:
    """What a process has used, in all its threads."""
    with open(f"/proc/{pid}/stat") as file:
        words = file.read().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.parametrize("what", LONG)
def test_ctrl_c_interrupts_long_native_work(what):
    code = SCRIPT.replace("{work}", textwrap.indent(textwrap.dedent(LONG[what]), " " * 8))
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([HERE, os.environ.get("PYTHONPATH", "")])},
    )
    assert process.stdout is not None and process.stderr is not None
    try:
        assert process.stdout.readline().strip() == "started", process.stderr.read()
        time.sleep(1.0)
        begin, ended = cpu_seconds(process.pid), os.times()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=300)
    finally:
        process.kill()
    assert out.strip() == "interrupted" and err == ""
    now = os.times()
    used = now.children_user + now.children_system - ended.children_user - ended.children_system
    assert used - begin < 5  # s of work after the signal, however busy the machine is


def test_a_signal_handler_that_raises_reaches_the_caller():
    result = run(
        """
import signal
from scenes import ball_model, ball_contacts, DT
from novaphy import diff, solvers

class Stop(Exception):
    pass

def stop(*_):
    raise Stop

signal.signal(signal.SIGALRM, stop)
model = ball_model(2000)
trajectory = diff.Trajectory(model, 4000)
contacts = ball_contacts(model, trajectory[0])
solver = solvers.DiffSemiImplicitSolver(model)
signal.setitimer(signal.ITIMER_REAL, 0.3)
try:
    while True:
        solver.rollout(trajectory, None, contacts, DT)
except Stop:
    print("stopped")
"""
    )
    assert result.stdout.strip() == "stopped", result.stderr


@pytest.mark.slow
@pytest.mark.parametrize("begin, end", [("if True:", ""), ("try:", "except BaseException: pass")])
def test_the_interpreter_ends_cleanly_while_daemon_threads_compute(begin, end):
    result = run(
        f"""
import threading
import time
from scenes import DT, ball_contacts, ball_model
from novaphy import diff, solvers

def work():
    model = ball_model(200)
    trajectory = diff.Trajectory(model, 20000)
    contacts = ball_contacts(model, trajectory[0])
    solver = solvers.DiffSemiImplicitSolver(model)
    while True:
        {begin}
            solver.rollout(trajectory, None, contacts, DT)
        {end}

for _ in range(3):
    threading.Thread(target=work, daemon=True).start()
time.sleep(0.5)
"""
    )
    assert result.returncode == 0 and result.stderr == "", result.stderr


def test_the_interpreter_ends_cleanly_whatever_is_alive():
    result = run(
        f"""
import threading
from scenes import Ball
from novaphy import nova
ball = Ball()
tape = nova.Tape()
tape.__enter__()
loss = ball.forward()
tape.record_custom("held", [ball.velocity], [nova.zeros(1)], lambda g: g)
tape.backward(loss)
alias = ball.states[3].particle_q.numpy(copy=False, writable=True)
capture = nova.ScopedCapture()
kernel = nova.make_indexed_kernel("k", [("x", nova.float32)], 1, lambda c: c.f32("x"))
print("end", {TARGET!r}[1])
"""
    )
    assert (result.returncode, result.stderr) == (0, "") and result.stdout.startswith("end")
