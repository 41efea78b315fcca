"""Block and Shard: blocks of worlds, and the blocks that one rank simulates."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .. import _core
from ._groups import Group, current

Scene = _core.ModelBuilder | Callable[[int, int, str], _core.Model]


@dataclass(frozen=True)
class Block:
    """A unit of work: consecutive worlds, which one rank simulates on one device.

    index: the number of the block in the run.
    first_world: the number of the block's first world in the run, for the argument first_world of
    nova.random_normal.
    worlds: the number of worlds in the block.
    model: the Model of these worlds. If the scene is a ModelBuilder, all blocks on a device share
    one Model.
    kept: a dict in which a rollout can keep solvers and trajectories between calls. Blocks that
    share a model share the dict.
    """

    index: int
    first_world: int
    worlds: int
    model: _core.Model
    kept: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def device(self) -> str:
        """The device of the model."""
        return str(self.model.device)


@dataclass(frozen=True)
class Shard:
    """The blocks of this rank in a run of `worlds` worlds, with `block` worlds in each block."""

    worlds: int
    block: int
    blocks: tuple[Block, ...]
    group: Group = field(repr=False)

    @property
    def block_count(self) -> int:
        """The number of blocks of all ranks together."""
        return self.worlds // self.block


def counted(worlds: int, block: int, ranks: int, call: str) -> int:
    """Return the number of blocks. Errors name the arguments of `call`."""
    for name, value in (("worlds", worlds), ("block", block)):
        if value < 1:
            raise ValueError(f"{call}: {name}: expected >= 1, got {value}")
    if worlds % block != 0:
        raise ValueError(
            f"{call}: worlds: expected a multiple of block ({block}), got {worlds}, which leaves "
            f"{worlds % block}"
        )
    if ranks > worlds // block:
        raise ValueError(
            f"{call}: block: {ranks} ranks need at least {ranks} blocks, got {worlds // block}: "
            f"expected at most {worlds // ranks}"
        )
    return worlds // block


def part_of(blocks: int, rank: int, ranks: int) -> range:
    """Return the range of blocks of a rank. The first blocks % ranks ranks get one block more."""
    each, more = divmod(blocks, ranks)
    first = rank * each + min(rank, more)
    return range(first, first + each + (rank < more))


def shard(
    scene: Scene,
    *,
    worlds: int,
    block: int,
    device: str | None = None,
    devices: Sequence[str] | None = None,
    group: Group | None = None,
) -> Shard:
    """Make the models of the worlds that this process simulates.

    All worlds of a run are divided into blocks of equal size. Each rank (process) gets consecutive
    blocks.

    scene: a ModelBuilder of one world, which is copied for every world, so that all blocks on a
    device share one Model. For worlds that differ: a function (first_world, worlds, device) ->
    Model, which makes the Model of each block.
    worlds: the number of worlds of the whole run; a multiple of block.
    block: the number of worlds in a block. The bits of sums depend only on worlds and block.
    device, devices: the device, or the devices, of this rank's models. Block k of the rank is on
    devices[k % len(devices)].
    group: the processes of the run. None: the current group, see init.

    ValueError: block does not divide worlds, there are more ranks than blocks, or a device is
    unknown. RuntimeError: the ranks have different models; the message names the ranks.
    """
    group = current() if group is None else group
    count = counted(worlds, block, group.size, "shard")
    if device is not None and devices is not None:
        raise ValueError("shard: device: expected None beside devices")
    places = list(devices) if devices is not None else [device or "cpu"]
    if not places:
        raise ValueError("shard: devices: expected at least one, got none")
    made: dict[str, tuple[_core.Model, dict[str, Any]]] = {}

    def model_of(index: int, place: str) -> tuple[_core.Model, dict[str, Any]]:
        if not isinstance(scene, _core.ModelBuilder):
            model = scene(index * block, block, place)
            if not isinstance(model, _core.Model) or model.world_count != block:
                got = getattr(model, "world_count", type(model).__name__)
                raise ValueError(f"shard: scene: expected a Model of {block} worlds, got {got}")
            return model, {}
        if place not in made:
            every = _core.ModelBuilder()
            every.replicate(scene, block)
            made[place] = every.finalize(place, requires_grad=True), {}
        return made[place]

    own = part_of(count, group.rank, group.size)
    blocks = []
    for k, index in enumerate(own):
        model, kept = model_of(index, places[k % len(places)])
        blocks.append(Block(index, index * block, block, model, kept))
    _compare(group, blocks[0].model, alike=isinstance(scene, _core.ModelBuilder))
    return Shard(worlds, block, tuple(blocks), group)


def _compare(group: Group, model: _core.Model, *, alike: bool) -> None:
    """Check that the models of all ranks have arrays of the same names, types and shapes.

    alike: also compare the values of the arrays.
    """
    if group.size == 1:
        return
    kept: Any = model.__getstate__()
    found = hashlib.sha256()
    for name, values in sorted(kept["arrays"].items()):
        array = np.asarray(values)
        found.update(f"{name} {array.dtype} {array.shape}".encode())
        if alike:
            found.update(array.tobytes())
    hashes = group.all_gather(found.digest(), "shard")
    if others := [rank for rank, h in enumerate(hashes) if h != hashes[0]]:
        raise RuntimeError(f"shard: scene: ranks {others} have another model than rank 0")
