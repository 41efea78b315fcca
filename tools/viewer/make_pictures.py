#!/usr/bin/env python3
"""Write the pictures of the documentation: docs/gallery.md, and the README's animation.

Runs every demo without a display and keeps the last picture. Needs novaphy[demos] and ffmpeg.

    PYTHONPATH=build/tests/python tools/viewer/make_pictures.py             # all of them
    PYTHONPATH=build/tests/python tools/viewer/make_pictures.py ball dice   # these, and the page
    PYTHONPATH=build/tests/python tools/viewer/make_pictures.py --animation
"""

from __future__ import annotations

import argparse
import ast
import subprocess
import sys
import tempfile
from pathlib import Path

from novaphy._command import demos

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
# Options that leave out what no picture shows.
OPTIONS = {"dice": ["--starts", "0"]}
ANIMATION = ["--headless", "150", "--refresh", "50"]
STILL, MOVING = "scale=640:-1:flags=area", "fps=20,scale=640:-1:flags=area"


def record(demo: Path, target: Path, *options: str) -> None:
    """Run a demo and record it. Its window is not opened, and it trains as in one."""
    code = (
        "import sys, runpy; from novaphy import viewer\n"
        "check = viewer.check_arguments\n"
        "def headless(parser, args): check(parser, args); args.live = False\n"
        "viewer.check_arguments = headless\n"
        "sys.argv = sys.argv[1:]; sys.path.insert(0, sys.argv[0].rpartition('/')[0])\n"
        "runpy.run_path(sys.argv[0], run_name='__main__')"
    )
    words = [sys.executable, "-c", code, str(demo), "--record", str(target), *options]
    done = subprocess.run(words, capture_output=True, text=True)
    print(f"{demo.stem}: {(done.stdout + done.stderr).strip().splitlines()[-1]}")
    if not target.exists():
        raise SystemExit(f"{demo.name} wrote no picture: {done.stderr}")


def convert(source: Path, target: Path, filters: str, quality: int) -> None:
    """Write a small WebP."""
    words = ["ffmpeg", "-loglevel", "error", "-y", "-i", str(source), "-vf", filters]
    words += ["-c:v", "libwebp", "-q:v", str(quality), "-loop", "0", str(target)]
    subprocess.run(words, check=True)
    print(f"{target.relative_to(ROOT)}: {target.stat().st_size / 1e3:.0f} kB")


def write_page() -> None:
    """Write docs/gallery.md: every demo that has a picture."""
    lines = [
        "# Gallery",
        "",
        "Written by `tools/viewer/make_pictures.py`; do not edit. Each command opens a window;",
        "`--record run.html` writes a page that replays the run ([viewers](guide/viewers.md)).",
    ]
    for name, path in demos().items():
        if not (IMAGES / f"demo_{name}.webp").exists():
            continue
        text = ast.get_docstring(ast.parse(path.read_text("utf-8")))
        source = path.resolve().relative_to(ROOT).as_posix()
        lines += [
            "",
            f"## {name}",
            "",
            text.splitlines()[0],
            "",
            f"![the last picture of the demo {name}](images/demo_{name}.webp)",
            "",
            f"`novaphy run {name}` · [source](../{source})",
        ]
    (ROOT / "docs" / "gallery.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    """Write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="demos (default: all)")
    parser.add_argument("--animation", action="store_true", help="only the README's animation")
    args = parser.parse_args()
    found = demos()
    with tempfile.TemporaryDirectory() as folder:
        if args.animation:
            film = Path(folder) / "ball.mp4"
            record(found["ball"], film, *ANIMATION)
            convert(film, IMAGES / "ball.webp", MOVING, 45)
            return
        for name in args.names or found:
            picture = Path(folder) / f"{name}.png"
            record(found[name], picture, *OPTIONS.get(name, []))
            convert(picture, IMAGES / f"demo_{name}.webp", STILL, 80)
    write_page()


if __name__ == "__main__":
    main()
