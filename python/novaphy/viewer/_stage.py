"""Stage: shows a simulation in the viewers that --viewer, --headless and --record request."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from .._core import Contacts, Model, SimState
from ._base import ArrayLike, Slider, Viewer
from ._needs import MissingPackageError
from ._scene import f32
from ._video import CODECS

if TYPE_CHECKING:
    from ._file import ViewerFile

EARLIER = 32  # number of earlier iterations whose paths stay visible
PATH_POINTS = 241  # largest number of points that are drawn of a path
OLDEST, RECENT = f32([0.80, 0.84, 0.89]), f32([0.33, 0.53, 0.78])
PRESENT, TARGET = (0.86, 0.15, 0.10), (0.80, 0.08, 0.15)
RECORDED_SIZE = (960, 540)
KEPT = 1800  # number of last frames of a simulation that a window replays at the end

# A function that returns the frames of a rollout as pairs (time (s), state).
Frames = Callable[[], Iterable[tuple[float, SimState]]]


class Stage:
    """Shows a simulation, or the iterations of a training, in the viewers that the flags select.

    In a window, frames are shown at the frame rate: space pauses, N steps, and R restarts the
    simulation. Without a window, frames are computed as fast as possible. At the end the window
    replays the last rollout or simulation until the user closes it. Closing the window ends the
    display, not the program.

        with Stage(args, model) as stage:
            for frames in stage.runs(args.headless):            # again at every reset
                state = model.state()
                for frame in frames:
                    ...                                         # one frame of simulation
                    stage.show(frame / 60, state)
    """

    def __init__(
        self,
        args: argparse.Namespace,
        model: Model | None,
        *,
        fps: float = 60.0,
        refresh: int = 1,
        look: tuple[ArrayLike, ArrayLike] | None = None,
        path_width: float = 0.015,
        viewers: Sequence[Viewer] | None = None,
    ) -> None:
        """Make the viewers.

        Args:
            args: the result of parse_args, after check_arguments.
            model: the simulated model; None for a recording.
            fps: frames per second of simulated time.
            refresh: show every N-th training iteration, unless --refresh overrides it.
            look: (position of the camera, target of the camera) (m).
            path_width: width of drawn paths (m).
            viewers: use these viewers and ignore the flags.
        """
        self.fps = fps
        self.refresh = args.refresh or refresh
        self.path_width = path_width
        self._screen: Any = None  # the viewer with a window, or with a served page
        self._waits = False  # whether the program keeps the frame rate for a user at the screen
        self._picture: tuple[Any, str] | None = None  # viewer and path of a requested .png
        self._earlier: dict[str, deque[np.ndarray]] = {}
        self._paths: dict[str, np.ndarray] = {}
        self._again: Callable[[], None] | None = None  # the function that replay() repeats
        self._begin_again = False
        self._shown: deque[tuple[float, dict[str, np.ndarray]]] = deque(maxlen=KEPT)
        self._due = 0.0
        self.viewers = list(viewers) if viewers is not None else self._make(args)
        self._audience = self.viewers  # the viewers that get the frames
        for viewer in self.viewers:
            if model is not None:
                viewer.set_model(model)
            if look is not None:
                viewer.look_at(*look)

    def _make(self, args: argparse.Namespace) -> list[Viewer]:
        from . import create_viewer

        made: list[Viewer] = []
        ending = os.path.splitext(args.record or "")[1].lower()
        if ending in (".html", ".nprec"):
            kind = "html" if ending == ".html" else "file"
            made.append(create_viewer(kind, output_path=args.record))
        painter: Any = None
        try:
            if args.viewer == "viser":
                self._screen = create_viewer("viser")
                made.append(self._screen)
            elif args.live:
                self._screen = painter = create_viewer("gl")
                painter.waits = True  # show every frame of a rollout, without skipping
                made.append(painter)
        except MissingPackageError as error:
            print(f"{error}; going on without a window", file=sys.stderr)
        self._waits = self._screen is not None and args.live
        if ending == ".png" or ending in CODECS:
            try:
                if painter is None:
                    width, height = RECORDED_SIZE
                    painter = create_viewer("gl", headless=True, width=width, height=height)
                    made.append(painter)
                if ending == ".png":
                    self._picture = (painter, args.record)
                else:
                    painter.start_video(args.record, self.fps)
            except MissingPackageError as error:
                args.refuse(f"--record: {error}")
        return made

    def mark(self, point: ArrayLike, radius: float = 0.05, name: str = "target") -> None:
        """Show a target point {3} (m) as a sphere of radius `radius` (m)."""
        for viewer in self.viewers:
            viewer.log_points(name, [point], radius, TARGET)

    def follow(self, body: int | None) -> None:
        """Make the cameras track a body of the model (Viewer.follow)."""
        for viewer in self.viewers:
            viewer.follow(body)

    def set_shape_colors(self, shapes: ArrayLike, colors: ArrayLike) -> None:
        """Set colors {n, 3} or {n, 4} of shapes {n} of the model (Viewer.set_shape_colors)."""
        for viewer in self.viewers:
            viewer.set_shape_colors(shapes, colors)

    def runs(self, count: int) -> Iterator[Iterator[int]]:
        """Yield a simulation, and a new one after every reset by the user.

        A simulation is an iterator over its frames 1, 2, ..., `count`. The iterator yields a frame
        when the simulation should advance, so it waits while the user pauses.
        """
        self._begin_again = True
        while self._begin_again:
            self._begin_again = False
            self._shown.clear()
            yield self._frames(count)

    def _frames(self, count: int) -> Iterator[int]:
        for frame in range(1, count + 1):
            self._wait_while_paused()
            if self._take_reset():
                self._begin_again = True
                return
            yield frame

    def turns(self) -> Iterator[int]:
        """Yield the numbers 0, 1, ... of passes of a program's loop, until the window is closed.

        A reset restarts at 0. Without a window only pass 0 runs.
        """
        turn = 0
        yield turn
        while self._waits and self._screen.is_running():
            turn = 0 if self._take_reset() else turn + 1
            yield turn

    def add_slider(self, name: str, low: float, high: float, value: float) -> Slider:
        """Add a slider for a number (Viewer.add_slider)."""
        viewer: Viewer = self._screen or next(iter(self.viewers), Viewer())
        return viewer.add_slider(name, low, high, value)

    def show(self, t: float, state: SimState, contacts: Contacts | None = None) -> None:
        """Show a state at time `t` (s), and its contacts."""
        for viewer in self._open():
            viewer.begin_frame(t)
            viewer.log_state(state)
            if contacts is not None:
                viewer.log_contacts(contacts, state)
            viewer.end_frame()
        if self._waits and self._again is None:
            fields = {name: getattr(state, name) for name in ("body_q", "particle_q")}
            self._shown.append((t, {name: rows.numpy() for name, rows in fields.items()}))
        self._pace()

    def show_recording(self, recording: ViewerFile) -> None:
        """Show a recording: its drawings and states."""
        self._again = partial(self._play_recording, recording)
        self._again()

    def _play_recording(self, recording: ViewerFile) -> None:
        def start() -> Iterator[int]:
            for viewer in self._open():
                recording.show_start(viewer)
            yield from range(recording.frame_count)

        for frame in self._until_end(start):
            for viewer in self._open():
                recording.show_frame(viewer, frame)
            self._pace()

    def _play_shown(self) -> None:
        for t, arrays in self._until_end(lambda: self._shown):
            for viewer in self._open():
                viewer.begin_frame(t)
                viewer.log_state_arrays(arrays)
                viewer.end_frame()
            self._pace()

    def _until_end(self, start: Callable[[], Iterable[Any]]) -> Iterator[Any]:
        """Yield the items of start(), again from the start after every reset."""
        again = True
        while again:
            again = False
            for item in start():
                self._wait_while_paused()
                if self._take_reset():
                    again = True
                    break
                yield item

    def _pace(self) -> None:
        """In a window, wait until the next frame is due."""
        if self._waits and self._screen.is_running():
            self._due = max(self._due + 1.0 / self.fps, time.perf_counter() - 1.0 / self.fps)
            time.sleep(max(0.0, self._due - time.perf_counter()))

    def apply_forces(self, state: SimState) -> None:
        """Add the force of a drag with the pointer to a state's forces; clear the forces before."""
        for viewer in self._open():
            viewer.apply_forces(state)

    def iteration(
        self,
        number: int,
        loss: float,
        frames: Frames,
        paths: Mapping[str, np.ndarray] | Callable[[], Mapping[str, np.ndarray]],
        last: bool = False,
    ) -> None:
        """Show every `refresh`-th iteration of a training: play its rollout and draw its paths.

        The paths of earlier iterations stay visible and fade.

        Args:
            number: index of the iteration.
            loss: loss of the iteration's rollout.
            frames: returns the times and states of the rollout.
            paths: points {n, 3} (m) by name, or a function that returns them.
            last: show the iteration in any case.
        """
        for viewer in self.viewers:
            viewer.log_scalar("iteration", number)
            viewer.log_scalar("loss", loss)
        if not self.viewers or (number % self.refresh and not last):
            return
        for name, points in (paths() if callable(paths) else paths).items():
            self._draw_path(name, np.asarray(points, np.float32))
        self._again = partial(self._play, frames)
        self._again()

    def _draw_path(self, name: str, points: np.ndarray) -> None:
        earlier = self._earlier.setdefault(name, deque(maxlen=EARLIER))
        if name in self._paths:
            earlier.append(self._paths[name])
        if len(points) > PATH_POINTS:
            points = points[np.round(np.linspace(0, len(points) - 1, PATH_POINTS)).astype(int)]
        self._paths[name] = points.copy()
        for viewer in self._open():
            if earlier:
                ages = np.linspace(0.0, 1.0, len(earlier) + 1)[1:, None]
                shades = (1.0 - ages) * OLDEST + ages * RECENT
                viewer.log_lines(
                    f"{name}/earlier",
                    np.concatenate([p[:-1] for p in earlier]),
                    np.concatenate([p[1:] for p in earlier]),
                    np.repeat(shades, [len(p) - 1 for p in earlier], axis=0),
                    0.5 * self.path_width,
                )
            viewer.log_lines(name, points[:-1], points[1:], PRESENT, self.path_width)

    def _play(self, frames: Frames) -> None:
        for t, state in self._until_end(frames):
            self.show(t, state)

    def replay(self) -> None:
        """In a window, replay the last rollout, recording or simulation until the window is closed.

        Recordings to files are finished before, so they do not contain the replay.
        """
        if not self._waits:
            return
        self._audience = [self._screen]
        if hasattr(self._screen, "stop_video"):
            self._screen.stop_video()
        if self._again is None and self._shown:
            self._again = self._play_shown
        while self._waits and self._screen.is_running():
            if self._again is not None:
                self._again()
                self._linger(0.6)
            else:
                self._linger(0.1)

    def _linger(self, seconds: float) -> None:
        end = time.perf_counter() + seconds
        while self._screen.is_running() and time.perf_counter() < end:
            self._screen.end_frame()
            time.sleep(1.0 / self.fps)

    def _wait_while_paused(self) -> None:
        """Wait until a step should run or a reset is requested."""
        while self._waits and self._screen.is_running() and not self._screen.should_step():
            if self._screen.reset_requested:
                return
            self._screen.end_frame()

    def _take_reset(self) -> bool:
        """Return whether a reset is requested, and clear the request."""
        if self._screen is None or not self._screen.reset_requested:
            return False
        self._screen.reset_requested = False
        return True

    def _open(self) -> list[Viewer]:
        return [viewer for viewer in self._audience if viewer.is_running()]

    def close(self) -> None:
        """Write the recordings, and close all viewers."""
        with contextlib.ExitStack() as closing:
            for viewer in self.viewers:
                closing.callback(viewer.close)
            if self._picture is not None and self._picture[0].is_running():
                self._picture[0].save_picture(self._picture[1])

    def __enter__(self) -> Stage:
        """Return the stage, which is closed at the end of the block."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Without an error, replay in a window until it is closed; then close the stage."""
        try:
            if kind is None:
                self.replay()
        finally:
            self.close()
