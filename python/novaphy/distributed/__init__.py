"""Gradients over many worlds on many processes. The bits do not depend on the number of processes.

The worlds of a run are divided into blocks, and the blocks among processes (ranks). Sums are
exchanged by torch.distributed, Ray or MPI:

    from novaphy import distributed as dist
    group = dist.init()                                     # torchrun, mpiexec, or alone
    shard = dist.shard(scene, worlds=65_536, block=4_096)   # this rank's blocks
    loss, grads = dist.value_and_grad(rollout, params, shard)
    dist.step(optimizer, grads)
    dist.check(params, optimizer)

torch, Ray or MPI is imported when a group needs it.
"""

from .._require import require_diff

require_diff("novaphy.distributed")

from ._gradients import step, sum_blocks, value_and_grad  # noqa: E402
from ._groups import Group, current, init  # noqa: E402
from ._pool import Pool  # noqa: E402
from ._ray import spawn  # noqa: E402
from ._shard import Block, Shard, shard  # noqa: E402
from ._state import check, digest, load, save, sync  # noqa: E402

__all__ = [
    "Block",
    "Group",
    "Pool",
    "Shard",
    "check",
    "current",
    "digest",
    "init",
    "load",
    "save",
    "shard",
    "spawn",
    "step",
    "sum_blocks",
    "sync",
    "value_and_grad",
]
