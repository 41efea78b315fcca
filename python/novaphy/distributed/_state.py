"""The state of a training, parameters and optimizer: hashes, copies to all ranks, checkpoints."""

from __future__ import annotations

import hashlib
import os
import pickle
from typing import Any

from .. import nova
from ._gradients import Params, checked_params
from ._groups import Group, current
from ._shard import Shard

Optimizer = nova.optim.SGD | nova.optim.Adam


def _tensors(params: Params, optimizer: Optimizer | None) -> dict[str, nova.Tensor]:
    """Return all tensors of the parameters and of the state of the optimizer, by name."""
    found = {f"param.{name}": p for name, p in params.items()}
    for part in ("m", "v", "b"):
        for k, tensor in enumerate(getattr(optimizer, part, None) or ()):
            found[f"{part}.{k}"] = tensor
    if (t := getattr(optimizer, "t", None)) is not None:
        found["t"] = t
    return found


def digest(params: Params, optimizer: Optimizer | None = None) -> str:
    """Return the SHA-256 (hex) of the bits of all parameters and of an optimizer's state."""
    found = hashlib.sha256()
    for name, tensor in _tensors(checked_params(params, "digest"), optimizer).items():
        found.update(f"{name} {tensor.shape}".encode() + tensor.numpy().tobytes())
    return found.hexdigest()


def check(params: Params, optimizer: Optimizer | None = None, group: Group | None = None) -> None:
    """Check that all ranks have the same bits in the parameters and the optimizer.

    RuntimeError: the digests differ; the message names the ranks that differ from the majority.
    """
    group = current() if group is None else group
    hashes = group.all_gather(digest(params, optimizer).encode(), "check")
    most = max(hashes, key=hashes.count)
    if others := [rank for rank, h in enumerate(hashes) if h != most]:
        raise RuntimeError(f"check: ranks {others} have other parameters or optimizers")


def sync(params: Params, optimizer: Optimizer | None = None, group: Group | None = None) -> None:
    """Copy the parameters and the optimizer's state of rank 0 to all ranks."""
    group = current() if group is None else group
    tensors = _tensors(checked_params(params, "sync"), optimizer)
    own = {name: t.numpy() for name, t in tensors.items()} if group.rank == 0 else {}
    _assign(tensors, pickle.loads(group.broadcast(pickle.dumps(own), 0, "sync")), "sync")


def _assign(tensors: dict[str, nova.Tensor], values: dict[str, Any], call: str) -> None:
    for name, tensor in tensors.items():
        got = values[name].shape if name in values else "nothing"
        if got != tensor.shape:
            raise ValueError(f"{call}: {name}: expected the shape {tensor.shape}, got {got}")
    for name, tensor in tensors.items():
        tensor.assign(values[name])


def save(
    path: str | os.PathLike[str],
    params: Params,
    optimizer: Optimizer | None,
    shard: Shard,
    *,
    iteration: int,
    **numbers: int,
) -> None:
    """Write a checkpoint on rank 0: parameters, optimizer, iteration, worlds, block and `numbers`.

    path: a name that ends in .npz. The file is written atomically.
    numbers: additional integers by name, such as seed=7.
    """
    if shard.group.rank == 0:
        meta = {"iteration": iteration, "worlds": shard.worlds, "block": shard.block} | numbers
        nova.save_parameters(path, _tensors(checked_params(params, "save"), optimizer), meta)
    shard.group.barrier()


def load(
    path: str | os.PathLike[str], params: Params, optimizer: Optimizer | None, shard: Shard
) -> dict[str, int]:
    """Read a checkpoint of `save` into the parameters and the optimizer, on every rank.

    Returns iteration, worlds, block and the numbers of `save`. The number of ranks may differ from
    the run that wrote the checkpoint.

    ValueError: the names or shapes of parameters do not fit. ValueError: `worlds` or `block` of the
    shard differs from the checkpoint, because the bits would differ.
    """
    values, numbers = nova.load_parameters(path)
    for name in ("worlds", "block"):
        if numbers.get(name) != getattr(shard, name):
            raise ValueError(
                f"load: {name}: expected {getattr(shard, name)}, the file has {numbers.get(name)}"
            )
    _assign(_tensors(checked_params(params, "load"), optimizer), values, "load")
    return numbers
