"""Videos, written by ffmpeg through a pipe."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile

import numpy as np

from ._needs import MissingPackageError

CODECS = {
    ".mp4": ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart"],
    ".webm": ["-c:v", "libvpx-vp9", "-crf", "32", "-b:v", "0"],
    ".webp": ["-c:v", "libwebp", "-q:v", "72", "-loop", "0"],
    ".gif": [
        "-filter_complex",
        "split[a][b];[a]palettegen=max_colors=96:stats_mode=diff[p];"
        "[b][p]paletteuse=dither=bayer:bayer_scale=4:diff_mode=rectangle",
    ],
}


class Video:
    """A video file that is being written, frame by frame."""

    def __init__(self, path: str | os.PathLike[str], width: int, height: int, fps: float) -> None:
        """Start ffmpeg. ValueError: the extension is unknown. RuntimeError: ffmpeg is missing."""
        self.path = os.path.abspath(os.fspath(path))
        ending = os.path.splitext(self.path)[1].lower()
        if ending not in CODECS:
            raise ValueError(f"video: expected a name that ends in {', '.join(CODECS)}, got {path}")
        program = shutil.which("ffmpeg")
        if program is None:
            raise MissingPackageError(
                "a video needs ffmpeg, which is not installed: apt-get install ffmpeg"
            )
        self._messages = tempfile.TemporaryFile()  # noqa: SIM115, closed with the video
        codec = CODECS[ending]
        if ending in (".mp4", ".webm"):  # these formats need an even width and height
            codec = ["-vf", "crop=trunc(iw/2)*2:trunc(ih/2)*2", *codec]
        self._process = subprocess.Popen(
            [
                program, "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24",
                "-s", f"{width}x{height}", "-r", str(fps), "-i", "-", *codec, self.path,
            ],
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._messages,
            start_new_session=True,  # Ctrl-C does not reach ffmpeg, so the video gets finished
        )  # fmt: skip

    def add(self, frame: np.ndarray) -> None:
        """Add a frame {h, w, 3}, uint8."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(frame.tobytes())
        except BrokenPipeError:
            self.close()

    def close(self) -> None:
        """Finish the file. RuntimeError: ffmpeg failed; the message has its output."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        code = self._process.wait()
        self._messages.seek(0)
        messages = self._messages.read().decode(errors="replace").strip()
        self._messages.close()
        if code:
            raise RuntimeError(f"ffmpeg could not write {self.path}: {messages}")
