"""The table of a certificate as text, and its picture as a page or a PNG file."""

from __future__ import annotations

import html
import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ..nova import AdjointRecord
    from ._certificate import Certificate

SHOWN = 8  # largest number of rows of directions, and of margins
GOOD, BAD, WEAK = "#1a7f37", "#c62828", "#9a6700"
SHADES = ("#c6dbef", "#6baed6", "#2171b5", "#08306b")  # colors of the differences, wide to narrow
WIDTH, HEIGHT, LEFT, TOP, BOTTOM = 880, 420, 70, 70, 60


def _number(x: float) -> str:
    return "-" if np.isnan(x) else f"{x:.3g}"


def rows_of_derivatives(of: Certificate) -> list[list[str]]:
    """Return rows of texts: the head of the table, then the derivatives along each direction."""
    head = ["direction", "gradient", *(f"over {e:g}" for e in of.steps), "smoothed", "error"]
    if of.code_gradient is not None:
        head.append("code")
    rows = [head]
    smooth = of.directions @ of.smoothed
    error = np.sqrt(of.directions**2 @ of.standard_error**2)
    for k, direction in enumerate(of.directions):
        axis = np.count_nonzero(direction) == 1
        name = (
            f"parameter {int(np.argmax(direction))}" if axis else "downhill" if k == 0 else "other"
        )
        row = [direction @ of.gradient, *of.differences[:, k], smooth[k], error[k]]
        if of.code_gradient is not None:
            row.append(direction @ of.code_gradient)
        rows.append([name, *map(_number, row)])
    rows.append(["disagreement", "", *map(_number, of.disagreements), "", ""])
    rows[-1] += [""] * (len(head) - len(rows[-1]))
    return rows


def rows_of_facts(of: Certificate) -> list[list[str]]:
    """Return rows (name, text) with the other numbers of a certificate."""
    facts = [["loss", _number(of.loss)]]
    if of.info is not None:
        facts += [["label", of.info.label], ["reason", of.info.reason]]
    facts += [
        ["samples", f"{of.worlds} at a quarter of sigma: cosine {_number(of.cosine)}, length "
         f"{_number(of.length)} of the smoothed gradient"],
        ["tail", f"the longest sample has {_number(of.tail)} median lengths"],
    ]  # fmt: skip
    if of.trust_radius is not None:
        facts.append(
            ["trust radius", f"{_number(of.trust_radius)} sigmas downhill ({of.limited_by})"]
        )
    elif of.limited_by is not None:
        facts.append(["trust radius", of.limited_by])
    facts += [
        [f"margin {k}", f"{_number(m.sigmas)} sigmas: {m.what}, {m.pair}, step {m.step}"]
        for k, m in enumerate(of.margins[:SHOWN])
    ]
    if np.isfinite(of.steps_per_contact):
        steps = f"{_number(of.steps_per_contact)} steps of a touch of the stiffest penalty contact"
        facts.append(["contact", steps])
    facts.append(["cost", f"{of.cost:.1f} gradients of {1e3 * of.seconds:.3g} ms"])
    return facts


def text(of: Certificate) -> str:
    """Return the table as text. Derivatives are per sigma."""
    rows = rows_of_derivatives(of)
    widths = [max(len(row[c]) for row in rows) for c in range(len(rows[0]))]
    lines = [f"{of.verdict}: {of.sentence}"]
    for row in rows:
        first, *rest = row
        cells = [
            first.ljust(widths[0]),
            *(x.rjust(w) for x, w in zip(rest, widths[1:], strict=True)),
        ]
        lines.append("  ".join(cells).rstrip())
    lines += [f"{name:13} {value}" for name, value in rows_of_facts(of)]
    return "\n".join(lines)


class _Svg:
    """Draws lines, dots and texts as SVG."""

    def __init__(self) -> None:
        self.parts: list[str] = []

    def line(self, x0: float, y0: float, x1: float, y1: float, color: str, width: float) -> None:
        self.parts.append(
            f'<path d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}" stroke="{color}" '
            f'stroke-width="{width}"/>'
        )

    def dot(self, x: float, y: float, color: str) -> None:
        self.parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{color}"/>')

    def text(self, x: float, y: float, words: str, color: str, size: int) -> None:
        self.parts.append(
            f'<text x="{x:.1f}" y="{y:.1f}" fill="{color}" font-size="{size}">'
            f"{html.escape(words)}</text>"
        )

    def page(self, of: Certificate) -> str:
        def table(rows: list[list[str]]) -> str:
            cells = ("".join(f"<td>{html.escape(x)}</td>" for x in row) for row in rows)
            return "<table>" + "".join(f"<tr>{row}</tr>" for row in cells) + "</table>"

        return (
            '<!DOCTYPE html><meta charset="utf-8"><title>Certificate of a gradient</title>'
            "<style>body{font:14px sans-serif;max-width:56em;margin:1em auto}"
            "td{padding:2px 10px 2px 0;vertical-align:top}</style>"
            f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif">'
            f"{''.join(self.parts)}</svg>{table(rows_of_derivatives(of))}{table(rows_of_facts(of))}"
        )


class _Figure:
    """Draws lines, dots and texts with Matplotlib."""

    def __init__(self) -> None:
        try:
            backend = importlib.import_module("matplotlib.backends.backend_agg")
            figure = importlib.import_module("matplotlib.figure")
        except ImportError as error:
            raise ImportError(
                "Certificate.save: a .png file needs Matplotlib (pip install matplotlib); an .html "
                "file needs no package",
                name="matplotlib",
            ) from error
        self.figure: Any = figure.Figure(figsize=(WIDTH / 100, HEIGHT / 100), dpi=100)
        backend.FigureCanvasAgg(self.figure)
        self.axes = self.figure.add_axes((0, 0, 1, 1))
        self.axes.set(xlim=(0, WIDTH), ylim=(HEIGHT, 0))
        self.axes.axis("off")

    def line(self, x0: float, y0: float, x1: float, y1: float, color: str, width: float) -> None:
        self.axes.plot((x0, x1), (y0, y1), color=color, linewidth=width)

    def dot(self, x: float, y: float, color: str) -> None:
        self.axes.plot((x,), (y,), "o", color=color, markersize=7)

    def text(self, x: float, y: float, words: str, color: str, size: int) -> None:
        self.axes.text(x, y, words, color=color, fontsize=0.72 * size)


def _draw(of: Certificate, on: _Svg | _Figure) -> None:
    """Draw the derivatives along each direction: gradient, differences, smoothed gradient."""
    color = {"of the motion": GOOD, "zero": WEAK, "local": WEAK}.get(of.verdict, BAD)
    on.text(LEFT, 24, of.verdict, color, 20)
    words = of.sentence if len(of.sentence) <= 125 else of.sentence[:122] + "..."
    on.text(LEFT, 46, words, "#24292f", 13)
    slopes, smooth = of.directions @ of.gradient, of.directions @ of.smoothed
    error = np.sqrt(of.directions**2 @ of.standard_error**2)
    values = np.concatenate([of.differences.ravel(), slopes, smooth - error, smooth + error, [0.0]])
    low, high = float(values.min()), float(values.max())
    room = 0.08 * ((high - low) or 1.0)

    def at(value: float) -> float:
        return (
            HEIGHT
            - BOTTOM
            - (HEIGHT - TOP - BOTTOM) * (value - low + room) / (high - low + 2.0 * room)
        )

    on.line(LEFT, at(0.0), WIDTH - 10, at(0.0), "#d0d7de", 1.0)
    for value in (low, 0.0, high):
        if value == 0.0 or abs(at(value) - at(0.0)) > 14.0:
            on.text(6, at(value) + 4, _number(value), "#57606a", 12)
    column = (WIDTH - LEFT - 10) / len(slopes)
    for k, (name, *_rest) in enumerate(rows_of_derivatives(of)[1:-1]):
        x = LEFT + column * k
        on.line(x + 0.1 * column, at(slopes[k]), x + 0.9 * column, at(slopes[k]), BAD, 2.5)
        for e, shade in enumerate(SHADES):
            on.dot(x + column * (0.2 + 0.13 * e), at(of.differences[e, k]), shade)
        middle = x + 0.76 * column
        top, bottom = at(smooth[k] + error[k]) - 4.0, at(smooth[k] - error[k]) + 4.0
        on.line(middle, top, middle, bottom, GOOD, 6.0)
        on.text(x + 0.1 * column, HEIGHT - BOTTOM + 18, name, "#24292f", 12)
    on.text(LEFT, HEIGHT - 12, "line: gradient", BAD, 12)
    wide = " ".join(f"{e:g}" for e in of.steps)
    on.text(LEFT + 110, HEIGHT - 12, f"dots: differences over {wide} sigma", SHADES[2], 12)
    on.text(LEFT + 380, HEIGHT - 12, "bar: smoothed gradient and its standard error", GOOD, 12)


def _save_page(of: Certificate, path: Path, record: AdjointRecord | None) -> None:
    from ..viewer._adjoint import fragment

    on = _Svg()
    _draw(of, on)
    shown = "" if record is None else fragment(record)
    path.write_text(on.page(of) + shown, encoding="utf-8")


def _save_png(of: Certificate, path: Path, record: AdjointRecord | None) -> None:
    on = _Figure()
    _draw(of, on)
    on.figure.savefig(path)


WRITERS: dict[str, Callable[[Any, Path, Any], None]] = {".html": _save_page, ".png": _save_png}


def save(
    of: Certificate, path: str | os.PathLike[str], record: AdjointRecord | None = None
) -> None:
    """Write the picture as .html or .png. A page also shows the adjoint record, if given.

    ValueError: the path has another extension.
    """
    to = Path(path)
    if to.suffix.lower() not in WRITERS:
        raise ValueError(f"Certificate.save, path: expected .html or .png, got {to}")
    WRITERS[to.suffix.lower()](of, to, record)
