"""Learn to throw in wind, over many worlds, on any number of processes with the same bits.

In each world a ball should land on a mark. The distance and direction of the mark and the wind are
random. A rule with 36 parameters computes the initial velocity from these values. The parameters
are optimized by the gradient of the mean squared miss over all worlds. The last line of the output
is the hash of the rule and the optimizer. The hash is the same for one process, torchrun, Ray and
mpiexec.

    python demo_distributed.py
    torchrun --standalone --nproc-per-node=2 demo_distributed.py
    mpiexec -n 2 python demo_distributed.py
    python demo_distributed.py --ray 2
    python demo_distributed.py --iterations 40 --save rule.npz
    torchrun --standalone --nproc-per-node=2 demo_distributed.py --resume rule.npz
"""

from __future__ import annotations

import argparse

import numpy as np
from demo_common import loss_figure, progress, run, save_figure

import novaphy
from novaphy import diff, nova
from novaphy import distributed as dist

STEPS, DT = 60, 1.0 / 60.0  # steps and step size (s): the ball flies for a second
FAR, WIND = 3.0, 4.0  # largest distance of a mark (m), largest acceleration by wind (m/s²)
LEARNING_RATE = 0.1
FEATURES = 12


def scene() -> novaphy.ModelBuilder:
    """Build one world: a ball of 1 kg."""
    builder = novaphy.ModelBuilder()
    builder.add_particle(pos=(0.0, 0.0, 0.0), vel=(0.0, 0.0, 0.0), mass=1.0)
    return builder


def worlds_of(block: dist.Block, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return features {worlds, FEATURES}, marks {worlds, 3} (m) and winds {worlds, 3} (m/s^2)."""
    draws = nova.random_uniform((block.worlds, 4), seed=seed, first_world=block.first_world)
    u = 2.0 * draws.numpy() - 1.0
    mark, wind = np.zeros((2, block.worlds, 3), np.float32)
    mark[:, :2], wind[:, :2] = FAR * u[:, :2], WIND * u[:, 2:]
    one = np.ones((block.worlds, 1), np.float32)
    products = [u[:, [i]] * u[:, [j]] for i, j in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))]
    features = np.concatenate([one, u, u[:, :1] ** 2, *products], axis=1)
    return np.float32(features), mark, wind


class Throw:
    """The solver, the trajectory and the drawn values of a block, which all iterations use."""

    def __init__(self, block: dist.Block) -> None:
        """Draw the worlds."""
        self.solver = novaphy.solvers.DiffSemiImplicitSolver(block.model)
        self.trajectory = diff.Trajectory(block.model, STEPS)


def rollout(block: dist.Block, params: dict[str, nova.Tensor], seed: int) -> nova.Tensor:
    """Return the squared distances {worlds} (m²) of the landings of a block from their marks."""
    if not block.kept:
        block.kept["throw"] = Throw(block)
    throw: Throw = block.kept["throw"]
    features, mark, wind = (nova.tensor(x, device=block.device) for x in worlds_of(block, seed))
    start = diff.state_particle_qd_tensor(throw.trajectory[0])
    start.copy_(nova.linear(features, params["rule"]))
    throw.solver.rollout(throw.trajectory, None, None, DT, forces=wind)
    miss = diff.state_particle_q_tensor(throw.trajectory[STEPS]) - mark
    return nova.sum(miss * miss, axis=1)


def train(args: argparse.Namespace) -> str:
    """Train on the ranks of this run. Return the digest."""
    group = dist.init()
    params = {"rule": nova.tensor(np.zeros((3, FEATURES), np.float32))}
    optimizer = nova.optim.Adam(params.values(), lr=LEARNING_RATE)
    shard = dist.shard(scene(), worlds=args.worlds, block=args.block, device=args.device)
    first = 0
    if args.resume:
        first = dist.load(args.resume, params, optimizer, shard)["iteration"]
    dist.sync(params, optimizer)
    losses = []
    rounds = range(first, args.iterations)
    for k in progress(rounds) if group.rank == 0 else rounds:
        loss, grads = dist.value_and_grad(lambda b, p: rollout(b, p, args.seed), params, shard)
        dist.step(optimizer, grads)
        losses.append(loss)
        if k % 100 == 99:
            dist.check(params, optimizer)
    dist.check(params, optimizer)
    if args.save:
        dist.save(args.save, params, optimizer, shard, iteration=args.iterations, seed=args.seed)
    digest = dist.digest(params, optimizer)
    if group.rank == 0 and args.plot:
        plot(args.plot, losses, params, args)
    if group.rank == 0 and losses:
        miss = [float(np.sqrt(x)) for x in (losses[0], losses[-1])]
        print(f"{args.worlds} worlds on {group.size} ranks: miss {miss[0]:.3f} -> {miss[1]:.3f} m")
    group.close()
    return digest


def plot(path: str, losses: list[float], params: dict[str, nova.Tensor], args) -> None:
    """Draw the loss, and the marks and landings of the first worlds."""
    one = dist.shard(scene(), worlds=args.block, block=args.block, group=dist.Group()).blocks[0]
    rollout(one, {k: nova.tensor(p.numpy()) for k, p in params.items()}, args.seed)
    landed = one.kept["throw"].trajectory.particle_q.numpy()[-1]
    mark = worlds_of(one, args.seed)[1]
    figure, right = loss_figure(losses, "mean squared miss [m^2]", (4.4, 4.4))
    count = min(len(mark), 100)
    for a, b in zip(mark[:count], landed[:count], strict=True):
        right.plot([a[0], b[0]], [a[1], b[1]], color="#adb5bd", linewidth=0.8)
    right.plot(*mark[:count, :2].T, "o", color="#2a6f97", markersize=4, label="mark")
    right.plot(*landed[:count, :2].T, "x", color="#f48c06", markersize=4, label="landing")
    right.set(xlabel="x [m]", ylabel="y [m]")
    right.set_aspect("equal")
    right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    save_figure(figure, path)


def main() -> int:
    """Parse the flags, train, and print the digest. Return 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=16_384, help="of all ranks")
    parser.add_argument("--block", type=int, default=1_024, help="worlds that are summed in a row")
    parser.add_argument("--iterations", type=int, default=100, help="the last one")
    parser.add_argument("--device", default="cpu", help="of this rank's blocks")
    parser.add_argument("--seed", type=int, default=7, help="of the worlds")
    parser.add_argument("--ray", type=int, metavar="RANKS", help="run on so many actors of Ray")
    parser.add_argument("--save", metavar="PATH.npz", help="write a checkpoint at the end")
    parser.add_argument("--resume", metavar="PATH.npz", help="go on from a checkpoint")
    parser.add_argument("--plot", metavar="PATH.png", help="draw the loss and the landings")
    args = parser.parse_args()
    digest = dist.spawn(train, args, ranks=args.ray)[0] if args.ray else train(args)
    if dist.current().rank == 0:
        print(digest)
    return 0


if __name__ == "__main__":
    run(main)
