"""Viewers: what a simulation shows and records.

All have the same calls, so a script runs with any of them. This version has ViewerNull (shows
nothing) and ViewerFile (records states to a file).
"""

from __future__ import annotations

from typing import Any

from .._planned import missing_from_module
from ._base import Viewer
from ._file import ViewerFile
from ._null import ViewerNull

__all__ = ["Viewer", "ViewerFile", "ViewerNull", "create_viewer"]

_NOT_BUILT = ("gl", "rerun", "viser")


def create_viewer(kind: str, **options: Any) -> Viewer:
    """Make a viewer by name: "null" or "file"; options go to its constructor.

    NotImplementedError for "gl", "viser" and "rerun", which this version does not have; ValueError
    for any other name.
    """
    if kind == "null":
        return ViewerNull(**options)
    if kind == "file":
        return ViewerFile(**options)
    if kind in _NOT_BUILT:
        raise NotImplementedError(f"create_viewer: this version has no {kind!r} viewer")
    raise ValueError(f"create_viewer, kind: expected 'null' or 'file', got {kind!r}")


def __getattr__(name: str) -> object:
    """Say of a planned viewer that it is not built."""
    raise missing_from_module("novaphy.viewer", name)
