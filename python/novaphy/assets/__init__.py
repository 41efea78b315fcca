"""Bundled robots as URDF and MJCF files.

Use ``builder.add_urdf(novaphy.assets.path("fr3.urdf"))``; `names` lists the files. Masses, frames
and limits of ``fr3.urdf`` are those of franka_description (Apache License 2.0, see NOTICE).
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["names", "path"]

_FOLDER = Path(__file__).resolve().parent


def names() -> list[str]:
    """Return the names of all bundled files, sorted."""
    return sorted(file.name for file in _FOLDER.iterdir() if file.suffix in (".urdf", ".xml"))


def path(name: str) -> Path:
    """Return the path of a bundled file.

    Raises:
        ValueError: the file does not exist; the message lists all names.
    """
    if name not in names():
        raise ValueError(f"name: expected one of {', '.join(names())}, got {name!r}")
    return _FOLDER / name
