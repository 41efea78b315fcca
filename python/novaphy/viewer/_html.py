"""ViewerHTML: a single page that replays a run in any browser, without a server or a library."""

from __future__ import annotations

import base64
import json
import math
import os
import zlib
from collections.abc import Callable, Iterator
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from ..io import atomic_path
from . import _shaders
from ._adjoint import check_record, fragment, log_arrows_between
from ._camera import FIELD_OF_VIEW
from ._gl_renderer import HAZE, LIGHT, REACH
from ._packing import pack, quantum
from ._png import png_bytes
from ._scene import Instances, Lines, f32
from ._scene_viewer import SceneViewer

if TYPE_CHECKING:
    from ..nova import AdjointRecord

MESH_FIELDS = ("points", "shift", "indices")
# Resolution of stored motion (_packing.py). The height of the image at the camera's target has
# STEPS_OF_PICTURE position steps. Quaternion components are rounded to QUATERNION_QUANTUM.
STEPS_OF_PICTURE, QUATERNION_QUANTUM = 2**14, 2.0**-15
MOVING = {"points": 3, "poses": 7, "starts": 3, "ends": 3}


class ViewerHTML(SceneViewer):
    """Collects frames, and writes a self-contained page when the viewer is closed.

    A frame that is not later than the previous frame starts a new take, for example the next
    iteration of a training. The page plays the takes in order and has a slider to select one.

    Constant arrays are stored once. Positions are rounded to 1/16384 of the height of the image at
    the camera's target, and quaternion components to 3e-5. Other values are stored unchanged.
    """

    def __init__(self, output_path: str | os.PathLike[str] | None, title: str = "NovaPhy") -> None:
        """Write the page to `output_path`. None: write no file; use page() or a notebook.

        ValueError: the folder does not exist.
        """
        super().__init__()
        self.output_path = None if output_path is None else os.path.abspath(os.fspath(output_path))
        self.title = title
        if self.output_path and not os.path.isdir(os.path.dirname(self.output_path)):
            raise ValueError(f"ViewerHTML, output_path: there is no folder for {output_path}")
        self._times: list[float] = []
        self._takes: list[int] = []
        self._targets: dict[int, np.ndarray] = {}  # target (m) of a moving camera by frame
        self._scalars: dict[str, list[float | None]] = {}
        self._tracks: dict[tuple[str, str, str], _Track] = {}
        self._data = bytearray()
        self._known: dict[bytes, int] = {}
        self._record: AdjointRecord | None = None
        self._arrow_length = 0.0

    def log_adjoint_record(self, record: AdjointRecord, length: float = 0.3) -> None:
        """Add a plot of a gradient over time, and arrows of its contacts to the next frames.

        The plot shows the norm of the gradient, H, events and suspects. H is the gradient by the
        state times the rate of the state, which smooth steps keep. Suspects are steps in which H
        changes. A click shows the step and its contacts. The times of frames must be the times of
        the record (s).

        Args:
            record: the result of `tape.adjoint_record()`.
            length: the length (m) of the longest impulse arrow (blue) and of the longest adjoint
                arrow (red).

        Raises:
            TypeError: `record` is no AdjointRecord.
            ValueError: a record without steps; a length that is not positive and finite.
        """
        check_record(record, length)
        self._record, self._arrow_length = record, length

    @property
    def frame_count(self) -> int:
        """The number of frames in memory."""
        return len(self._times)

    def end_frame(self) -> None:
        """Store the changes since the last frame."""
        frame = len(self._times)
        if self._record is not None:
            before = self._times[-1] if frame and self.time > self._times[-1] else -math.inf
            log_arrows_between(self, self._record, before, self.time, self._arrow_length)
        if not frame or self.time <= self._times[-1]:
            self._takes.append(frame)
        self._times.append(self.time)
        if self.follows:
            self._targets[frame] = self.camera.target.copy()
        for name, mesh in self.scene.meshes.items():
            for field in MESH_FIELDS:
                self._keep(frame, ("mesh", name, field), getattr(mesh, field))
        for name, item in self.scene.instances.items():
            for field in Instances.fields:
                self._keep(frame, ("instances", name, field), getattr(item, field))
            self._keep_value(frame, ("instances", name, "hidden"), float(item.hidden))
        for name, lines in self.scene.lines.items():
            for field in Lines.fields:
                self._keep(frame, ("lines", name, field), getattr(lines, field))
            self._keep_value(frame, ("lines", name, "hidden"), float(lines.hidden))
        for kind, items in (("instances", self.scene.instances), ("lines", self.scene.lines)):
            for key in [key for key in self._tracks if key[0] == kind and key[2] == "hidden"]:
                if key[1] not in items:
                    self._keep_value(frame, key, 1.0)
        for name, curve in self.scene.curves.items():
            self._keep_if_other(frame, ("curve", name, "values"), curve, f32)
        for name, pixels in self.scene.images.items():
            self._keep_if_other(frame, ("image", name, "png"), pixels, _png_words)
        for name, values in self.scene.scalars.items():
            if values:
                known = self._scalars.setdefault(name, [])
                # JSON has no NaN, so a value that is not finite is None: a gap in the curve.
                last = float(f"{values[-1]:.7g}") if math.isfinite(values[-1]) else None
                known += [None] * (frame - len(known)) + [last]

    def _keep(self, frame: int, key: tuple[str, str, str], part: Any) -> None:
        track = self._tracks.setdefault(key, _Track())
        if track.seen != part.revision:
            track.seen = part.revision
            self._store(frame, track, part.values)

    def _keep_value(self, frame: int, key: tuple[str, str, str], value: float) -> None:
        track = self._tracks.setdefault(key, _Track())
        if track.seen != value:
            track.seen = value
            self._store(frame, track, f32([value]))

    def _keep_if_other(
        self,
        frame: int,
        key: tuple[str, str, str],
        values: np.ndarray,
        coded: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        """Store coded(values) if the array is another object than in the last frame.

        The scene replaces an array when it changes, so the same object has the same values.
        """
        track = self._tracks.setdefault(key, _Track())
        if track.seen is not values:
            track.seen = values
            self._store(frame, track, coded(values))

    def _store(self, frame: int, track: _Track, values: np.ndarray) -> None:
        data = np.ascontiguousarray(values).tobytes()
        offset = self._known.get(data)
        if offset is None:
            offset = self._known[data] = len(self._data) // 4
            self._data += data
        track.frames.append(frame)
        track.offsets.append(offset)
        track.sizes.append(values.size)

    def page(self) -> str:
        """Return the page with all frames so far."""
        if not self.camera.is_set:
            self._place_camera()
        names: dict[str, Any] = {
            name: {"mesh": item.mesh, "culled": item.culled}
            for name, item in self.scene.instances.items()
        }
        names |= {name: {"width": lines.width} for name, lines in self.scene.lines.items()}
        camera, target, along = self.camera, self.camera.target, list[list[float]]()
        if self._targets:  # the camera follows a body; before that, it keeps the first target
            start = min(self._targets)
            target, at = self._targets[start], self._targets[start]
            for frame in range(len(self._times)):
                at = self._targets.get(frame, at)
                along.append([round(float(v), 3) for v in at])
        data, runs, packed = self._packed_data()
        content = {
            "title": self.title,
            "times": [round(t, 6) for t in self._times],
            "takes": self._takes,
            "scalars": self._scalars,
            "objects": names,
            "tracks": [
                [*key, track.frames, track.offsets, _short(track.sizes)]
                for key, track in self._tracks.items()
                if key[1] in names or key[0] in ("mesh", "curve", "image")
            ],
            "words": len(self._data) // 4,
            "runs": runs,
            "packed": packed,
            "camera": {
                "up": camera.up_axis,
                "target": [float(v) for v in target],
                "along": along,
                "distance": camera.distance,
                "yaw": camera.yaw,
                "pitch": camera.pitch,
                "fov": FIELD_OF_VIEW,
            },
            "look": {"haze": HAZE, "light": LIGHT, "reach": REACH},
            "shaders": {
                name.lower(): _shaders.WEB_HEADER + getattr(_shaders, name)
                for name in (
                    "MESH_VERTEX", "MESH_FRAGMENT", "DEPTH_FRAGMENT", "LINE_VERTEX", "LINE_FRAGMENT"
                )
            },
        }  # fmt: skip
        text = json.dumps(content, separators=(",", ":")).replace("</", "<\\/")
        blob = base64.b64encode(zlib.compress(data, 9)).decode()
        template = resources.files(__package__).joinpath("assets/page.html").read_text("utf-8")
        head, _, rest = template.partition("/*CONTENT*/")
        middle, _, tail = rest.partition("/*DATA*/")
        shown = "" if self._record is None else fragment(self._record)
        return f"{head}{text}{middle}{blob}{tail}".replace("<!--ADJOINT-->", shown)

    def _packed_data(self) -> tuple[bytes, list[list[int]], list[Any]]:
        """Return the stored arrays in packed form, as three values.

        The values are the bytes; the unpacked parts (first word, number of words); and the packed
        parts (predictor, number of components, their quanta, values per frame, offsets of frames).
        A word has 4 bytes.
        """
        height = 2.0 * self.camera.distance * math.tan(math.radians(FIELD_OF_VIEW / 2))
        step = quantum(height / STEPS_OF_PICTURE)
        words = np.frombuffer(self._data, np.float32)
        plain = np.ones(len(words), bool)
        data, packed = bytearray(), []
        for (_, _, field), track in self._tracks.items():
            width = MOVING.get(field)
            if width is None:
                continue
            quanta = [step] * 3 + [QUATERNION_QUANTUM] * (width - 3)
            for size, places in _equal_sizes(track, plain):
                frames = np.stack([words[place : place + size] for place in places])
                found = pack(frames.reshape(len(places), -1, width), f32(quanta))
                if found is not None:
                    packed.append([found[0], width, quanta, size, places])
                    data += found[1]
                    for place in places:
                        plain[place : place + size] = False
        edges = np.flatnonzero(np.diff(plain, prepend=False, append=False)).reshape(-1, 2)
        runs = [[int(first), int(last - first)] for first, last in edges]
        return bytes(data) + words[plain].tobytes(), runs, packed

    def _repr_html_(self) -> str:
        """Return an inline frame with the page, for notebooks."""
        import html

        return (
            f'<iframe srcdoc="{html.escape(self.page())}" width="100%" height="480" '
            'style="border:0"></iframe>'
        )

    def save(self, path: str | os.PathLike[str] | None = None) -> str:
        """Write the page (None: to output_path), atomically, and return the path."""
        target = self.output_path if path is None else os.path.abspath(os.fspath(path))
        if target is None:
            raise ValueError("save, path: expected one, since the viewer has no output_path")
        with atomic_path(target) as temporary, open(temporary, "w", encoding="utf-8") as file:
            file.write(self.page())
        return target

    def close(self) -> None:
        """Write the page and close the viewer."""
        if self._running and self._times and self.output_path:
            self.save()
        super().close()


class _Track:
    """The frames in which one array changes, with the offset and size of its values.

    Offsets into the data and sizes are in 4-byte words.
    """

    def __init__(self) -> None:
        self.seen: Any = None
        self.frames: list[int] = []
        self.offsets: list[int] = []
        self.sizes: list[int] = []


def _equal_sizes(track: _Track, free: np.ndarray) -> Iterator[tuple[int, list[int]]]:
    """Yield (size, offsets) for each run of frames whose values have the same size, in words.

    Each offset comes once.
    """
    seen: set[int] = set()
    size = 0
    places: list[int] = []
    for place, count in zip(track.offsets, track.sizes, strict=True):
        if not count or place in seen or not free[place]:
            continue
        seen.add(place)
        if count != size and places:
            yield size, places
            places = []
        size = count
        places.append(place)
    if places:
        yield size, places


def _png_words(pixels: np.ndarray) -> np.ndarray:
    """Return an image as the bytes of a PNG file, padded to whole 4-byte words."""
    data = png_bytes(pixels)
    return np.frombuffer(data + bytes(-len(data) % 4), np.float32)


def _short(sizes: list[int]) -> list[int] | int:
    """Return a single number if all sizes are equal, else the list of sizes."""
    return sizes[0] if len(set(sizes)) == 1 else sizes
