"""The command `novaphy`: runs demos, shows the installation, and views recordings and meshes."""

from __future__ import annotations

import argparse
import ast
import contextlib
import ctypes.util
import importlib.metadata
import io
import json
import os
import platform
import re
import runpy
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import novaphy

from ._check_gradient import check_function, is_function

COMPLETION = """_novaphy() {
  local current=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]}
  local commands="demos run info check bench replay view completion"
  if [ "$COMP_CWORD" -eq 1 ]; then
    COMPREPLY=($(compgen -W "$commands" -- "$current"))
  elif [ "$COMP_CWORD" -eq 2 ] && [[ " run check bench " == *" ${COMP_WORDS[1]} "* ]]; then
    COMPREPLY=($(compgen -W "$(novaphy demos --names)" -- "$current"))
  elif [ "$before" = --viewer ]; then
    COMPREPLY=($(compgen -W "gl viser html file null" -- "$current"))
  elif [[ "$current" == -* ]]; then
    local flags="--headless --viewer --record --refresh --device --check-grad --plot --help"
    COMPREPLY=($(compgen -W "$flags" -- "$current"))
  else
    COMPREPLY=($(compgen -f -- "$current"))
  fi
}
complete -o filenames -F _novaphy novaphy
"""
VIEWED = (".msh", ".obj", ".stl", ".ply", ".dae", ".glb", ".urdf", ".xml")
# Optional package -> (extra of novaphy that installs the package, what needs the package).
OPTIONAL = {
    "moderngl": ("gl", "ViewerGL"),
    "pyglet": ("gl", "the window of ViewerGL"),
    "imgui-bundle": ("panel", "the panel in the window of ViewerGL"),
    "viser": ("web", "ViewerViser"),
    "matplotlib": ("demos", "--plot of the demos"),
    "tqdm": ("demos", "progress bars"),
    "gymnasium": ("envs", "novaphy.envs as Gymnasium environments"),
}


def demos_folder() -> Path | None:
    """Return the folder of the demos: in the package, or beside the package in a checkout."""
    package = Path(novaphy.__file__).resolve().parent
    for folder in (package / "demos", package.parent / "demos"):
        if folder.is_dir():
            return folder
    return None


def demos() -> dict[str, Path]:
    """Return the files of the demos by name."""
    folder = demos_folder()
    files = sorted(folder.rglob("demo_*.py")) if folder is not None else []
    named = {re.sub("^demo_(diffsim_)?", "", file.stem): file for file in files}
    named.pop("common", None)
    return named


def find_demo(name: str) -> Path:
    """Return the file of a demo. ValueError: no such demo; the message lists all demos."""
    found = demos()
    if name not in found:
        known = ", ".join(found) or "none: this installation has no demos"
        raise ValueError(f"there is no demo {name!r}; there are: {known}")
    return found[name]


def start_demo(path: Path, options: list[str]) -> int:
    """Run a demo in this process as a main program, and return its exit code."""
    argv, folders = sys.argv, list(sys.path)
    sys.argv = [str(path), *options]
    sys.path[:0] = [str(path.parent)]
    try:
        runpy.run_path(str(path), run_name="__main__")
    except SystemExit as end:
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
            return 1
        return int(end.code or 0)
    finally:
        sys.argv, sys.path[:] = argv, folders
    return 0


def list_demos(args: argparse.Namespace) -> int:
    """List the demos."""
    found = demos()
    if args.names:
        print("\n".join(found))
        return 0
    width = max(map(len, found), default=0)
    for name, path in found.items():
        text = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
        print(f"{name:{width}} {text.splitlines()[0] if text else ''}")
    return 0


def run_demo(args: argparse.Namespace) -> int:
    """Run a demo."""
    return start_demo(find_demo(args.demo), args.options)


def check(args: argparse.Namespace) -> int:
    """Compare the gradient of a demo, or of FILE.py:FUNCTION, with differences of the loss."""
    if is_function(args.demo):
        return check_function(args.demo, args.options)
    path = find_demo(args.demo)
    if "check_grad" not in path.read_text("utf-8"):
        raise ValueError(f"check, demo: {args.demo!r} has no gradient")
    return start_demo(path, ["--headless", "0", "--check-grad", *args.options])


def bench(args: argparse.Namespace) -> int:
    """Measure the time of a demo's iteration, or of a frame if the demo has no iterations."""
    from unittest import mock

    from .viewer import Stage

    path = find_demo(args.demo)
    behind = argparse.ArgumentParser(prog="novaphy bench", add_help=False, allow_abbrev=False)
    behind.add_argument("--count", type=int, default=args.count)  # also after the demo's name
    known, options = behind.parse_known_args(args.options)
    if known.count < 4:
        raise ValueError(f"bench, --count: expected a number >= 4, got {known.count}")
    times: list[float] = []

    def note(*_: object, **__: object) -> None:
        times.append(time.perf_counter())

    output = io.StringIO()
    with (
        mock.patch.multiple(Stage, iteration=note, show=note),
        contextlib.redirect_stdout(output),
        contextlib.redirect_stderr(output),
    ):
        start_demo(path, ["--headless", str(known.count), *options])
    if len(times) < 4:
        raise ValueError(f"bench: the demo stopped early: {output.getvalue().strip()}")
    # The first two iterations are left out, because they may record a capture or compile kernels.
    each = np.diff(times)[1:]
    result = {
        "demo": args.demo,
        "iterations": len(times),
        "median_ms": round(1e3 * float(np.median(each)), 4),
        "fastest_ms": round(1e3 * float(each.min()), 4),
        "threads": novaphy.num_threads(),
        "machine": platform.machine(),
        "novaphy": novaphy.__version__,
    }
    print(json.dumps(result))
    return 0


def info(args: argparse.Namespace) -> int:
    """Show what is installed, what is missing, and how to install it."""
    built = [name for name, on in novaphy.build_info().items() if on]
    print(f"novaphy {novaphy.__version__} in {Path(novaphy.__file__).parent}")
    print(f"Python {platform.python_version()}, NumPy {np.__version__}, {platform.platform()}")
    print(f"built with: {', '.join(built)}")
    print("backends:")
    for backend in novaphy.backends():
        state = "in use" if backend.active else backend.error or "not in use"
        print(f"  {backend.name} {backend.version}: {state}, {backend.path or 'built in'}")
    if all(backend.name != "cuda" for backend in novaphy.backends()):
        print(
            "  cuda: missing: CMAKE_ARGS=-DNOVAPHY_WITH_CUDA=ON pip install . (docs/guide/cuda.md)"
        )
    print("devices:")
    for device in novaphy.get_devices():
        print(f"  {device}: {device.name}")
    print(f"threads: {novaphy.num_threads()}")
    cache = os.environ.get("NOVAPHY_CACHE_DIR") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "novaphy"
    )
    print(f"cache of device code: {cache}{'' if os.path.isdir(cache) else ' (not there yet)'}")
    print(f"demos: {demos_folder() or 'none'}")
    print("optional:")
    for package, (extra, what) in OPTIONAL.items():
        try:
            state = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            state = f"missing: pip install 'novaphy[{extra}]'"
        print(f"  {package} ({what}): {state}")
    for program, what in {"ffmpeg": "videos"}.items():
        found = shutil.which(program) or f"missing: apt-get install {program}"
        print(f"  {program} ({what}): {found}")
    egl = ctypes.util.find_library("EGL") or "missing: apt-get install libegl1 libgl1-mesa-dri"
    print(f"  EGL (pictures without a display): {egl}")
    print(f"  display (windows): {os.environ.get('DISPLAY') or 'none: DISPLAY is not set'}")
    return 0


def replay(args: argparse.Namespace) -> int:
    """Show a recording."""
    from .viewer import Stage, ViewerFile

    recording = ViewerFile(os.path.join(os.getcwd(), "unused.nprec"), auto_save=False)
    recording.load_recording(args.file)
    if not recording.frame_count:
        raise ValueError(f"replay, file: {args.file} has no frame")
    steps = np.diff(recording.times)
    steps = steps[steps > 0.0]
    fps = 1.0 / float(np.median(steps)) if steps.size else 60.0
    with Stage(args, None, fps=min(fps, 60.0)) as stage:
        stage.show_recording(recording)
    print(f"{args.file}: {recording.frame_count} frames, {recording.times[-1]:.3f} s")
    return 0


def view(args: argparse.Namespace) -> int:
    """Show a mesh, or a robot with a slider for every joint and control."""
    from ._view import show_mesh, show_robot

    ending = Path(args.file).suffix.lower()
    if ending not in VIEWED:
        hint = f": novaphy replay {args.file}" if ending in (".nprec", ".npz") else ""
        raise ValueError(f"view, file: expected {', '.join(VIEWED)}, got {args.file}{hint}")
    is_robot = ending in (".urdf", ".xml")
    print(f"{args.file}: {show_robot(args) if is_robot else show_mesh(args)}")
    return 0


def completion(args: argparse.Namespace) -> int:
    """Print the tab completion for bash: eval "$(novaphy completion)"."""
    print(COMPLETION, end="")
    return 0


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of the command and its subcommands."""
    from .viewer import add_arguments

    parser = argparse.ArgumentParser(prog="novaphy", description="A differentiable physics engine.")
    parser.add_argument("--version", action="version", version=novaphy.__version__)
    parts = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, function: Callable[[argparse.Namespace], int]) -> Any:
        text = (function.__doc__ or "").splitlines()[0]
        part = parts.add_parser(name, help=text, description=text)
        part.set_defaults(function=function)
        return part

    add("demos", list_demos).add_argument("--names", action="store_true", help="names only")
    for name, function in (("run", run_demo), ("check", check), ("bench", bench)):
        part = add(name, function)
        if name == "bench":
            part.add_argument("--count", type=int, default=20, help="iterations (default 20)")
        needs_one = {"nargs": "?", "default": "ball"} if name != "run" else {}
        text = "a name that `novaphy demos` lists"
        if name == "check":
            text += "; FILE.py:FUNCTION for diff.certify, with theta0 and sigma in the file"
        part.add_argument("demo", help=text, **needs_one)
        rest = part.add_argument("options", nargs=argparse.REMAINDER, help="options of the demo")
        rest.required = False
    add("info", info)
    for name, function, what in (
        ("replay", replay, "a recording: .nprec, or .npz"),
        ("view", view, "a mesh: .msh, .obj, .stl, .ply, .dae, .glb; a robot: .urdf, .xml (MJCF)"),
    ):
        part = add(name, function)
        part.add_argument("file", help=what)
        if name == "view":
            text = "where package://NAME/FILE of a robot may be; may be given several times"
            part.add_argument("--packages", metavar="FOLDER", action="append", help=text)
            text = "also show of a robot: joints, inertia, energy"
            kinds = ("joints", "inertia", "energy")
            part.add_argument("--show", nargs="+", choices=kinds, default=[], help=text)
            text = "a camera of an MJCF file, from whose place the view starts"
            part.add_argument("--camera", metavar="NAME", help=text)
        add_arguments(part, 1, "passes")
    add("completion", completion)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return its exit code. Errors of the user are printed as one line."""
    from .viewer import check_arguments

    parser = make_parser()
    args = parser.parse_args(arguments)
    if args.command in ("replay", "view"):
        check_arguments(parser, args)
    try:
        return int(args.function(args))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        return 0
    except (ValueError, OSError, ImportError, NotImplementedError, novaphy.Error) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
