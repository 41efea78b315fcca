"""Viewers, which show or record a simulation.

All viewers have the same methods, so a script works with each of them. ViewerGL draws in a window
or without a display. ViewerViser serves a web page, ViewerHTML writes a page that replays the run,
ViewerFile records to a file, and ViewerNull shows nothing. Packages that only one viewer needs are
imported with that viewer.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from ._base import Slider, Viewer
from ._file import ViewerFile
from ._flags import add_arguments, check_arguments
from ._null import ViewerNull
from ._stage import Stage

if TYPE_CHECKING:
    from ._gl import ViewerGL
    from ._html import ViewerHTML
    from ._viser import ViewerViser

__all__ = [
    "Slider",
    "Stage",
    "Viewer",
    "ViewerFile",
    "ViewerGL",
    "ViewerHTML",
    "ViewerNull",
    "ViewerViser",
    "add_arguments",
    "check_arguments",
    "create_viewer",
]

# Class name -> the module with the class, which is imported at the first use of the name.
_LATER = {"ViewerGL": "_gl", "ViewerHTML": "_html", "ViewerViser": "_viser"}
_KINDS = {
    "gl": "ViewerGL",
    "viser": "ViewerViser",
    "html": "ViewerHTML",
    "file": "ViewerFile",
    "null": "ViewerNull",
}


def create_viewer(kind: str, **options: Any) -> Viewer:
    """Make a viewer by name: "gl", "viser", "html", "file" or "null".

    `options` are the arguments of the viewer's constructor. ValueError: an unknown kind.
    """
    if kind not in _KINDS:
        expected = ", ".join(map(repr, _KINDS))
        raise ValueError(f"create_viewer, kind: expected one of {expected}, got {kind!r}")
    name = _KINDS[kind]
    cls = globals().get(name) or __getattr__(name)
    viewer: Viewer = cls(**options)
    return viewer


def __getattr__(name: str) -> Any:
    """Import a viewer at its first use."""
    if name in _LATER:
        return getattr(importlib.import_module("." + _LATER[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return every public name, including names that are imported at their first use."""
    return sorted(set(globals()) | set(__all__))
