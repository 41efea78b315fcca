"""Groups of processes: the interface that torch.distributed, Ray and MPI fill."""

from __future__ import annotations

import os
from typing import Any


class Group:
    """The processes of a run, numbered from 0; this class itself is a process alone.

    The payloads are bytes. Every rank makes the same calls in the same order. A rank that makes
    another call is named in a RuntimeError.
    """

    kind = "alone"
    rank = 0
    size = 1

    def all_gather(self, payload: bytes, call: str = "all_gather") -> list[bytes]:
        """Return the payloads of all ranks, by rank. Payloads may differ in length."""
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
        """Return the payload of one rank on all ranks."""
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
    """Return the launcher of this process, by its environment variables."""
    if {"RANK", "WORLD_SIZE", "MASTER_ADDR"} <= os.environ.keys():
        return "torch"
    slurm = int(os.environ.get("SLURM_STEP_NUM_TASKS", "1")) > 1
    return "mpi" if slurm or any(name in os.environ for name in _MPI) else "alone"


def init(kind: str | None = None, *, timeout: float = 300.0) -> Group:
    """Join the group of this run, and make it the one that the other functions use.

    kind: "torch" (torchrun, or an initialized torch.distributed), "mpi" (mpiexec, srun) or "alone";
    None: what the environment says. Functions that spawn started have a group already.
    timeout: s that a rank waits for the others in one call, with "torch".

    ImportError: the library is missing. ValueError: another kind.
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
    """Return the group of the last init; before init a group of this process alone."""
    return _current


def needed(library: str, kind: str, extra: str) -> Any:
    """Import a library that NovaPhy does not install."""
    import importlib

    try:
        return importlib.import_module(library)
    except ImportError as error:
        raise ImportError(
            f"novaphy.distributed: {kind} needs {library}: pip install novaphy[{extra}]",
            name=library,
        ) from error
