#!/usr/bin/env python3
"""Write the pictures and pages of the documentation: the gallery, and the README's animation.

The program runs every demo without a display and stores the last picture. For some demos it also
stores a page that replays the run. Needs novaphy[demos] and ffmpeg.
    PYTHONPATH=build/tests/python tools/viewer/make_pictures.py             # all demos
    PYTHONPATH=build/tests/python tools/viewer/make_pictures.py ball dice   # two demos, and page
    PYTHONPATH=build/tests/python tools/viewer/make_pictures.py --animation
"""

from __future__ import annotations

import argparse
import ast
import html
import subprocess
import sys
import tempfile
from pathlib import Path

from novaphy._command import demos

ROOT = Path(__file__).resolve().parents[2]
IMAGES, PAGES = ROOT / "docs" / "images", ROOT / "docs" / "pages"
ACTORS = ROOT / "python" / "demos" / "data" / "ant" / "rl_policies"
# Demo -> options that leave out work which no picture shows.
OPTIONS = {
    "ant_from_scratch": ["--load", str(ACTORS / "periodic_ant_natural_gait.npz")],
    "ant_walk": ["--headless", "200"],
    "dice": ["--starts", "0"],
    "vbd_wrecking_ball": ["--headless", "78"],
}
# Demos that have a page, with options that keep the page small.
WITH_PAGE = {
    "ant_walk": [],
    "ball": [],
    "cart_pole": ["--refresh", "60"],
    "dice": [],
    "featherstone": ["--refresh", "4"],
    "soft_body": [],
    "vbd_gripper": [],
}
# Scenes of a demo that have separate pictures.
SCENES = {
    "articulated_scenes": {"chain": ["--headless", "240"], "ants": ["--headless", "60"]},
    "vbd_bodies": {"seesaw": ["--headless", "36"], "ragdoll": ["--headless", "48"]},
}
WITHOUT_VIEWER = {"distributed"}  # the demo draws its results itself
WALL = """
## robots from files

`add_urdf` and `add_mjcf` read the robots. `novaphy view FILE` shows a robot
([robots](guide/robots.md)).

![24 robots, each from its own file](images/robots.webp)

The files are in the Python packages example-robot-data, mjlab, roboschool, dm-control, pybullet,
mani-skill, genesis-world and robosuite.
[`tools/viewer/robot_wall.py`](../tools/viewer/robot_wall.py) draws the picture.
"""
ANIMATION = ["--headless", "150", "--refresh", "50"]
STILL, MOVING = "scale=640:-1:flags=area", "fps=20,scale=640:-1:flags=area"


def record(demo: Path, target: Path, *options: str) -> None:
    """Run a demo without a window, and record the picture. Training runs as with a window."""
    code = (
        "import sys, runpy; from novaphy import viewer\n"
        "check = viewer.check_arguments\n"
        "def headless(parser, args): check(parser, args); args.live = False\n"
        "viewer.check_arguments = headless\n"
        "sys.argv = sys.argv[1:]; sys.path.insert(0, sys.argv[0].rpartition('/')[0])\n"
        "runpy.run_path(sys.argv[0], run_name='__main__')"
    )
    flag = "--plot" if demo.stem.removeprefix("demo_") in WITHOUT_VIEWER else "--record"
    words = [sys.executable, "-c", code, str(demo), flag, str(target), *options]
    done = subprocess.run(words, capture_output=True, text=True)
    print(f"{demo.stem}: {(done.stdout + done.stderr).strip().splitlines()[-1]}")
    if not target.exists():
        raise SystemExit(f"{demo.name} wrote no picture: {done.stderr}")


def convert(source: Path, target: Path, filters: str, quality: int) -> None:
    """Convert a picture or video to a small WebP file."""
    words = ["ffmpeg", "-loglevel", "error", "-y", "-i", str(source), "-vf", filters]
    words += ["-c:v", "libwebp", "-q:v", str(quality), "-loop", "0", str(target)]
    subprocess.run(words, check=True)
    print(f"{target.relative_to(ROOT)}: {target.stat().st_size / 1e3:.0f} kB")


def sentence(path: Path) -> str:
    """Return the first line of a demo's docstring."""
    return ast.get_docstring(ast.parse(path.read_text("utf-8"))).splitlines()[0]


def write_pages() -> None:
    """Write docs/gallery.html, which shows the pages of demos."""
    parts = [
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>NovaPhy</title>',
        "<style>body { max-width: 960px; margin: 2em auto; padding: 0 1em; color: #21262f;",
        "  font: 16px/1.5 system-ui, sans-serif; }",
        "iframe { width: 100%; height: 480px; border: 0; }</style>\n</head>\n<body>",
        "<h1>NovaPhy, in motion</h1>",
        "<p>Drag to turn the view, drag with the right button to move it, and zoom by the wheel.",
        "Each replay is one file, which <code>--record run.html</code> writes.</p>",
    ]
    for name, path in demos().items():
        if (PAGES / f"{name}.html").exists():
            parts += [
                f"<h2>{name}</h2>\n<p>{html.escape(sentence(path))}</p>",
                f'<iframe src="pages/{name}.html" loading="lazy" title="{name}"></iframe>',
            ]
    text = "\n".join([*parts, "</body>\n</html>"]) + "\n"
    (ROOT / "docs" / "gallery.html").write_text(text, encoding="utf-8")


def write_gallery() -> None:
    """Write docs/gallery.md: every demo that has a picture."""
    lines = [
        "# Gallery",
        "",
        "Do not edit this page: `tools/viewer/make_pictures.py` writes it. Each command opens a",
        "window. With `--record run.html` the demo writes a page that replays the run",
        "([viewers](guide/viewers.md)). [gallery.html](gallery.html) shows the stored replays. A",
        "browser opens this file from disk.",
    ]
    for name, path in demos().items():
        if not (IMAGES / f"demo_{name}.webp").exists():
            continue
        source = path.resolve().relative_to(ROOT).as_posix()
        page = f" · [replay](pages/{name}.html)" if (PAGES / f"{name}.html").exists() else ""
        lines += [
            "",
            f"## {name}",
            "",
            sentence(path),
            "",
            f"![The last frame of the demo {name}](images/demo_{name}.webp)",
            "",
            f"`novaphy run {name}` · [source](../{source}){page}",
        ]
        for scene in SCENES.get(name, {}):
            picture = f"images/demo_{name}_{scene}.webp"
            lines += ["", f"![The last frame of the scene {scene}]({picture})", ""]
            lines += [f"`novaphy run {name} {scene}`"]
    text = "\n".join(lines) + "\n" + WALL
    (ROOT / "docs" / "gallery.md").write_text(text, encoding="utf-8")


def main() -> None:
    """Write the files that the command line asks for."""
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
            for scene, options in SCENES.get(name, {}).items():
                picture = Path(folder) / f"{name}_{scene}.png"
                record(found[name], picture, scene, *options)
                convert(picture, IMAGES / f"demo_{name}_{scene}.webp", STILL, 80)
            if name in WITH_PAGE:
                page, options = PAGES / f"{name}.html", OPTIONS.get(name, [])
                PAGES.mkdir(exist_ok=True)
                record(found[name], page, *options, *WITH_PAGE[name])
                print(f"{page.relative_to(ROOT)}: {page.stat().st_size / 1e3:.0f} kB")
    write_gallery()
    write_pages()


if __name__ == "__main__":
    main()
