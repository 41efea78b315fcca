"""Groups by torch.distributed."""

from __future__ import annotations

import os
import socket
import time
from datetime import timedelta
from pathlib import Path

import numpy as np

from ._groups import Group, needed


class TorchGroup(Group):
    """The default process group of torch.distributed.

    Payloads are sent by Gloo, even if the default backend is NCCL.
    """

    kind = "torch"

    def __init__(self, timeout: float) -> None:
        self._torch = needed("torch", '"torch"', "torch")
        self._lib = needed("torch.distributed", '"torch"', "torch")
        self._timeout = timedelta(seconds=timeout)
        self._started = not self._lib.is_initialized()
        if self._started:
            self._lib.init_process_group("gloo", timeout=self._timeout)
        self._group = None
        if self._lib.get_backend() != "gloo":
            self._group = self._lib.new_group(backend="gloo", timeout=self._timeout)
        self.rank, self.size = self._lib.get_rank(), self._lib.get_world_size()
        self._processes: list[str] = []  # "host pid" of each rank
        here = f"{socket.gethostname()} {os.getpid()}".encode()
        self._processes = [of_rank.decode() for of_rank in self.all_gather(here, "init")]

    def close(self) -> None:
        """End the process group, if init started it."""
        if self._started:
            self._lib.destroy_process_group()

    def _gather(self, message: bytes, call: str) -> list[bytes]:
        try:
            # This barrier of Gloo names the ranks that do not arrive in time.
            self._lib.monitored_barrier(self._group, self._timeout, wait_all_ranks=True)
            length = self._torch.tensor([len(message)])
            lengths = [int(n) for n in self._all(length)]
            padded = np.zeros(max(lengths), np.uint8)
            padded[: len(message)] = np.frombuffer(message, np.uint8)
            parts = self._all(self._torch.from_numpy(padded))
        except RuntimeError as error:
            raise RuntimeError(
                f"distributed: {call}: rank {self.rank} waited{self._ended()}: {error}"
            ) from error
        return [part.numpy().tobytes()[:n] for part, n in zip(parts, lengths, strict=True)]

    def _ended(self) -> str:
        """Describe the ranks of this host whose processes have ended."""
        # The connections of a killed process close before /proc shows its end, so wait up to 2 s.
        latest = time.monotonic() + 2.0
        while not (ended := self._ended_now()) and time.monotonic() < latest:
            time.sleep(0.02)
        return f" for {', '.join(ended)}, which ended" if ended else ""

    def _ended_now(self) -> list[str]:
        ended = []
        for rank, process in enumerate(self._processes):
            host, pid = process.split()
            if host == socket.gethostname() and not _runs(pid):
                ended.append(f"rank {rank} (process {pid} of {host})")
        return ended

    def _all(self, tensor: object) -> list:  # type: ignore[type-arg]
        parts = [self._torch.empty_like(tensor) for _ in range(self.size)]
        self._lib.all_gather(parts, tensor, group=self._group)
        return parts


def _runs(pid: str) -> bool:
    """Return whether a process exists and is not a zombie."""
    try:
        state = Path("/proc", pid, "stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return not Path("/proc/self").exists()  # a system without /proc: assume that it runs
    return state not in ("Z", "X")
