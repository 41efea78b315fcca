"""Losses and gradients summed over the blocks of all ranks, and optimizer steps with them."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from .. import Error, nova
from ..diff import Trajectory
from ._shard import Block, Shard
from ._tree import BlockSums, Node, Vector

Params = Mapping[str, nova.Tensor]
Gradients = dict[str, NDArray[np.float32]]
Rollout = Callable[[Block, dict[str, nova.Tensor]], nova.Tensor]


def checked_params(params: Params, call: str) -> Params:
    """Return params unchanged. TypeError: params is not a dict of float32 Tensors."""
    if not isinstance(params, Mapping) or not params:
        raise TypeError(f"{call}: params: expected a dict of Tensors, got {params!r}")
    for name, value in params.items():
        if not isinstance(value, nova.Tensor) or value.dtype != nova.float32:
            raise TypeError(f"{call}: params[{name!r}]: expected a float32 Tensor, got {value!r}")
    return params


def gradient_of_block(rollout: Rollout, params: dict[str, Vector], block: Block) -> Vector:
    """Return {1 + n}: the sum of a block's losses, then the sum's gradient by all parameters."""
    leaves = {}
    for name, value in params.items():
        leaves[name] = nova.tensor(value, device=block.device)
        leaves[name].requires_grad = True
    with nova.Tape() as tape:
        try:
            losses = rollout(block, leaves)
        except Error as error:
            raise Error(
                f"value_and_grad: block {block.index}, whose world 0 is world {block.first_world} "
                f"of the run: {error}"
            ) from error
        if not isinstance(losses, nova.Tensor) or losses.shape != (block.worlds,):
            got = losses.shape if isinstance(losses, nova.Tensor) else type(losses).__name__
            raise ValueError(
                f"value_and_grad: rollout: expected a Tensor of the losses ({block.worlds},), "
                f"got {got}"
            )
        total = nova.sum(losses)
        tape.backward(total)
    _check_finite(losses.numpy(), block)
    if not np.isfinite(total.item()):
        raise ValueError(
            "value_and_grad: rollout: expected losses whose sum float32 holds, got up to "
            f"{np.abs(losses.numpy()).max()!s} in block {block.index}"
        )
    rows = [total.numpy().reshape(1)]
    rows += [leaf.grad.numpy().reshape(-1) for leaf in leaves.values() if leaf.grad is not None]
    return np.concatenate(rows)


def _check_finite(losses: NDArray[np.float32], block: Block) -> None:
    wrong = np.flatnonzero(~np.isfinite(losses))
    if len(wrong):
        raise ValueError(
            f"value_and_grad: rollout: expected finite losses, got {losses[wrong[0]]} in world "
            f"{block.first_world + wrong[0]} (block {block.index}), and {len(wrong) - 1} more"
            f"{_first_state(block, int(wrong[0]))}"
        )


def _first_state(block: Block, world: int) -> str:
    """Return a text about the first stored state that is not finite in a world; "": none.

    The states are those of the Trajectory objects in `block.kept`.
    """
    model = block.model
    worlds_of = {
        "particle_q": model.particle_world.numpy(),
        "body_q": model.body_world.numpy(),
        "joint_q": np.repeat(model.joint_world.numpy(), np.diff(model.joint_q_start.numpy())),
    }
    for path in block.kept.values():
        if not isinstance(path, Trajectory):
            continue
        wrong = np.zeros(len(path.kept_steps), bool)
        for name, worlds in worlds_of.items():
            values = getattr(path, name).numpy()[:, worlds == world]
            wrong |= ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
        if wrong.any():
            step = path.kept_steps[int(np.argmax(wrong))]
            return f"; its first kept state that is not finite is that before step {step}"
    return ""


def sums_of(function: Callable[[Block], Vector], shard: Shard) -> list[Node]:
    """Return the sums of the largest subtrees of this rank's blocks. Devices run in parallel."""
    sums = BlockSums(shard.block_count)

    def row_of(block: Block) -> Vector:
        row = np.array(function(block))  # copied, because the function may reuse its memory
        if row.ndim != 1 or row.dtype != np.float32:
            raise TypeError(
                "sum_blocks: function: expected a row of float32 numbers, got the shape "
                f"{row.shape} of {row.dtype}"
            )
        return row

    devices = list(dict.fromkeys(block.device for block in shard.blocks))
    if len(devices) == 1:
        for block in shard.blocks:
            sums.put(0, block.index, row_of(block))
        return sums.nodes()

    def run(device: str) -> list[tuple[int, Vector]]:
        own = [block for block in shard.blocks if block.device == device]
        return [(block.index, row_of(block)) for block in own]

    with ThreadPoolExecutor(len(devices)) as threads:
        for found in threads.map(run, devices):
            for index, values in found:
                sums.put(0, index, values)
    return sums.nodes()


def sum_blocks(function: Callable[[Block], Vector], shard: Shard) -> Vector:
    """Return the sum {n} of a function over all blocks of all ranks.

    function: maps a Block to float32 {n}, such as the sums of a running mean of observations.
    shard: the blocks of this rank.

    The blocks are added in a fixed binary tree, so the bits of the sum do not depend on the ranks.

    ValueError: the sum of finite numbers is too large for float32. RuntimeError: another rank
    failed; the message names it.
    """
    failure: Exception | None = None
    message = b""
    try:
        message = pickle.dumps(("", sums_of(function, shard)))
    except Exception as error:
        failure = error
        message = pickle.dumps((f"{type(error).__name__}: {error}", []))
    found = [pickle.loads(text) for text in shard.group.all_gather(message, "sum_blocks")]
    if failure is not None:
        raise failure
    for rank, (why, _) in enumerate(found):
        if why:
            raise RuntimeError(f"distributed: rank {rank}: {why}")
    return total_of(shard.block_count, [node for _, nodes in found for node in nodes])


def total_of(blocks: int, nodes: list[Node]) -> Vector:
    """Return the sum over all blocks of worlds.

    nodes: the partial sums of all ranks, each with its level and index in the binary tree of sums.
    """
    sums = BlockSums(blocks)
    for level, index, values in nodes:
        sums.put(level, index, values)
    return sums.total()


def mean_and_gradients(
    total: Vector, worlds: int, shapes: dict[str, tuple[int, ...]]
) -> tuple[float, Gradients]:
    """Return the mean loss and the mean gradients from a vector of sums over the worlds."""
    mean = total / np.float32(worlds)
    gradients, at = {}, 1
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        gradients[name] = mean[at : at + size].reshape(shape)
        at += size
    return float(mean[0]), gradients


def value_and_grad(rollout: Rollout, params: Params, shard: Shard) -> tuple[float, Gradients]:
    """Return the mean loss over all worlds of all ranks, and the gradient of the mean loss.

    All ranks get the same bits.

    rollout: (block, params) -> losses, a Tensor {block.worlds}. Each call runs on its own tape.
    params: a dict of float32 Tensors. A rollout gets copies on the device of its block.
    shard: the blocks of this rank.

    Within a block, worlds are added from the first to the last. Blocks are added in a fixed binary
    tree. Therefore the bits depend on `worlds` and `block` of the shard, and not on the number of
    ranks, devices or threads.

    Returns the loss as a float, and a dict of gradients {...} with the names of `params`.

    ValueError: losses of another shape, a loss that is not finite (the message names its world), a
    sum that is too large for float32. RuntimeError: another rank failed; the message names it.
    """
    values = {name: p.numpy() for name, p in checked_params(params, "value_and_grad").items()}
    total = sum_blocks(lambda block: gradient_of_block(rollout, values, block), shard)
    shapes = {name: value.shape for name, value in values.items()}
    return mean_and_gradients(total, shard.worlds, shapes)


def step(optimizer: nova.optim.SGD | nova.optim.Adam, grads: Gradients) -> None:
    """Take a step of an optimizer with the gradients of value_and_grad.

    grads: a dict whose order is the order of optimizer.params.

    ValueError: the number of gradients or a shape does not fit.
    """
    if len(optimizer.params) != len(grads):
        raise ValueError(
            f"step: grads: expected one for each of the {len(optimizer.params)} parameters of the "
            f"optimizer, got {len(grads)}"
        )
    for param, (name, gradient) in zip(optimizer.params, grads.items(), strict=True):
        if param.shape != gradient.shape:
            raise ValueError(
                f"step: grads[{name!r}]: expected the shape {param.shape}, got {gradient.shape}"
            )
    for param, gradient in zip(optimizer.params, grads.values(), strict=True):
        param.requires_grad = True
        if param.grad is not None:  # parameters with requires_grad have a gradient tensor
            param.grad.assign(gradient)
    optimizer.step()
