"""RayGroup and spawn: groups whose ranks are actors of Ray."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from typing import Any

from ._groups import Group, needed, use


class _Board:
    """The actor that exchanges messages: all ranks write to it and read from it."""

    def __init__(self, size: int, timeout: float) -> None:
        self._size, self._timeout = size, timeout
        self._rounds: dict[int, dict[int, bytes]] = {}
        self._changed = asyncio.Condition()

    async def gather(self, number: int, rank: int, message: bytes, call: str) -> list[bytes]:
        async with self._changed:
            messages = self._rounds.setdefault(number, {})
            messages[rank] = message
            self._rounds.pop(number - 2, None)  # all ranks have read that round
            self._changed.notify_all()
            try:
                await asyncio.wait_for(
                    self._changed.wait_for(lambda: len(messages) == self._size), self._timeout
                )
            except TimeoutError:
                late = sorted(set(range(self._size)) - set(messages))
                raise RuntimeError(
                    f"distributed: {call}: ranks {late} did not come within {self._timeout:g} s"
                ) from None
            return [messages[k] for k in range(self._size)]


class RayGroup(Group):
    """A group of the actors that spawn started."""

    kind = "ray"

    def __init__(self, board: Any, rank: int, size: int) -> None:
        self._ray = needed("ray", '"ray"', "ray")
        self._board, self.rank, self.size, self._number = board, rank, size, 0

    def _gather(self, message: bytes, call: str) -> list[bytes]:
        self._number += 1
        waiting = self._board.gather.remote(self._number, self.rank, message, call)
        return list(self._ray.get(waiting))


class _Rank:
    """The actor of a rank."""

    def __init__(self, board: Any, rank: int, size: int) -> None:
        self._group = RayGroup(board, rank, size)

    def run(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        use(self._group)
        return function(*arguments)


def started(ray: Any, workers: int) -> None:
    """Connect to a Ray cluster, or start one on this machine with a CPU slot for each worker."""
    if ray.is_initialized():
        return
    if "RAY_ADDRESS" in os.environ:
        ray.init(log_to_driver=False)
    else:
        places = max(workers, os.cpu_count() or 1)
        ray.init(num_cpus=places, log_to_driver=False, include_dashboard=False)


def spawn(
    function: Callable[..., Any], *arguments: Any, ranks: int, timeout: float = 300.0, **actor: Any
) -> list[Any]:
    """Run a function on several actors of Ray as one group; return the results by rank.

    function, arguments: every rank calls function(*arguments). In the function, init() returns the
    group of the actors.
    ranks: the number of actors.
    timeout: how long a rank waits for the other ranks in one call (s).
    actor: options of each actor, such as num_cpus=4 or num_gpus=1 (default: num_cpus=1).

    ImportError: Ray is missing. RuntimeError: a rank failed; the message names it.
    """
    ray = needed("ray", '"ray"', "ray")
    if ranks < 1:
        raise ValueError(f"spawn: ranks: expected >= 1, got {ranks}")
    started(ray, ranks)
    board = ray.remote(num_cpus=0)(_Board).remote(ranks, timeout)
    kind = ray.remote(**({"num_cpus": 1} | actor))(_Rank)
    actors = [kind.remote(board, rank, ranks) for rank in range(ranks)]
    rank_of = {a.run.remote(function, arguments): k for k, a in enumerate(actors)}
    results: dict[int, Any] = {}
    try:
        waiting = list(rank_of)
        while waiting:
            (done,), waiting = ray.wait(waiting)
            try:
                results[rank_of[done]] = ray.get(done)
            except Exception as error:
                raise RuntimeError(f"distributed: rank {rank_of[done]}: {error}") from error
    finally:
        for a in (*actors, board):
            ray.kill(a)
    return [results[rank] for rank in range(ranks)]
