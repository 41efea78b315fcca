"""MpiGroup: a group whose ranks are the processes of MPI, through mpi4py."""

from __future__ import annotations

import sys
import traceback
from types import TracebackType

from ._groups import Group, needed


class MpiGroup(Group):
    """All processes of MPI's COMM_WORLD. An uncaught exception in one rank aborts all ranks."""

    kind = "mpi"

    def __init__(self) -> None:
        needed("mpi4py", '"mpi"', "mpi")
        self._comm = needed("mpi4py.MPI", '"mpi"', "mpi").COMM_WORLD
        self.rank, self.size = self._comm.Get_rank(), self._comm.Get_size()
        sys.excepthook = self._abort

    def _gather(self, message: bytes, call: str) -> list[bytes]:
        return list(self._comm.allgather(message))

    def _abort(
        self, kind: type[BaseException], error: BaseException, trace: TracebackType | None
    ) -> None:
        print(f"rank {self.rank}:", file=sys.stderr)
        traceback.print_exception(kind, error, trace)
        sys.stderr.flush()
        self._comm.Abort(1)
