"""Groups of processes: a common interface for torch.distributed, Ray and MPI."""

from __future__ import annotations

import os
from typing import Any


class Group:
    """The processes of a run. This base class is a group of one process.

    A rank is the number of a process, from 0. Payloads are bytes. All ranks must make the same
    calls in the same order. RuntimeError: a rank made another call; the message names the rank.
    """

    kind = "alone"
    rank = 0
    size = 1

    def all_gather(self, payload: bytes, call: str = "all_gather") -> list[bytes]:
        """Return the payloads of all ranks, in the order of ranks. Lengths may differ."""
        header = call.encode() + b"\0"
        found = []
        for rank, message in enumerate(self._gather(header + payload, call)):
            other, _, rest = message.partition(b"\0")
            if other != header[:-1]:
                raise RuntimeError(
                    f"distributed: rank {self.rank} calls {call}, rank {rank} calls "
                    f"{other.decode(errors='replace')}"
                )
            found.append(rest)
        return found

    def broadcast(self, payload: bytes, root: int = 0, call: str = "broadcast") -> bytes:
        """Return the payload of the rank `root` on all ranks."""
        if not 0 <= root < self.size:
            raise IndexError(f"broadcast: root: expected 0 to {self.size - 1}, got {root}")
        return self.all_gather(payload if self.rank == root else b"", call)[root]

    def barrier(self) -> None:
        """Wait until all ranks have called barrier."""
        self.all_gather(b"", "barrier")

    def close(self) -> None:
        """Leave the group."""

    def _gather(self, message: bytes, call: str) -> list[bytes]:
        return [message]


_current = Group()
_MPI = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK", "MPI_LOCALNRANKS")


def _kind() -> str:
    """Return "torch", "mpi" or "alone", from the environment variables of the launcher."""
    if {"RANK", "WORLD_SIZE", "MASTER_ADDR"} <= os.environ.keys():
        return "torch"
    slurm = int(os.environ.get("SLURM_STEP_NUM_TASKS", "1")) > 1
    return "mpi" if slurm or any(name in os.environ for name in _MPI) else "alone"


def init(kind: str | None = None, *, timeout: float = 300.0) -> Group:
    """Join the group of processes of this run, and make it the current group.

    kind: "torch" (torchrun, or an initialized torch.distributed), "mpi" (mpiexec, srun) or "alone"
    (one process). None: find out from the environment. In a function that spawn started, None
    returns the group of spawn.
    timeout: how long a rank waits for the other ranks in one call (s), for "torch".

    ImportError: the library is missing. ValueError: an unknown kind.
    """
    if kind is None and _current.kind == "ray":
        return _current
    kind = kind or _kind()
    if not timeout > 0:
        raise ValueError(f"init: timeout: expected > 0, got {timeout}")
    if kind == "torch":
        from ._torch import TorchGroup

        return use(TorchGroup(timeout))
    if kind == "mpi":
        from ._mpi import MpiGroup

        return use(MpiGroup())
    if kind == "alone":
        return use(Group())
    raise ValueError(f'init: kind: expected "torch", "mpi" or "alone", got {kind!r}')


def use(group: Group) -> Group:
    """Make a group the current one."""
    global _current
    _current = group
    return group


def current() -> Group:
    """Return the current group: that of the last init, or a group of this process before init."""
    return _current


def needed(library: str, kind: str, extra: str) -> Any:
    """Import a library that NovaPhy does not install. ImportError: the message names `extra`."""
    import importlib

    try:
        return importlib.import_module(library)
    except ImportError as error:
        raise ImportError(
            f"novaphy.distributed: {kind} needs {library}: pip install novaphy[{extra}]",
            name=library,
        ) from error
