"""ViewerNull: a viewer without output."""

from __future__ import annotations

import time

from ._base import Viewer


class ViewerNull(Viewer):
    """Shows nothing and runs for a number of frames.

    With benchmark=True the viewer measures the time of each frame, from one end_frame to the next.
    """

    def __init__(self, num_frames: int = 1000, benchmark: bool = False) -> None:
        """Run for `num_frames` frames (ValueError below 0)."""
        super().__init__()
        if num_frames < 0:
            raise ValueError(f"ViewerNull, num_frames: expected >= 0, got {num_frames}")
        self.num_frames = num_frames
        self.benchmark = benchmark
        self.frame_count = 0
        self._last: float | None = None
        self._seconds: list[float] = []

    def is_running(self) -> bool:
        """Return False after the last frame, or after the viewer was closed."""
        return super().is_running() and self.frame_count < self.num_frames

    def end_frame(self) -> None:
        """Count the frame."""
        self.frame_count += 1
        if not self.benchmark:
            return
        now = time.perf_counter()
        if self._last is not None:
            self._seconds.append(now - self._last)
        self._last = now

    def benchmark_result(self) -> dict[str, float] | None:
        """Return frames, seconds and frames per second so far; None without a measurement.

        The first frame is not counted, because it may include the compilation of kernels.
        """
        if not self._seconds:
            return None
        seconds = sum(self._seconds)
        frames = len(self._seconds)
        return {
            "frames": float(frames),
            "seconds": seconds,
            "fps": frames / seconds if seconds else 0.0,
        }
