"""Writes images as PNG files."""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np


def png_bytes(pixels: np.ndarray) -> bytes:
    """Return an image {h, w, 3}, uint8, as PNG bytes."""
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 3 * width), np.uint8)  # byte 0 of each row: PNG filter 0 (none)
    rows[:, 1:] = pixels.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b""))
    out = b"\x89PNG\r\n\x1a\n"
    for kind, data in chunks:
        out += struct.pack(">I", len(data)) + kind + data
        out += struct.pack(">I", zlib.crc32(kind + data))
    return out


def write_png(path: str | os.PathLike[str], pixels: np.ndarray) -> None:
    """Write an image {h, w, 3}, uint8, to a PNG file."""
    with open(path, "wb") as file:
        file.write(png_bytes(pixels))
