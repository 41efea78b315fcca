"""The two file formats of recordings of ViewerFile.

Version 2 (.nprec) is a line with the name of the format, followed by chunks. New chunks are only
appended. A chunk is the length and the CRC-32 of its content (uint32 each, little-endian), then the
content, an .npz archive. The first chunk has the header and the model's arrays (`model/<field>`).
Each later chunk has several frames:

* `time`: {frames}, s.
* `state/<field>`: {frames, ...}.
* `calls`: a JSON text (as uint8) with the drawings of each frame, [[call, arguments], ...]. The
value {"array": k} stands for the entry `array/k`.

An incomplete chunk at the end, as after a killed process, is ignored.

Version 1 (.npz) is one archive with the states of all frames, without drawings.
"""

from __future__ import annotations

import io
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np

from .. import _core

FORMAT = "novaphy-recording"
MAGIC = b"novaphy-recording 2\n"
Call = tuple[str, dict[str, Any]]


class Frame:
    """The state and the drawings of one frame."""

    def __init__(self, time: float, state: dict[str, np.ndarray], calls: list[Call]) -> None:
        """Make a frame from the time (s), the state arrays by field, and the calls in order."""
        self.time = time
        self.state = state
        self.calls = calls


class Recording:
    """The contents of a recording."""

    def __init__(self, model: dict[str, np.ndarray], up_axis: int, frames: Sequence[Frame]) -> None:
        """Make a recording from the model's arrays by field, its up axis, and the frames."""
        self.model = model
        self.up_axis = up_axis
        self.frames = list(frames)


def write_start(file: BinaryIO, model: Mapping[str, np.ndarray], up_axis: int) -> None:
    """Write the beginning of a version 2 file."""
    header = {"format": FORMAT, "version": 2, "novaphy": _core.version(), "up_axis": up_axis}
    file.write(MAGIC)
    _write_chunk(file, {"header": _text(header)} | {f"model/{k}": v for k, v in model.items()})


def write_frames(file: BinaryIO, frames: Sequence[Frame]) -> None:
    """Append frames as one chunk; all states have the same sizes."""
    arrays: dict[str, np.ndarray] = {"time": np.array([frame.time for frame in frames])}
    for name in frames[0].state:
        arrays[f"state/{name}"] = np.stack([frame.state[name] for frame in frames])
    calls, count = [], 0
    for frame in frames:
        coded = []
        for call, arguments in frame.calls:
            plain = {}
            for name, value in arguments.items():
                if isinstance(value, np.ndarray):
                    arrays[f"array/{count}"] = value
                    value = {"array": count}
                    count += 1
                plain[name] = value
            coded.append([call, plain])
        calls.append(coded)
    arrays["calls"] = _text(calls)
    _write_chunk(file, arrays)


def write_archive(
    file: BinaryIO, model: Mapping[str, np.ndarray], up_axis: int, frames: Sequence[Frame]
) -> None:
    """Write a version 1 file."""
    names = list(frames[0].state) if frames else []
    arrays: dict[str, Any] = {"time": np.array([frame.time for frame in frames], np.float64)}
    for name in names:
        arrays[f"state/{name}"] = np.stack([frame.state[name] for frame in frames])
    header = {
        "format": FORMAT,
        "version": 1,
        "novaphy": _core.version(),
        "frames": len(frames),
        "state": names,
        "model": list(model),
        "up_axis": up_axis,
    }
    # The archive is not compressed, because auto_save writes it between frames.
    arrays |= {"header": _text(header)} | {f"model/{k}": v for k, v in model.items()}
    np.savez(file, **arrays)


def read(source: str) -> Recording:
    """Read a recording of either version. ValueError: the file is not a recording."""
    with open(source, "rb") as file:
        if file.read(len(MAGIC)) == MAGIC:
            return _read_chunks(source, file)
    if not zipfile.is_zipfile(source):
        raise ValueError(f"load_recording: {source!r} is no recording (neither .nprec nor .npz)")
    try:
        with np.load(source, allow_pickle=False) as archive:
            entries = {name: archive[name] for name in archive.files}
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"load_recording: {source!r} is no recording ({error})") from error
    return _read_archive(source, entries)


def _text(value: Any) -> np.ndarray:
    return np.frombuffer(json.dumps(value).encode(), np.uint8)


def _write_chunk(file: BinaryIO, arrays: Mapping[str, np.ndarray]) -> None:
    content = io.BytesIO()
    everything: dict[str, Any] = dict(arrays)
    np.savez(content, **everything)
    data = content.getbuffer()
    file.write(struct.pack("<II", len(data), zlib.crc32(data)))
    file.write(data)


def _chunks(file: BinaryIO) -> Iterator[dict[str, np.ndarray]]:
    """Yield the chunks of a file up to its end, or up to an incomplete chunk."""
    while True:
        head = file.read(8)
        if len(head) < 8:
            return
        length, check = struct.unpack("<II", head)
        if length > os.fstat(file.fileno()).st_size - file.tell():
            return
        data = file.read(length)
        if zlib.crc32(data) != check:
            return
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            yield {name: archive[name] for name in archive.files}


def _read_chunks(source: str, file: BinaryIO) -> Recording:
    recording = None
    for entries in _chunks(file):
        if recording is None:
            header = _read_header(source, entries, 2)
            recording = Recording(_model_of(entries), int(header["up_axis"]), [])
            continue
        all_calls = json.loads(entries["calls"].tobytes())
        states = {
            name.removeprefix("state/"): values
            for name, values in entries.items()
            if name.startswith("state/")
        }
        for k, (time, coded) in enumerate(zip(entries["time"], all_calls, strict=True)):
            calls = [
                (
                    call,
                    {
                        name: entries[f"array/{value['array']}"]
                        if isinstance(value, dict)
                        else value
                        for name, value in arguments.items()
                    },
                )
                for call, arguments in coded
            ]
            state = {name: values[k] for name, values in states.items()}
            recording.frames.append(Frame(float(time), state, calls))
    if recording is None:
        raise ValueError(f"load_recording: {source!r} is incomplete: it has no header")
    return recording


def _read_archive(source: str, entries: dict[str, np.ndarray]) -> Recording:
    header = _read_header(source, entries, 1)
    names = header["state"]
    missing = [f"state/{name}" for name in names if f"state/{name}" not in entries]
    if missing or "time" not in entries or len(entries["time"]) != header["frames"]:
        raise ValueError(f"load_recording: {source!r} is incomplete")
    frames = [
        Frame(float(time), {name: entries[f"state/{name}"][k] for name in names}, [])
        for k, time in enumerate(entries["time"])
    ]
    return Recording(_model_of(entries), int(header.get("up_axis", 2)), frames)


def _model_of(entries: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {
        name.removeprefix("model/"): values
        for name, values in entries.items()
        if name.startswith("model/")
    }


def _read_header(source: str, entries: Mapping[str, np.ndarray], expected: int) -> dict[str, Any]:
    try:
        header: dict[str, Any] = json.loads(entries["header"].tobytes().decode())
        name, version = header["format"], header["version"]
        if version == 1:
            header["frames"], header["state"]
    except (KeyError, TypeError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"load_recording: {source!r} has no header of a recording") from error
    if name != FORMAT or version != expected:
        raise ValueError(
            f"load_recording: {source!r}: expected {FORMAT} version {expected}, "
            f"got {name} version {version}"
        )
    return header
