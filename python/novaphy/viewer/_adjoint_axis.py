"""The time axis of an adjoint record, which ViewerGL draws over its image."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ._adjoint import pair_name
from ._overlay import CURVE, INK, curve_coverage, inked, paint, text_coverage

if TYPE_CHECKING:
    from ..nova import AdjointRecord

SIZE = (104, 504)  # pixels: height, width
CURVES = {"norm": (4, 44, CURVE), "h": (48, 88, (0.48, 0.25, 0.63))}  # top, bottom (pixels), RGB
EVENT, SUSPECT, CONTACT = (0.1, 0.5, 0.22), (0.82, 0.26, 0.1), (0.48, 0.53, 0.6)
TICKS = (91, 103)  # pixels: top and bottom of the marks of events
NEAR = 4  # pixels: a click at most this far from a mark selects the mark
SHOWN_CONTACTS = 4
LEGEND = "blue |gradient|, violet H, green events, red suspects, ticks contacts (red: held)"


class AdjointAxis:
    """Curves and marks of an adjoint record over time, and a text about one step.

    Attributes:
        selected: the step that a click selected; None: the step at the time shown.
    """

    def __init__(self, record: AdjointRecord, length: float) -> None:
        """Make the axis of a record; `length` (m) is the length of the longest arrow."""
        self.record, self.length = record, length
        self.selected: int | None = None
        self._times = np.array([row["time"] for row in record.boundaries])
        self._shown = (-np.inf, -np.inf)  # times of the last two frames (s)
        base = np.zeros((*SIZE, 4), np.float32)
        for contact in record.contacts:
            color = SUSPECT if contact["held"] else CONTACT
            paint(base, inked(self._line(contact["time"], *TICKS), color))
        for marks, color in ((record.info.event_list, EVENT), (record.suspects, SUSPECT)):
            for mark in marks:
                paint(base, inked(self._line(self._time_of(mark), 0, SIZE[0]), color))
        for name, (top, bottom, color) in CURVES.items():
            values = [np.nan if row[name] is None else row[name] for row in record.boundaries]
            even = np.interp(self._even(), self._times, values)
            coverage = np.zeros(SIZE, np.float32)
            coverage[top:bottom] = curve_coverage(even, (bottom - top, SIZE[1]))
            paint(base, inked(coverage, color))
        self._base = base

    def _even(self) -> np.ndarray:
        """Return the time of each pixel column (s)."""
        return np.linspace(float(self._times[0]), float(self._times[-1]), SIZE[1])

    def _time_of(self, row: dict[str, Any]) -> float:
        """Return the time (s) of an event, or the start time (s) of a suspect's step."""
        return row["time"] if "time" in row else float(self._times[self._row_of(row["step"])])

    def _row_of(self, step: int) -> int:
        steps = [row["step"] for row in self.record.boundaries]
        return steps.index(step) if step in steps else 0

    def _column(self, time: float) -> int:
        first, last = self._times[[0, -1]]
        part = (time - first) / (last - first) if last > first else 0.0
        return round(min(max(float(part), 0.0), 1.0) * (SIZE[1] - 1))

    def _line(self, time: float, top: int, bottom: int) -> np.ndarray:
        coverage = np.zeros(SIZE, np.float32)
        coverage[top:bottom, self._column(time)] = 1.0
        return coverage

    def select(self, column: float) -> None:
        """Select the step of a suspect or event near a pixel column, else the column's step."""
        marks = [*self.record.suspects, *self.record.info.event_list]
        near = [m["step"] for m in marks if abs(self._column(self._time_of(m)) - column) <= NEAR]
        time = self._even()[round(min(max(column, 0.0), SIZE[1] - 1.0))]
        row = int(np.argmin(np.abs(self._times - time)))
        self.selected = near[0] if near else self.record.boundaries[row]["step"]

    def times_shown(self, time: float) -> tuple[float, float]:
        """Return two times (s): arrows of the steps that start between them are shown at `time`."""
        if self.selected is not None:
            at = float(self._times[self._row_of(self.selected)])
            return at - 2e-7, at
        last = self._shown[1]
        if time != last:
            self._shown = (last if last < time else -np.inf, time)
        return self._shown

    def block(self, time: float) -> np.ndarray:
        """Return the image {h, w, 4} (RGBA) of the axis with a mark at `time` (s), and the text."""
        row = (
            int(np.argmin(np.abs(self._times - time)))
            if self.selected is None
            else self._row_of(self.selected)
        )
        axis = self._base.copy()
        cursor = self._line(float(self._times[row]), 0, SIZE[0])
        cursor[::4] = cursor[1::4] = 0.0
        paint(axis, inked(cursor, INK))
        text = inked(text_coverage(self.lines(row)), INK)
        out = np.zeros((SIZE[0] + text.shape[0], max(SIZE[1], text.shape[1]), 4), np.float32)
        out[: SIZE[0], : SIZE[1]] = axis
        out[SIZE[0] :, : text.shape[1]] = text
        return out

    def lines(self, row: int) -> list[str]:
        """Return the lines of text about the start of a step: its number, events and contacts."""
        here = self.record.boundaries[row]
        step, h = here["step"], here["h"]
        lines = [
            f"step {step}  |gradient| {here['norm']:.4g}  H {'-' if h is None else f'{h:.4g}'}  "
            f"drift {100 * here['drift']:.3g} %"
        ]
        lines += [f"suspect: {s['cause']}" for s in self.record.suspects if s["step"] == step]
        for event in self.record.info.event_list:
            if event["step"] == step:
                lines.append(f"{event['kind']} of {pair_name(event)}")
        contacts = [c for c in self.record.contacts if c["step"] == step]
        for c in contacts[:SHOWN_CONTACTS]:
            lines.append(f"{pair_name(c)}: impulse {_vector(c['impulse'])} N s")
            lines.append(f"  adjoint {_vector(c['adjoint'])}, carried {c['carried']:.4g}")
        if len(contacts) > SHOWN_CONTACTS:
            lines.append(f"and {len(contacts) - SHOWN_CONTACTS} more contacts")
        return [*lines, LEGEND, self.record.info.label]


def _vector(values: Any) -> str:
    return f"({', '.join(f'{v:.4g}' for v in values)})"
