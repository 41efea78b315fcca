"""ViewerFile: records states to a file, and plays them back.

The file is an .npz archive. Its entry `header` is a JSON text (as uint8) that says what the other
entries are: `time` {frames} in s, `state/<field>` {frames, ...} for the state's fields that have
rows, `model/<field>` for the model's.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections import deque
from typing import Any

import numpy as np

from .. import _core
from .._core import Model, SimState
from ..io import atomic_path
from ._base import Viewer

FORMAT = "novaphy-recording"
FORMAT_VERSION = 1
STATE_FIELDS = ("particle_q", "particle_qd", "body_q", "body_qd", "joint_q", "joint_qd")
MODEL_FIELDS = (
    "particle_radius",
    "particle_flags",
    "shape_type",
    "shape_scale",
    "shape_transform",
    "shape_body",
    "shape_flags",
)


class ViewerFile(Viewer):
    """Records every state that is logged.

    A recording may also be loaded and played back into states of the same sizes.
    """

    def __init__(
        self,
        output_path: str | os.PathLike[str],
        auto_save: bool = True,
        save_interval: int = 100,
        max_history_size: int | None = None,
    ) -> None:
        """Record to `output_path`.

        With auto_save the file is written every `save_interval` frames and when the viewer is
        closed. Only the last `max_history_size` frames are kept (None: all). ValueError: a number
        below 1, or a folder that is not there.
        """
        super().__init__()
        self.output_path = os.path.abspath(os.fspath(output_path))
        if save_interval < 1:
            raise ValueError(f"ViewerFile, save_interval: expected >= 1, got {save_interval}")
        if max_history_size is not None and max_history_size < 1:
            raise ValueError(f"ViewerFile, max_history_size: expected >= 1, got {max_history_size}")
        folder = os.path.dirname(self.output_path)
        if not os.path.isdir(folder):
            raise ValueError(f"ViewerFile, output_path: there is no folder {folder!r}")
        self.auto_save = auto_save
        self.save_interval = save_interval
        self._times: deque[float] = deque(maxlen=max_history_size)
        self._frames: deque[dict[str, np.ndarray]] = deque(maxlen=max_history_size)
        self._model_arrays: dict[str, np.ndarray] = {}
        self._header: dict[str, Any] = {}
        self._recorded = 0
        self._saved = 0

    @property
    def frame_count(self) -> int:
        """Frames that are held."""
        return len(self._frames)

    @property
    def times(self) -> np.ndarray:
        """The time of every held frame {frames}, s."""
        return np.array(self._times, np.float64)

    def set_model(self, model: Model) -> None:
        """Put the model's shapes and radii into the recording."""
        super().set_model(model)
        self._model_arrays = {name: getattr(model, name).numpy() for name in MODEL_FIELDS}

    def log_state(self, state: SimState) -> None:
        """Record the state at the time of the frame."""
        self.record(state)

    def record(self, state: SimState) -> None:
        """Add a copy of a state. ValueError when its sizes differ from the recording's."""
        frame = {}
        for name in STATE_FIELDS:
            values = getattr(state, name).numpy()
            if len(values):
                frame[name] = values
        if self._frames:
            _check_sizes(self._frames[0], frame)
        self._times.append(self.time)
        self._frames.append(frame)
        self._recorded += 1
        if self.auto_save and self._recorded - self._saved >= self.save_interval:
            self.save_recording()

    def save_recording(self, path: str | os.PathLike[str] | None = None) -> str:
        """Write the recording (None: to output_path) and return the path.

        The file appears complete or not at all. OSError when it cannot be written.
        """
        target = self.output_path if path is None else os.path.abspath(os.fspath(path))
        names = list(self._frames[0]) if self._frames else []
        arrays: dict[str, Any] = {"time": self.times}
        for name in names:
            arrays[f"state/{name}"] = np.stack([frame[name] for frame in self._frames])
        for name, values in self._model_arrays.items():
            arrays[f"model/{name}"] = values
        header = {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "novaphy": _core.version(),
            "frames": self.frame_count,
            "state": names,
            "model": list(self._model_arrays),
            "up_axis": self._up_axis(),
        }
        arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
        # Not compressed: with auto_save this runs in between frames.
        with atomic_path(target) as temporary, open(temporary, "wb") as file:
            np.savez(file, **arrays)
        self._saved = self._recorded
        return target

    def load_recording(self, path: str | os.PathLike[str] | None = None) -> None:
        """Replace what is held by a recording (None: from output_path).

        ValueError when the file is no recording that this version reads; what was held stays then.
        """
        source = self.output_path if path is None else os.fspath(path)
        try:
            with np.load(source, allow_pickle=False) as archive:
                entries = {name: archive[name] for name in archive.files}
        except (ValueError, EOFError, zipfile.BadZipFile) as error:
            raise ValueError(f"load_recording: {source!r} is no recording ({error})") from error
        header = _read_header(source, entries)
        missing = [f"state/{name}" for name in header["state"] if f"state/{name}" not in entries]
        if missing or "time" not in entries or len(entries["time"]) != header["frames"]:
            raise ValueError(f"load_recording: {source!r} is incomplete")
        frames = [
            {name: entries[f"state/{name}"][k] for name in header["state"]}
            for k in range(header["frames"])
        ]
        limit = self._frames.maxlen
        self._times = deque((float(t) for t in entries["time"]), maxlen=limit)
        self._frames = deque(frames, maxlen=limit)
        self._model_arrays = {
            name.removeprefix("model/"): values
            for name, values in entries.items()
            if name.startswith("model/")
        }
        self._header = header
        self._recorded = self._saved = self.frame_count

    def playback(self, state: SimState, frame: int) -> float:
        """Copy a held frame into a state and return its time (s).

        IndexError: no such frame; ValueError: the state's sizes differ from the recording's.
        """
        if not -self.frame_count <= frame < self.frame_count:
            raise IndexError(f"playback, frame: expected one of {self.frame_count}, got {frame}")
        values = self._frames[frame]
        sizes = {
            name: np.empty(getattr(state, name).shape, np.float32)
            for name in STATE_FIELDS
            if len(getattr(state, name))
        }
        _check_sizes(values, sizes)
        for name, array in values.items():
            getattr(state, name).assign(array)
        self.time = self._times[frame]
        return self.time

    def close(self) -> None:
        """End the viewer; with auto_save, write what was not written yet."""
        if self.is_running() and self.auto_save and self._recorded != self._saved:
            self.save_recording()
        super().close()

    def _up_axis(self) -> int:
        if self.model is not None:
            return self.model.up_axis
        return int(self._header.get("up_axis", 2))


def _check_sizes(expected: dict[str, np.ndarray], found: dict[str, np.ndarray]) -> None:
    sizes = {name: values.shape for name, values in expected.items()}
    other = {name: values.shape for name, values in found.items()}
    if sizes != other:
        raise ValueError(f"state: expected the recording's sizes {sizes}, got {other}")


def _read_header(source: str, entries: dict[str, np.ndarray]) -> dict[str, Any]:
    try:
        header: dict[str, Any] = json.loads(entries["header"].tobytes().decode())
        name, version = header["format"], header["version"]
        header["frames"], header["state"]
    except (KeyError, TypeError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"load_recording: {source!r} has no header of a recording") from error
    if name != FORMAT or version != FORMAT_VERSION:
        raise ValueError(
            f"load_recording: {source!r}: expected {FORMAT} version {FORMAT_VERSION}, "
            f"got {name} version {version}"
        )
    return header
