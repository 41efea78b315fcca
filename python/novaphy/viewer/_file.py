"""ViewerFile: records states and drawings to a file, and plays them back."""

from __future__ import annotations

import io
import itertools
import os
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, BinaryIO

import numpy as np

from .._core import Contacts, Model, SimState
from ..io import atomic_path
from . import _recording
from ._base import Viewer
from ._model_scene import draw_contacts, model_arrays
from ._recording import Call, Frame

STATE_FIELDS = ("particle_q", "particle_qd", "body_q", "body_qd", "joint_q", "joint_qd")
# Calls that are recorded with their arguments. A call replaces the last call with its name.
DRAWINGS = (
    "set_camera",
    "look_at",
    "follow",
    "set_world_offsets",
    "set_shape_colors",
    "log_mesh",
    "log_instances",
    "log_shapes",
    "log_lines",
    "log_arrows",
    "log_points",
    "log_array",
    "log_scalar",
    "log_image",
)


class ViewerFile(Viewer):
    """Records the state and the drawings of every frame.

    A recording can also be loaded, played back into states of the same sizes, and shown in another
    viewer. A notebook displays the recording.
    """

    def __init__(
        self,
        output_path: str | os.PathLike[str],
        auto_save: bool = True,
        save_interval: int = 100,
        max_history_size: int | None = None,
    ) -> None:
        """Record to `output_path`.

        With auto_save the frames are written in chunks of `save_interval` frames, and when the
        viewer is closed. A program that is killed loses only the frames since the last chunk. With
        a `max_history_size` only that many last frames are kept; None keeps all frames.

        A name that ends in .npz selects a single archive that NumPy can open. The archive has no
        drawings and is rewritten at every save. ValueError: a number below 1, or a folder that does
        not exist.
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
        self._frames: deque[Frame] = deque(maxlen=max_history_size)
        self._model_arrays: dict[str, np.ndarray] = {}
        self._up_axis = 2
        self._state: dict[str, np.ndarray] | None = None
        self._calls: list[Call] = []
        self._latest: dict[tuple[str, str], dict[str, Any]] = {}
        self._file: BinaryIO | None = None
        self._end = 0  # length (bytes) of the file up to the last complete chunk
        self._unsaved: list[Frame] = []  # frames that auto_save has not written yet

    @property
    def frame_count(self) -> int:
        """The number of frames in memory."""
        return len(self._frames)

    @property
    def times(self) -> np.ndarray:
        """The times of the frames in memory {frames}, s."""
        return np.array([frame.time for frame in self._frames], np.float64)

    def set_model(self, model: Model) -> None:
        """Add the visible parts of a model to the recording."""
        super().set_model(model)
        self.set_model_arrays(model_arrays(model), model.up_axis)

    def set_model_arrays(self, arrays: Mapping[str, np.ndarray], up_axis: int) -> None:
        """Add a model given by its arrays to the recording."""
        self._model_arrays = dict(arrays)
        self._up_axis = int(up_axis)
        if self._file is not None:  # the model is the first chunk, so start a new file
            self._close_file()
            self._unsaved = list(self._frames)

    def log_state(self, state: SimState) -> None:
        """Record the state of the frame. ValueError: its sizes differ from other frames."""
        fields = {name: getattr(state, name) for name in STATE_FIELDS}
        self.log_state_arrays({name: rows.numpy() for name, rows in fields.items()})

    def log_state_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Record a state given by its arrays."""
        state = {name: np.array(rows) for name, rows in arrays.items() if len(rows)}
        with_states = next((frame for frame in self._frames if frame.state), None)
        if with_states is not None:
            _check_sizes(with_states.state, state)
        self._state = state

    def log_contacts(self, contacts: Contacts, state: SimState) -> None:
        """Record the contacts of a state as points and arrows. ValueError: no model is set."""
        if not self._model_arrays:
            raise ValueError("log_contacts: expected a model before, got none: call set_model")
        draw_contacts(self, self._model_arrays, contacts, state)

    def end_frame(self) -> None:
        """Add the frame to the recording."""
        if self._state is not None or self._calls:
            self._add(self._state or {})

    def record(self, state: SimState) -> None:
        """Add a copy of a state as a frame. ValueError: its sizes differ from those of other
        frames.
        """
        self.log_state(state)
        self.end_frame()

    def _add(self, state: dict[str, np.ndarray]) -> None:
        frame = Frame(self.time, state, self._calls)
        self._state, self._calls = None, []
        if len(self._frames) == self._frames.maxlen:
            _carry_drawings(self._frames[0], self._frames[1] if len(self._frames) > 1 else frame)
        if self.auto_save:
            self._unsaved.append(frame)
        self._frames.append(frame)
        if len(self._unsaved) >= self.save_interval:
            self._save_new()

    def _draw(self, call: str, arguments: dict[str, Any]) -> None:
        """Record a drawing call, unless it repeats the last call with this name."""
        plain = {name: _plain(value) for name, value in arguments.items()}
        key = (call, str(plain.get("name", "")))
        known = self._latest.get(key)
        if known is not None and call != "log_scalar" and _same(known, plain):
            return
        self._latest[key] = plain
        self._calls.append((call, plain))

    def _save_new(self) -> None:
        """Write the unsaved frames to output_path.

        After an exception, such as Ctrl-C, the file keeps the frames that were written. The next
        call writes the remaining frames.
        """
        if self._is_archive(self.output_path) or self._frames.maxlen is not None:
            self.save_recording()
            return
        if self._file is None:
            self.save_recording()
            file = open(self.output_path, "r+b")  # noqa: SIM115, closed with the viewer
            self._end, self._file = file.seek(0, os.SEEK_END), file
            return
        new = io.BytesIO()
        _write_runs(new, self._unsaved)
        self._file.seek(self._end)
        self._file.write(new.getbuffer())
        self._file.truncate()
        self._file.flush()
        self._end, self._unsaved = self._file.tell(), []

    def save_recording(self, path: str | os.PathLike[str] | None = None) -> str:
        """Write the recording (None: to output_path) and return the path.

        The file is written atomically. OSError: the file cannot be written.
        """
        target = self.output_path if path is None else os.path.abspath(os.fspath(path))
        frames = list(self._frames)
        with atomic_path(target) as temporary, open(temporary, "wb") as file:
            if self._is_archive(target):
                with_states = [frame for frame in frames if frame.state]
                _recording.write_archive(file, self._model_arrays, self._up_axis, with_states)
            else:
                _recording.write_start(file, self._model_arrays, self._up_axis)
                _write_runs(file, frames)
        if os.path.realpath(target) == os.path.realpath(self.output_path):
            self._close_file()
            self._unsaved = []
        return target

    def load_recording(self, path: str | os.PathLike[str] | None = None) -> None:
        """Replace the frames in memory by a recording (None: from output_path).

        ValueError: the file is not a recording that this version supports; the frames in memory are
        then unchanged.
        """
        recording = _recording.read(self.output_path if path is None else os.fspath(path))
        kept = self._frames.maxlen or len(recording.frames)
        for before, after in itertools.pairwise(
            recording.frames[: len(recording.frames) - kept + 1]
        ):
            _carry_drawings(before, after)
        self._frames = deque(recording.frames, maxlen=self._frames.maxlen)
        self._model_arrays, self._up_axis = recording.model, recording.up_axis
        self._state, self._calls, self._latest = None, [], {}
        self._close_file()
        self._unsaved = []

    def playback(self, state: SimState, frame: int) -> float:
        """Copy a frame into a state and return its time (s).

        IndexError: the frame does not exist. ValueError: the state's sizes differ from the
        recording's.
        """
        held = self._frame(frame, "playback")
        sizes = {
            name: np.empty(getattr(state, name).shape, np.float32)
            for name in STATE_FIELDS
            if len(getattr(state, name))
        }
        _check_sizes(held.state, sizes)
        for name, array in held.state.items():
            getattr(state, name).assign(array)
        self.time = held.time
        return self.time

    def show_start(self, viewer: Viewer) -> None:
        """Clear another viewer and give it the model of the recording."""
        viewer.clear()
        viewer.set_model_arrays(self._model_arrays, self._up_axis)

    def show_frame(self, viewer: Viewer, frame: int, from_start: bool = False) -> float:
        """Show a frame in another viewer and return its time (s).

        Args:
            viewer: the viewer that draws the frame. The viewer must have shown the previous frame,
                or only the start (`show_start`).
            frame: index of the frame. IndexError: the frame does not exist.
            from_start: also show the drawings of all earlier frames.
        """
        held = self._frame(frame, "show_frame")
        calls, followed = held.calls, {}
        if from_start:
            last = frame % self.frame_count
            latest: dict[Any, Call] = {}
            for k in range(last + 1):
                for n, (call, arguments) in enumerate(self._frames[k].calls):
                    if call == "follow":  # the camera moves with the body from that frame on
                        followed = self._frames[k].state
                    adds = call == "log_scalar"  # adds to a curve; other calls replace a drawing
                    latest[(k, n) if adds else (call, arguments.get("name"))] = (call, arguments)
            calls = list(latest.values())
        viewer.begin_frame(held.time)
        for call, arguments in calls:
            getattr(viewer, call)(**arguments)
        if followed:
            viewer.log_state_arrays(followed)
        if held.state:
            viewer.log_state_arrays(held.state)
        viewer.end_frame()
        return held.time

    def show(self, viewer: Viewer) -> None:
        """Show the whole recording in another viewer, without waiting."""
        self.show_start(viewer)
        for frame in range(self.frame_count):
            self.show_frame(viewer, frame)

    def _frame(self, frame: int, call: str) -> Frame:
        if not -self.frame_count <= frame < self.frame_count:
            raise IndexError(f"{call}, frame: expected one of {self.frame_count}, got {frame}")
        return self._frames[frame]

    def _repr_html_(self) -> str:
        """Return an inline frame with a page that replays the recording."""
        from ._html import ViewerHTML

        page = ViewerHTML(None)
        self.show(page)
        return page._repr_html_()

    def close(self) -> None:
        """Close the viewer; with auto_save, write the unsaved frames."""
        if self.is_running() and self.auto_save:
            self.end_frame()
            if self._unsaved:
                self._save_new()
        self._close_file()
        super().close()

    def _close_file(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    @staticmethod
    def _is_archive(path: str) -> bool:
        return path.lower().endswith(".npz")


def _drawing(call: str) -> Callable[..., None]:
    """Make a method that records a call, with the signature and docstring of Viewer's method."""
    import functools
    import inspect

    signature = inspect.signature(getattr(Viewer, call))

    @functools.wraps(getattr(Viewer, call))
    def record(self: ViewerFile, *args: Any, **kwargs: Any) -> None:
        bound = signature.bind(self, *args, **kwargs).arguments
        self._draw(call, {name: value for name, value in bound.items() if name != "self"})

    return record


for _call in DRAWINGS:
    setattr(ViewerFile, _call, _drawing(_call))


def _plain(value: Any) -> Any:
    """Return a number, text or None unchanged, and any other value as a copied array."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    array = np.array(value.numpy() if hasattr(value, "numpy") else value)
    if array.dtype.hasobject:
        raise ValueError(f"ViewerFile: expected numbers or text, got an array of {array.dtype}")
    return array


def _same(a: Mapping[str, Any], b: Mapping[str, Any]) -> bool:
    return a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)


def _carry_drawings(dropped: Frame, after: Frame) -> None:
    """Move the drawings of a dropped frame to the next frame, unless that frame replaces them."""
    replaced = {(call, arguments.get("name")) for call, arguments in after.calls}
    after.calls = [
        (call, arguments)
        for call, arguments in dropped.calls
        if call != "log_scalar" and (call, arguments.get("name")) not in replaced
    ] + after.calls


def _write_runs(file: BinaryIO, frames: list[Frame]) -> None:
    """Write frames in chunks, each of frames that all have a state or all have none."""
    start = 0
    for k in range(1, len(frames) + 1):
        if k == len(frames) or bool(frames[k].state) != bool(frames[start].state):
            _recording.write_frames(file, frames[start:k])
            start = k


def _check_sizes(expected: Mapping[str, np.ndarray], found: Mapping[str, np.ndarray]) -> None:
    sizes = {name: values.shape for name, values in expected.items()}
    other = {name: values.shape for name, values in found.items()}
    if sizes != other:
        raise ValueError(f"state: expected the recording's sizes {sizes}, got {other}")
