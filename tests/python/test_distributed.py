"""Gradients over blocks of worlds: the same bits on any number of ranks, by every transport."""

from __future__ import annotations

import contextlib
import fcntl
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import novaphy

pytest.importorskip("novaphy.diff")

from novaphy import diff, nova, solvers
from novaphy import distributed as dist
from novaphy.distributed._shard import part_of
from novaphy.distributed._tree import BlockSums

WORLDS, BLOCK, STEPS = 28, 4, 12
DEMO = Path(__file__).parents[2] / "python" / "demos" / "diff" / "demo_distributed.py"


class Threads(dist.Group):
    """Ranks that are threads of this process."""

    kind = "threads"

    def __init__(self, board, rank, size):
        self.board, self.rank, self.size = board, rank, size

    def _gather(self, message, call):
        messages, barrier = self.board
        barrier.wait(30)
        messages[self.rank] = message
        barrier.wait(30)
        return [messages[k] for k in range(self.size)]


def on_ranks(size, function):
    """Results of function(group), or its exceptions, by rank."""
    board = ({}, threading.Barrier(size))

    def run(rank):
        try:
            return function(Threads(board, rank, size))
        except Exception as error:
            return error

    with ThreadPoolExecutor(size) as pool:
        return list(pool.map(run, range(size)))


def bouncing():
    """A ball that meets the ground."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    builder.add_particle((0, 0, 0.05), (0, 0, 0), 1.0, radius=0.05)
    return builder


def pendulum():
    """A body on a hinge."""
    builder = novaphy.ModelBuilder()
    link = builder.add_link(mass=1.0, inertia=np.eye(3), com=(0.0, 0.0, -0.5))
    builder.add_articulation([builder.add_joint_revolute(-1, link, axis=(0, 1, 0))])
    return builder


def cloth():
    """Four particles of a sheet, for VBD."""
    builder = novaphy.ModelBuilder()
    builder.add_cloth_grid(
        pos=(0, 0, 1), rot=(0, 0, 0, 1), vel=(0, 0, 0), dim_x=1, dim_y=1, cell_x=0.1, cell_y=0.1,
        mass=0.1, tri_ke=100.0, tri_ka=100.0, tri_kd=0.0, edge_ke=0.1,
    )  # fmt: skip
    builder.color()
    return builder


def pushes(block, width):
    return nova.random_normal((block.worlds, width), seed=3, first_world=block.first_world)


def rollout(block, params):
    """Losses {worlds}: of the position at the end, for another push in each world."""
    model, kept = block.model, block.kept
    if not kept:
        kind = solvers.DiffSemiImplicitSolver
        if model.joint_count:
            kind = solvers.DiffFeatherstoneSolver
        elif model.tri_count:
            kind = solvers.DiffSolverVBD
        kept["solver"], kept["path"] = kind(model), diff.Trajectory(model, STEPS)
    solver, path = kept["solver"], kept["path"]
    rate = nova.linear(pushes(block, 6).to(block.device), params["rule"], params["offset"])
    if model.joint_count:
        diff.state_joint_qd_tensor(path[0]).copy_(nova.sum(rate, axis=1))
        solver.rollout(path, None, None, 1 / 120)
        end = diff.state_joint_q_tensor(path[STEPS])
        return end * end
    each = model.particle_count // block.worlds
    every = nova.concat([rate.reshape(block.worlds, 1, 3)] * each, axis=1)
    diff.state_particle_qd_tensor(path[0]).copy_(every.reshape(-1, 3))
    if model.tri_count:
        solver.rollout(path, None, None, 1 / 120)
    else:
        solver.rollout(path, None, None, 1 / 120, pipeline=novaphy.CollisionPipeline(model))
    end = diff.state_particle_q_tensor(path[STEPS]).reshape(block.worlds, 3 * each)
    return nova.sum(end * end, axis=1)


def parameters():
    rule = np.float32(np.random.default_rng(1).normal(0, 0.3, (3, 6)))
    return {"rule": nova.tensor(rule), "offset": nova.tensor(np.float32([0.1, 0.2, -0.3]))}


def trained(scene, group, iterations=3, **options):
    """Losses, and the digest after some steps of Adam."""
    params = parameters()
    optimizer = nova.optim.Adam(params.values(), lr=0.05)
    shard = dist.shard(scene(), worlds=WORLDS, block=BLOCK, group=group, **options)
    losses = []
    for _ in range(iterations):
        loss, grads = dist.value_and_grad(rollout, params, shard)
        dist.step(optimizer, grads)
        losses.append(loss)
    dist.check(params, optimizer, group)
    return losses, dist.digest(params, optimizer)


@pytest.mark.parametrize("blocks", [1, 2, 3, 5, 7, 8, 13])
def test_the_tree_of_blocks_adds_in_one_order(blocks):
    values = np.float32(np.random.default_rng(blocks).normal(0, 1, (blocks, 3)))
    values[0] *= np.float32(1e6)

    def tree(first, count):  # by halves that are powers of two
        if count == 1:
            return values[first]
        half = 1 << ((count - 1).bit_length() - 1)
        return tree(first, half) + tree(first + half, count - half)

    for ranks in range(1, blocks + 1):
        whole = BlockSums(blocks)
        for rank in reversed(range(ranks)):
            sums = BlockSums(blocks)
            own = list(part_of(blocks, rank, ranks))
            for block in own[::-1]:
                sums.put(0, block, values[block])
            if ranks == 1 or blocks == ranks:
                assert len(sums.nodes()) == 1
            for node in sums.nodes():
                whole.put(*node)
        np.testing.assert_array_equal(whole.total(), tree(0, blocks))


@pytest.mark.parametrize("scene", [bouncing, pendulum, cloth])
def test_bits_do_not_depend_on_the_number_of_ranks(scene):
    if scene is cloth and not novaphy.has_vbd():
        pytest.skip("this build has no VBD")
    losses, digest = trained(scene, dist.Group())
    assert losses[-1] < losses[0]
    for size in (2, 3, 4):
        assert on_ranks(size, lambda group: trained(scene, group)) == [(losses, digest)] * size


def test_the_gradient_is_that_of_the_mean_loss():
    params = parameters()
    shard = dist.shard(pendulum(), worlds=WORLDS, block=BLOCK)
    _, grads = dist.value_and_grad(rollout, params, shard)
    direction = np.float32(np.random.default_rng(2).normal(0, 1, (3, 6)))
    ends = []
    for sign in (1.0, -1.0):
        moved = {**params, "rule": nova.tensor(params["rule"].numpy() + sign * 3e-2 * direction)}
        ends.append(dist.value_and_grad(rollout, moved, shard)[0])
    along = np.sum(grads["rule"] * direction)
    np.testing.assert_allclose((ends[0] - ends[1]) / 6e-2, along, rtol=2e-3)


def test_a_run_that_was_saved_goes_on_on_other_ranks_with_its_bits(tmp_path):
    path = tmp_path / "half.npz"
    whole = trained(bouncing, dist.Group(), iterations=4)[1]

    def first(group):
        params = parameters()
        optimizer = nova.optim.Adam(params.values(), lr=0.05)
        shard = dist.shard(bouncing(), worlds=WORLDS, block=BLOCK, group=group)
        for _ in range(2):
            dist.step(optimizer, dist.value_and_grad(rollout, params, shard)[1])
        dist.save(path, params, optimizer, shard, iteration=2, seed=3)

    def second(group):
        params = {name: nova.zeros(p.shape) for name, p in parameters().items()}
        optimizer = nova.optim.Adam(params.values(), lr=0.05)
        shard = dist.shard(bouncing(), worlds=WORLDS, block=BLOCK, group=group)
        numbers = dist.load(path, params, optimizer, shard)
        assert numbers == {"iteration": 2, "worlds": WORLDS, "block": BLOCK, "seed": 3}
        for _ in range(2):
            dist.step(optimizer, dist.value_and_grad(rollout, params, shard)[1])
        return dist.digest(params, optimizer)

    assert on_ranks(2, first) == [None, None]
    assert on_ranks(3, second) == [whole] * 3
    params = parameters()
    optimizer = nova.optim.Adam(params.values(), lr=0.05)
    other = dist.shard(bouncing(), worlds=WORLDS, block=7)
    with pytest.raises(ValueError, match="load: block: expected 7, the file has 4"):
        dist.load(path, params, optimizer, other)
    with pytest.raises(ValueError, match=r"load: param.more: expected the shape \(2,\), got noth"):
        dist.load(path, {**params, "more": nova.zeros(2)}, None, dist.shard(
            bouncing(), worlds=WORLDS, block=BLOCK))  # fmt: skip


def test_all_ranks_get_the_parameters_of_the_first():
    def run(group):
        params = {"rule": nova.tensor(np.float32([group.rank, 5.0]))}
        optimizer = nova.optim.Adam(params.values())
        with pytest.raises(RuntimeError, match=r"check: ranks \[1\] have other parameters"):
            dist.check({"rule": nova.tensor(np.float32([group.rank == 1]))}, None, group)
        dist.sync(params, optimizer, group)
        dist.check(params, optimizer, group)
        return params["rule"].tolist()

    assert on_ranks(3, run) == [[0.0, 5.0]] * 3


def test_a_failure_of_one_rank_ends_all_with_its_number():
    def bad(block, params):
        losses = rollout(block, params)
        scale = np.ones(block.worlds, np.float32)
        scale[1] = np.nan if block.index == 6 else 1.0
        return losses * nova.tensor(scale)

    def run(group):
        shard = dist.shard(bouncing(), worlds=WORLDS, block=BLOCK, group=group)
        return dist.value_and_grad(bad, parameters(), shard)

    first, second = on_ranks(2, run)
    assert isinstance(second, ValueError)
    assert re.search(r"got nan in world 25 \(block 6\), and 0 more", str(second))
    assert isinstance(first, RuntimeError) and "rank 1: ValueError: value_and_grad" in str(first)


def test_sums_of_blocks_copy_and_check_their_rows():
    shard = dist.shard(bouncing(), worlds=10, block=2)
    memory = np.zeros(1, np.float32)

    def same_memory(block):
        memory[0] = block.index + 1
        return memory

    assert dist.sum_blocks(same_memory, shard).tolist() == [15.0]
    with pytest.raises(ValueError, match="rows of one length, got 1 and 3 numbers"):
        dist.sum_blocks(lambda b: np.ones(3 - 2 * (b.index % 2), np.float32), shard)
    for wrong in (None, np.ones(2), np.ones((1, 2), np.float32)):
        with pytest.raises(TypeError, match="expected a row of float32 numbers"):
            dist.sum_blocks(lambda b, wrong=wrong: wrong, shard)


def test_sums_that_overflow_are_refused():
    shard = dist.shard(bouncing(), worlds=4, block=2)
    with pytest.raises(ValueError, match=r"float32 holds, got 3e\+38 \+ 3e\+38 at place 1"):
        dist.sum_blocks(lambda b: np.float32([1.0, 3e38]), shard)
    infinite = dist.sum_blocks(lambda b: np.float32([np.inf]), shard)
    assert infinite.tolist() == [np.inf], "the rows of a caller may be infinite"

    def large(block, params):
        return rollout(block, params) * 0.0 + 3e38

    with pytest.raises(ValueError, match=r"whose sum float32 holds, got up to 3e\+38 in block 0"):
        dist.value_and_grad(large, parameters(), shard)


def test_a_state_that_is_not_finite_is_named_with_world_and_step():
    shard = dist.shard(bouncing(), worlds=4, block=2)
    ruined = parameters()
    ruined["offset"].assign(np.full(3, np.inf, np.float32))
    with pytest.raises(ValueError, match="in world 0 .*; its first kept state .* before step 1"):
        dist.value_and_grad(rollout, ruined, shard)
    shard = dist.shard(pendulum(), worlds=4, block=2)
    named = "world 0 is world 0 of the run: step [0-9]+ of .*of world 0"
    with pytest.raises(novaphy.Error, match=named):
        dist.value_and_grad(rollout, ruined, shard)


def test_bad_input_is_named():
    shard = dist.shard(bouncing(), worlds=4, block=2)
    for arguments, message in (
        ({"worlds": 10, "block": 4}, r"worlds: expected a multiple of block \(4\), got 10"),
        ({"worlds": 0, "block": 4}, "worlds: expected >= 1, got 0"),
        ({"worlds": 4, "block": 4, "devices": []}, "devices: expected at least one, got none"),
        ({"worlds": 4, "block": 4, "device": "cpu", "devices": ["cpu"]}, "expected None beside"),
    ):
        with pytest.raises(ValueError, match=message):
            dist.shard(bouncing(), **arguments)
    with pytest.raises((ValueError, novaphy.Error), match="cuda:77"):
        dist.shard(bouncing(), worlds=4, block=4, device="cuda:77")
    with pytest.raises(ValueError, match="scene: expected a Model of 4 worlds, got 1"):
        dist.shard(lambda first, worlds, device: bouncing().finalize(), worlds=4, block=4)
    with pytest.raises(ValueError, match=r"losses \(2,\), got \(4,\)"):
        dist.value_and_grad(lambda b, p: nova.zeros(4) + p["x"], {"x": nova.zeros(4)}, shard)
    for params in ({}, [nova.zeros(2)], {"x": np.zeros(2)}):
        with pytest.raises(TypeError, match="params"):
            dist.value_and_grad(rollout, params, shard)
    optimizer = nova.optim.SGD([nova.zeros(2)], lr=0.1)
    with pytest.raises(ValueError, match=r"grads\['x'\]: expected the shape \(2,\), got \(3,\)"):
        dist.step(optimizer, {"x": np.zeros(3, np.float32)})
    with pytest.raises(ValueError, match='kind: expected "torch", "mpi" or "alone", got .other'):
        dist.init("other")
    with pytest.raises(ValueError, match='kind: expected "processes", "ray" or "mpi"'):
        dist.Pool("other", workers=1)


def test_ranks_that_do_not_agree_are_named():
    def models(group):
        return dist.shard(
            cloth() if group.rank == 2 else bouncing(), worlds=8, block=2, group=group
        )

    for error in on_ranks(3, models):
        assert isinstance(error, RuntimeError) and "ranks [2] have another model" in str(error)
    calls = on_ranks(2, lambda g: g.barrier() if g.rank == 0 else g.broadcast(b"x"))
    assert "rank 0 calls barrier, rank 1 calls broadcast" in str(calls[0])
    few = on_ranks(3, lambda g: dist.shard(bouncing(), worlds=4, block=2, group=g))
    assert "3 ranks need at least 3 blocks, got 2: expected at most 1" in str(few[0])


def blocks_of_balls(first_world, worlds, device):
    builder = novaphy.ModelBuilder()
    builder.replicate(bouncing(), worlds)
    return builder.finalize(device, requires_grad=True)


def test_a_pool_of_processes_has_the_bits_of_one():
    params = parameters()
    want = dist.value_and_grad(
        rollout, params, dist.shard(blocks_of_balls, worlds=WORLDS, block=BLOCK)
    )
    with dist.Pool("processes", workers=2, devices="cpu") as pool:
        for _ in range(2):
            loss, grads = pool.value_and_grad(
                rollout, params, blocks_of_balls, worlds=WORLDS, block=BLOCK
            )
            assert loss == want[0]
            for name, value in want[1].items():
                np.testing.assert_array_equal(grads[name], value)
        with pytest.raises(TypeError, match="scene: expected a function"):
            pool.value_and_grad(rollout, params, bouncing(), worlds=WORLDS, block=BLOCK)


@contextlib.contextmanager
def one_by_one(command):
    """Every torchrun --standalone of torch 1.13 opens the same port: another one has to wait."""
    with open(Path(tempfile.gettempdir()) / "novaphy_distributed.lock", "w") as lock:
        if "--standalone" in command:
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def done_of(*command, timeout=120):
    """The result of a command of some processes, which find the modules of this folder."""
    path = os.pathsep.join([os.environ.get("PYTHONPATH", ""), str(Path(__file__).parent)])
    environ = os.environ | {"NOVAPHY_NUM_THREADS": "1", "PYTHONPATH": path.strip(os.pathsep)}
    return subprocess.run(
        [str(word) for word in command], env=environ, capture_output=True, text=True,
        timeout=timeout, check=False,
    )  # fmt: skip


def output_of(*command):
    """What a command prints."""
    with one_by_one(command):
        done = done_of(*command)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def need(library, program=None):
    if importlib.util.find_spec(library) is None:
        pytest.skip(f"{library} is not installed")
    if program is not None and shutil.which(program, path=path_of_programs()) is None:
        pytest.skip(f"{program} is not installed")


def path_of_programs():
    return os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])


def mpiexec():
    return shutil.which("mpiexec", path=path_of_programs())


SMALL = ("--worlds", "96", "--block", "16", "--iterations", "5")
# Debian's torch 1.13 cannot read its own default of both options under Python 3.11.
TORCHRUN = (
    sys.executable, "-m", "torch.distributed.run", "--standalone", "--tee=1:2", "--redirects=1:2"
)  # fmt: skip


@pytest.fixture(scope="module")
def alone():
    return output_of(sys.executable, DEMO, *SMALL).splitlines()[-1]


def command_of(line):
    """The words that run a command line of the guide here."""
    program, *words = line.split()
    words = [str(DEMO) if word == DEMO.name else word for word in words]
    words = [sys.executable if word == "python" else word for word in words]
    if program == "torchrun":
        return (*TORCHRUN, *(word for word in words if word != "--standalone"))
    return (mpiexec() if program == "mpiexec" else sys.executable, *words)


GUIDE = (Path(__file__).parents[2] / "docs" / "guide" / "distributed.md").read_text()
LINES = re.findall(r"^\w+ .*demo_distributed.py.*$", GUIDE, re.MULTILINE)
LIBRARY = {"torchrun": "torch", "mpiexec": "mpi4py", "python": "ray"}


def test_the_guide_shows_every_launcher():
    assert [line.split()[0] for line in LINES] == ["python", "torchrun", "mpiexec", "python"]


@pytest.mark.parametrize("ranks", [2, 3])
@pytest.mark.parametrize("line", LINES[1:])
def test_the_demo_has_one_digest_by_every_launcher(line, ranks, alone):
    program = line.split()[0]
    need(LIBRARY[program], "mpiexec" if program == "mpiexec" else None)
    assert re.fullmatch("[0-9a-f]{64}", alone)
    command = command_of(line.replace("2", str(ranks)))
    assert output_of(*command, *SMALL).splitlines()[-1] == alone


def test_a_pool_of_ray_has_the_bits_of_one():
    need("ray")
    script = """
import numpy as np
import test_distributed as t
from novaphy import distributed as dist
want = dist.value_and_grad(
    t.rollout, t.parameters(), dist.shard(t.blocks_of_balls, worlds=t.WORLDS, block=t.BLOCK)
)
with dist.Pool("ray", workers=2, devices="cpu") as pool:
    got = pool.value_and_grad(
        t.rollout, t.parameters(), t.blocks_of_balls, worlds=t.WORLDS, block=t.BLOCK
    )
assert got[0] == want[0] and all(np.array_equal(got[1][k], want[1][k]) for k in want[1])
print("equal")
"""
    assert output_of(sys.executable, "-c", script).split()[-1] == "equal"


def test_the_demo_resumes_on_other_ranks(alone, tmp_path):
    need("torch")
    path, picture = tmp_path / "half.npz", tmp_path / "throw.png"
    half = [*SMALL[:-1], "2", "--save", path]
    output_of(*TORCHRUN, "--nproc_per_node=2", DEMO, *half)
    resumed = (sys.executable, DEMO, *SMALL, "--resume", path, "--plot", picture)
    assert output_of(*resumed).splitlines()[-1] == alone
    assert picture.stat().st_size > 10_000


KILLED = """
import os, signal, sys
from novaphy import distributed as dist
group = dist.init(timeout=20)
group.barrier()
if group.rank == 1:
    os.kill(os.getpid(), signal.SIGKILL)
try:
    group.barrier()
except RuntimeError as error:
    print(f"rank {group.rank} ends: {error}", flush=True)
    raise SystemExit(3)
"""


@pytest.mark.parametrize("transport", ["torch", "mpi"])
def test_a_rank_that_is_killed_ends_the_others(transport, tmp_path):
    need({"torch": "torch", "mpi": "mpi4py"}[transport], "mpiexec" if transport == "mpi" else None)
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    command = {
        "torch": (*TORCHRUN, "--nproc_per_node=2", script),
        "mpi": (mpiexec(), "-n", "2", sys.executable, script),
    }[transport]
    with one_by_one(command):
        begin = time.monotonic()
        done = done_of(*command, timeout=60)
    text = done.stderr + done.stdout
    assert done.returncode != 0 and time.monotonic() - begin < 30, text
    named = {"torch": r"rank 0 ends: .*for rank 1 \(process", "mpi": "KILLED BY SIGNAL: 9|PID"}
    assert re.search(named[transport], text, re.DOTALL), text
