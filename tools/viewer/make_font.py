#!/usr/bin/env python3
"""Write the glyphs of the viewers' text to python/novaphy/viewer/assets/font.bin.

The glyphs are the printable ASCII characters of DejaVu Sans Mono, which is free
(https://dejavu-fonts.github.io/License.html). The file has gray values {95, height, width},
compressed. Needs Pillow.
    tools/viewer/make_font.py /usr/share/fonts/truetype/dejavu/DejaVuSansMono.ttf
"""

from __future__ import annotations

import struct
import sys
import zlib
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

SIZE = 14
TARGET = Path(__file__).resolve().parents[2] / "python/novaphy/viewer/assets/font.bin"


def main() -> None:
    """Draw every character into a separate cell, and write the file."""
    font = ImageFont.truetype(sys.argv[1], SIZE)
    ascent, descent = font.getmetrics()
    width, height = round(font.getlength("M")), ascent + descent
    cells = []
    for code in range(32, 127):
        cell = Image.new("L", (width, height))
        ImageDraw.Draw(cell).text((0, 0), chr(code), 255, font)
        cells.append(np.asarray(cell))
    data = struct.pack("<II", height, width) + zlib.compress(np.stack(cells).tobytes(), 9)
    TARGET.write_bytes(data)
    print(f"{TARGET.name}: {len(data)} bytes, {width} x {height} pixels a character")


if __name__ == "__main__":
    main()
