"""Text and curves over the image, drawn with NumPy, without a window system or font library."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from importlib import resources

import numpy as np

from ._base import ArrayLike
from ._scene import Scene, f32

INK, CURVE = (0.13, 0.15, 0.19), (0.16, 0.44, 0.72)
PAPER = (1.0, 1.0, 1.0, 0.72)
MARGIN = 8  # pixels
BOX = 10  # pixels: from the corner of the image to the text box
CURVE_SIZE = (72, 216)  # pixels: height, width


def _glyphs() -> np.ndarray:
    """Return gray values {95, height, width} of the printable ASCII characters."""
    data = resources.files(__package__).joinpath("assets/font.bin").read_bytes()
    height, width = struct.unpack_from("<II", data)
    values = np.frombuffer(zlib.decompress(data[8:]), np.uint8).reshape(-1, height, width)
    return values.astype(np.float32) / 255.0


FONT = _glyphs()


def text_coverage(lines: Sequence[str]) -> np.ndarray:
    """Return the coverage {h, w} of pixels by ASCII text. Other characters become "?"."""
    _, height, width = FONT.shape
    columns = max(map(len, lines), default=0)
    out = np.zeros((len(lines) * height, columns * width), np.float32)
    for row, line in enumerate(lines):
        for column, letter in enumerate(line):
            code = ord(letter) - 32
            glyph = FONT[code if 0 <= code < len(FONT) else ord("?") - 32]
            y, x = row * height, column * width
            out[y : y + height, x : x + width] = glyph
    return out


def curve_coverage(values: ArrayLike, size: tuple[int, int] = CURVE_SIZE) -> np.ndarray:
    """Return the coverage {h, w} of a curve, on a logarithmic scale if all values are positive.

    A NaN leaves a gap in the curve.
    """
    height, width = size
    y = np.asarray(values, np.float64)
    y = np.log(y) if np.all(y > 0.0) else y
    known = y[np.isfinite(y)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    y = 3.0 + (height - 7.0) * (high - y) / (high - low if high > low else 1.0)
    at = np.interp(np.linspace(0.0, len(y) - 1.0, width + 1), np.arange(len(y)), y)
    top, bottom = np.minimum(at[:-1], at[1:]), np.maximum(at[:-1], at[1:])
    rows = np.arange(height)[:, None]
    away = np.maximum(np.maximum(top - rows, rows - bottom), 0.0)
    return np.nan_to_num(np.clip(1.6 - away, 0.0, 1.0)).astype(np.float32)


def curve_picture(values: ArrayLike) -> np.ndarray:
    """Return an image {h, w, 3}, uint8, of a curve on a white background."""
    coverage = curve_coverage(values)[..., None]
    return np.round(255.0 * (1.0 - coverage * (1.0 - f32(CURVE)))).astype(np.uint8)


def overlay(
    scene: Scene, lines: Sequence[str], curve: str | None, top: Sequence[np.ndarray] = ()
) -> np.ndarray:
    """Return the text box {h, w, 4}, uint8: text, the curve of a scalar, arrays and images.

    top: blocks {h, w, 4} (RGBA) that are placed above the text.
    """
    blocks = [*top, inked(text_coverage(lines), INK)]
    if curve is not None and len(scene.scalars.get(curve, ())) > 1:
        blocks.append(inked(curve_coverage(scene.scalars[curve]), CURVE))
    for name, values in scene.curves.items():
        blocks += [
            inked(text_coverage([name]), INK),
            inked(curve_coverage(values), CURVE),
        ]
    for name, pixels in scene.images.items():
        blocks.append(inked(text_coverage([name]), INK))
        opaque = np.ones((*pixels.shape[:2], 1), np.float32)
        blocks.append(np.dstack([pixels / 255.0, opaque]))
    width = max(block.shape[1] for block in blocks)
    height = sum(block.shape[0] for block in blocks) + MARGIN * (len(blocks) + 1)
    box = np.empty((height, width + 2 * MARGIN, 4), np.float32)
    box[:] = PAPER
    y = MARGIN
    for block in blocks:
        h, w, _ = block.shape
        paint(box[y : y + h, MARGIN : MARGIN + w], block)
        y += h + MARGIN
    return np.ascontiguousarray(np.round(255.0 * box).astype(np.uint8))


def paint(base: np.ndarray, block: np.ndarray) -> None:
    """Blend a block {h, w, 4} over a part `base` of an image; both are RGBA."""
    a = block[..., 3:]
    base[..., :3] = base[..., :3] * (1.0 - a) + block[..., :3] * a
    base[..., 3:] = base[..., 3:] * (1.0 - a) + a


def inked(coverage: np.ndarray, color: Sequence[float]) -> np.ndarray:
    """Return an image {h, w, 4} (RGBA) of one color with the coverage {h, w} as alpha."""
    return np.dstack([np.broadcast_to(f32(color), (*coverage.shape, 3)), coverage])
