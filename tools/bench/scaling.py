#!/usr/bin/env python3
"""Train worlds on many ranks, and print hashes of the results and times as lines of JSON.
    python tools/bench/scaling.py --scene ants --worlds 512 --block 64
    torchrun --standalone --nproc-per-node=4 tools/bench/scaling.py --scene cloth --device cuda
    mpiexec -n 2 python tools/bench/scaling.py --scene boxes
    python tools/bench/scaling.py --scene boxes --ray 2
    python tools/bench/scaling.py --scene boxes --device cpu cuda:0   # by threads of one process

With --device cuda each process of a host has a separate GPU. --reduction times only the sum of
gradients. `idle` is the part of a forward pass for which the mean rank waits for the slowest rank.
A line has the SHA-256 of the losses and gradients, and the SHA-256 of the parameters and the
optimizer. Both depend only on --steps, --worlds, --block and --iterations.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import novaphy
from novaphy import diff, nova, solvers
from novaphy import distributed as dist

FEATURES = 4


def boxes() -> novaphy.ModelBuilder:
    """Build a plane, three boxes and a ball."""
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    for k in range(3):
        body = builder.add_body(xform=((0.02 * k, 0.0, 0.11 + 0.22 * k), (0, 0, 0, 1)))
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    builder.add_shape_sphere(builder.add_body(xform=((0.4, 0, 0.1), (0, 0, 0, 1))), radius=0.1)
    return builder


def cloth() -> novaphy.ModelBuilder:
    """Build a sheet of 64 particles that hangs from one edge."""
    builder = novaphy.ModelBuilder()
    builder.add_cloth_grid(
        pos=(0, 0, 1), rot=(0, 0, 0, 1), vel=(0, 0, 0), dim_x=7, dim_y=7, cell_x=0.05, cell_y=0.05,
        mass=0.01, fix_left=True, tri_ke=500.0, tri_ka=500.0, tri_kd=0.0, edge_ke=0.01,
    )  # fmt: skip
    builder.color()
    return builder


def ants(first_world: int, worlds: int, device: str) -> novaphy.Model:
    """Return a model of Ants that hang in the air just above the ground."""
    from novaphy.envs._ant import ANTS, build_ants

    del first_world
    return build_ants(ANTS["dva"][0], worlds, requires_grad=True, device=device)


@dataclass
class Kind:
    """How a scene is made and run. A linear map of random features gives the initial rates."""

    scene: Callable[[], object]
    steps: int
    dt: float

    def run(self, block: dist.Block, params: dict[str, nova.Tensor]) -> nova.Tensor:
        """Return losses {worlds}: the squared norm of the last positions (of joints, ...)."""
        model, kept = block.model, block.kept
        if not kept:
            kept["path"], kept["solver"] = diff.Trajectory(model, self.steps), solver_of(model)
            kept["pipeline"] = novaphy.CollisionPipeline(model) if model.shape_count else None
        path = kept["path"]
        features = nova.random_normal(
            (block.worlds, FEATURES), seed=5, first_world=block.first_world, device=block.device
        )
        rates = nova.linear(features, params["rule"])
        start, end = ends_of(model, path)
        start.copy_(rates.reshape(start.shape))
        options = {"pipeline": kept["pipeline"]} if kept["pipeline"] else {}
        kept["solver"].rollout(path, None, None, self.dt, **options)
        last = end.reshape(block.worlds, -1)
        return nova.sum(last * last, axis=1)


KINDS = {
    "ants": Kind(lambda: ants, 140, 1e-3),
    "boxes": Kind(boxes, 60, 1e-3),
    "cloth": Kind(cloth, 20, 1 / 120),
}


def solver_of(model: novaphy.Model) -> solvers.DiffSolverBase:
    """Return the differentiable solver for a model."""
    if model.joint_dof_count:
        # Some contacts of thousands of random starts do not converge.
        return solvers.DiffFeatherstoneSolver(
            model, pgs_slop=0.0, pgs_erp=1.0, allow_unconverged=True
        )
    return (
        solvers.DiffSolverVBD(model) if model.tri_count else solvers.DiffSemiImplicitSolver(model)
    )


def ends_of(model: novaphy.Model, path: diff.Trajectory) -> tuple[nova.Tensor, nova.Tensor]:
    """Return the initial rates, and the part of the last state that the loss reads."""
    first, last = path[0], path[path.steps]
    if model.joint_dof_count:
        return diff.state_joint_qd_tensor(first), diff.state_joint_q_tensor(last)
    if model.tri_count:
        return diff.state_particle_qd_tensor(first), diff.state_particle_q_tensor(last)
    return diff.state_body_qd_tensor(first), diff.state_body_q_tensor(last)


def median_of(function, repeats: int) -> float:
    """Return the median time of a function's calls (s)."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def devices_of(args: argparse.Namespace, group: dist.Group) -> list[str]:
    """Return the devices of this rank."""
    if args.device != ["cuda"]:
        return args.device
    return [f"cuda:{int(os.environ.get('LOCAL_RANK', group.rank))}"]


def measure(args: argparse.Namespace, group: dist.Group) -> dict[str, object]:
    """Train some iterations, then time passes that all begin with the same parameters."""
    kind = KINDS[args.scene]
    if args.steps:
        kind = replace(kind, steps=args.steps)
    shard = dist.shard(
        kind.scene(), worlds=args.worlds, block=args.block, devices=devices_of(args, group)
    )  # fmt: skip
    width = ends_of(shard.blocks[0].model, diff.Trajectory(shard.blocks[0].model, 1))[0].size
    rule = np.random.default_rng(1).normal(0, 0.2, (width // args.block, FEATURES))
    params = {"rule": nova.tensor(np.float32(rule))}
    optimizer = nova.optim.Adam(params.values(), lr=0.01)
    results = hashlib.sha256()

    def iteration() -> None:
        loss, grads = dist.value_and_grad(kind.run, params, shard)
        results.update(np.float32(loss).tobytes() + grads["rule"].tobytes())
        dist.step(optimizer, grads)

    for _ in range(args.iterations):
        iteration()
    dist.check(params, optimizer)
    line: dict[str, object] = {
        "scene": args.scene, "ranks": group.size, "by": group.kind,
        "devices": devices_of(args, group), "steps": kind.steps, "worlds": args.worlds,
        "block": args.block, "iterations": args.iterations,
        "gradients": results.hexdigest(), "parameters": dist.digest(params, optimizer),
    }  # fmt: skip
    if args.repeats:
        leaves = {"rule": nova.tensor(params["rule"].numpy())}
        own: list[float] = []

        def forward() -> None:
            begin, ends = time.perf_counter(), []

            def losses(block: dist.Block) -> np.ndarray:
                here = {name: p.to(block.device) for name, p in leaves.items()}
                total = kind.run(block, here).numpy().sum(keepdims=True)
                ends.append(time.perf_counter() - begin)
                return total

            dist.sum_blocks(losses, shard)
            own.append(max(ends))

        line["forward_s"] = median_of(forward, args.repeats)
        ranks = group.all_gather(np.float64(statistics.median(own)).tobytes())
        seconds = np.frombuffer(b"".join(ranks))
        line["idle"] = float(1 - seconds.mean() / seconds.max())

        def iteration_from_here() -> None:
            # Other parameters lead to other contacts, which need more or fewer sweeps.
            iteration()
            params["rule"].copy_(leaves["rule"])

        line["iteration_s"] = median_of(iteration_from_here, args.repeats)
    return line


def reductions(args: argparse.Namespace, group: dist.Group) -> list[dict[str, object]]:
    """Time only the sum over ranks, for 1e3 to 1e7 parameters. Return the lines."""
    lines: list[dict[str, object]] = []
    empty = novaphy.ModelBuilder()
    empty.add_particle((0, 0, 0), (0, 0, 0), 1.0)
    shard = dist.shard(empty, worlds=4 * group.size, block=4)
    for exponent in range(3, 8):
        values = np.ones(10**exponent, np.float32)
        seconds = median_of(lambda v=values: dist.sum_blocks(lambda _: v, shard), args.repeats or 3)
        lines.append({"ranks": group.size, "parameters": 10**exponent, "reduction_s": seconds})
    return lines


def lines_of(args: argparse.Namespace) -> list[dict[str, object]]:
    """Return the lines of one rank."""
    group = dist.init()
    lines = reductions(args, group) if args.reduction else [measure(args, group)]
    group.close()
    return lines if group.rank == 0 else []


def main() -> None:
    """Print the lines on rank 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", choices=sorted(KINDS), default="boxes")
    parser.add_argument("--steps", type=int, help="of a rollout; default: the scene's")
    parser.add_argument("--worlds", type=int, default=256, help="of all ranks")
    parser.add_argument("--block", type=int, default=32)
    parser.add_argument("--iterations", type=int, default=10, help="before the hashes")
    parser.add_argument("--repeats", type=int, default=5, help="timed iterations; 0: none")
    parser.add_argument("--device", nargs="+", default=["cpu"])
    parser.add_argument("--reduction", action="store_true", help="time the sum of gradients alone")
    parser.add_argument("--ray", type=int, metavar="RANKS", help="run on so many actors of Ray")
    args = parser.parse_args()
    for line in dist.spawn(lines_of, args, ranks=args.ray)[0] if args.ray else lines_of(args):
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
