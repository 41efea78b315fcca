"""Pool: workers that compute blocks of worlds for a single driving process."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from types import TracebackType
from typing import Any

from .. import _core
from ._gradients import (
    Gradients,
    Params,
    Rollout,
    checked_params,
    gradient_of_block,
    mean_and_gradients,
    sums_of,
    total_of,
)
from ._groups import Group, needed
from ._ray import started
from ._shard import Block, Shard, counted, part_of
from ._tree import Node, Vector

_shards: dict[tuple[Any, ...], Shard] = {}  # the last shard of a worker, reused by later calls


def _work(
    rollout: Rollout,
    params: dict[str, Vector],
    scene: Callable[[int, int, str], _core.Model],
    plan: tuple[int, int, int, int, str],
) -> list[Node]:
    """Return the sums of blocks `first` to `last` - 1, in a worker.

    plan: worlds of the run, worlds of a block, first block, last block + 1, device.
    """
    worlds, block, first, last, device = plan
    key = (pickle.dumps(scene), *plan)
    if key not in _shards:
        _shards.clear()
        blocks = tuple(
            Block(k, k * block, block, scene(k * block, block, device)) for k in range(first, last)
        )
        _shards[key] = Shard(worlds, block, blocks, Group())
    return sums_of(lambda b: gradient_of_block(rollout, params, b), _shards[key])


class _RayExecutor:
    """Ray actors behind the part of concurrent.futures.Executor that Pool uses."""

    class _Future:
        def __init__(self, ray: Any, reference: Any) -> None:
            self._ray, self._reference = ray, reference

        def result(self) -> Any:
            return self._ray.get(self._reference)

    class _Worker:
        def work(self, function: Callable[..., Any], *arguments: Any) -> Any:
            return function(*arguments)

    def __init__(self, workers: int, **options: Any) -> None:
        self._ray = needed("ray", '"ray"', "ray")
        started(self._ray, workers)
        kind = self._ray.remote(**({"num_cpus": 1} | options))(self._Worker)
        self._workers = [kind.remote() for _ in range(workers)]
        self._next = 0

    def submit(self, function: Callable[..., Any], *arguments: Any) -> _Future:
        worker = self._workers[self._next % len(self._workers)]
        self._next += 1
        return self._Future(self._ray, worker.work.remote(function, *arguments))

    def shutdown(self) -> None:
        for worker in self._workers:
            self._ray.kill(worker)


class Pool:
    """Workers that compute blocks of worlds for one process.

    kind: "processes" (of this machine), "ray" (actors), or "mpi" (the program is started by mpiexec
    -n N python -m mpi4py.futures FILE).
    workers: the number of workers.
    devices: worker k uses devices[k % len(devices)]. "auto": all CUDA devices of this process, or
    "cpu" if there are none.
    options: arguments of the executor (ProcessPoolExecutor, MPIPoolExecutor, or Ray actors).

    The end of a with statement ends the workers.

    ImportError: the library is missing. ValueError: an unknown kind, or workers below 1.
    """

    def __init__(
        self, kind: str, *, workers: int, devices: Sequence[str] | str = "auto", **options: Any
    ) -> None:
        if workers < 1:
            raise ValueError(f"Pool: workers: expected >= 1, got {workers}")
        self._workers = workers
        if devices == "auto":
            found = [str(d) for d in _core.get_devices() if str(d).startswith("cuda")]
            devices = found or ["cpu"]
        self._devices = [devices] if isinstance(devices, str) else list(devices)
        self._executor: Any
        if kind == "processes":
            self._executor = ProcessPoolExecutor(workers, get_context("spawn"), **options)
        elif kind == "ray":
            self._executor = _RayExecutor(workers, **options)
        elif kind == "mpi":
            futures = needed("mpi4py.futures", '"mpi"', "mpi")
            self._executor = futures.MPIPoolExecutor(workers, **options)
        else:
            raise ValueError(f'Pool: kind: expected "processes", "ray" or "mpi", got {kind!r}')

    def value_and_grad(
        self,
        rollout: Rollout,
        params: Params,
        scene: Callable[[int, int, str], _core.Model],
        *,
        worlds: int,
        block: int,
    ) -> tuple[float, Gradients]:
        """Return the mean loss and its gradient, with the same bits as distributed.value_and_grad.

        rollout, scene: functions at module level, which workers import. `scene` has the arguments
        (first_world, worlds, device) and returns a Model.
        params: a dict of float32 Tensors.
        worlds, block: the number of worlds of the run, and of a block.

        TypeError: `scene` is a ModelBuilder, or `params` is no dict of float32 Tensors.
        """
        if isinstance(scene, _core.ModelBuilder):
            raise TypeError("Pool: scene: expected a function, as builders do not travel")
        blocks = counted(worlds, block, self._workers, "Pool.value_and_grad")
        values = {name: p.numpy() for name, p in checked_params(params, "Pool").items()}
        waiting = []
        for worker in range(self._workers):
            own = part_of(blocks, worker, self._workers)
            device = self._devices[worker % len(self._devices)]
            plan = (worlds, block, own.start, own.stop, device)
            waiting.append(self._executor.submit(_work, rollout, values, scene, plan))
        nodes = [node for future in waiting for node in future.result()]
        shapes = {name: value.shape for name, value in values.items()}
        return mean_and_gradients(total_of(blocks, nodes), worlds, shapes)

    def close(self) -> None:
        """End the workers."""
        self._executor.shutdown()

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
