"""The command line flags of programs with a viewer: --viewer, --headless, --record, --refresh."""

from __future__ import annotations

import argparse
import os
import sys

from ._video import CODECS

ENDINGS = (".html", ".nprec", ".png", *CODECS)


def add_arguments(parser: argparse.ArgumentParser, default: int, unit: str) -> None:
    """Add --viewer, --headless, --record and --refresh to a parser.

    Args:
        parser: the parser of a program.
        default: the number of `unit` to run without --headless.
        unit: what the number counts, such as "training iterations" or "frames".
    """
    parser.add_argument(
        "--headless",
        type=int,
        metavar="N",
        help=f"run without a window for this many {unit} (in a window: {default})",
    )
    parser.add_argument(
        "--viewer",
        choices=("gl", "viser", "html", "file", "null"),
        help="the viewer (default gl; null with --headless)",
    )
    parser.add_argument(
        "--record",
        metavar="PATH",
        help=f"write the run to a file that ends in {', '.join(ENDINGS)}",
    )
    parser.add_argument(
        "--refresh", type=int, metavar="N", help="show every N-th training iteration"
    )
    parser.set_defaults(default_count=default)


def check_arguments(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    """Check the flags, including --plot. On an error, exit the program with a message.

    Sets args.headless to the number of frames to run without a window, and args.live to whether a
    user watches the run.
    """
    args.live = args.headless is None and args.viewer in (None, "gl", "viser")
    if args.headless is None:
        args.headless = args.default_count
    if args.headless < 0:
        parser.error(f"--headless: expected a number >= 0, got {args.headless}")
    if args.refresh is not None and args.refresh < 1:
        parser.error(f"--refresh: expected a number >= 1, got {args.refresh}")
    name = os.path.splitext(os.path.basename(sys.argv[0]))[0]
    if args.viewer in ("html", "file") and not args.record:
        args.record = f"{name}{'.html' if args.viewer == 'html' else '.nprec'}"
    args.refuse = parser.error
    if args.record:
        ending = os.path.splitext(args.record)[1].lower()
        if ending not in ENDINGS:
            parser.error(f"--record: expected an ending of {', '.join(ENDINGS)}: {args.record}")
        if not os.path.isdir(os.path.dirname(os.path.abspath(args.record))):
            parser.error(f"--record: the folder of {args.record} does not exist")
    if getattr(args, "plot", None):
        _check_plot(parser, args.plot)


def _check_plot(parser: argparse.ArgumentParser, path: str) -> None:
    """Exit the program before its run if matplotlib cannot write the image."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        parser.error("--plot needs matplotlib: pip install 'novaphy[demos]'")
    formats = Figure().canvas.get_supported_filetypes()
    if os.path.splitext(path)[1].removeprefix(".").lower() not in formats:
        parser.error(f"--plot: expected a name that ends in {', '.join(formats)}, got {path}")
    if not os.path.isdir(os.path.dirname(os.path.abspath(path))):
        parser.error(f"--plot: the folder of {path} does not exist")
