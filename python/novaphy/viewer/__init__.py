"""Viewers: what a simulation shows and records.

All have the same calls, so a script runs with any of them. ViewerGL draws in a window or without a
display, ViewerHTML writes a page that replays the run, ViewerFile records to a file, ViewerNull
shows nothing. What only one of them needs is imported when it is made.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from .._planned import missing_from_module
from ._base import Viewer
from ._file import ViewerFile
from ._null import ViewerNull
from ._stage import Stage, add_arguments, check_arguments

if TYPE_CHECKING:
    from ._gl import ViewerGL
    from ._html import ViewerHTML

__all__ = [
    "Stage",
    "Viewer",
    "ViewerFile",
    "ViewerGL",
    "ViewerHTML",
    "ViewerNull",
    "add_arguments",
    "check_arguments",
    "create_viewer",
]

# Name -> the module that has it, imported at its first use.
_LATER = {"ViewerGL": "_gl", "ViewerHTML": "_html"}
_KINDS = {"gl": "ViewerGL", "html": "ViewerHTML", "file": "ViewerFile", "null": "ViewerNull"}
_NOT_BUILT = ("rerun", "viser")


def create_viewer(kind: str, **options: Any) -> Viewer:
    """Make a viewer by name: "gl", "html", "file" or "null"; options go to its constructor.

    NotImplementedError for "viser" and "rerun", which this version does not have; ValueError for
    any other name.
    """
    if kind in _NOT_BUILT:
        raise NotImplementedError(f"create_viewer: this version has no {kind!r} viewer")
    if kind not in _KINDS:
        expected = ", ".join(map(repr, _KINDS))
        raise ValueError(f"create_viewer, kind: expected one of {expected}, got {kind!r}")
    name = _KINDS[kind]
    cls = globals().get(name) or __getattr__(name)
    viewer: Viewer = cls(**options)
    return viewer


def __getattr__(name: str) -> Any:
    """Import a viewer at its first use; say of a planned one that it is not built."""
    if name in _LATER:
        return getattr(importlib.import_module("." + _LATER[name], __name__), name)
    raise missing_from_module("novaphy.viewer", name)


def __dir__() -> list[str]:
    """Every public name, also those that are imported later."""
    return sorted(set(globals()) | set(__all__))
