"""Robots that come with NovaPhy, as URDF and MJCF files.

``builder.add_urdf(novaphy.assets.path("fr3.urdf"))``; `names` lists them. Masses, frames and limits
of ``fr3.urdf`` are those of franka_description (Apache License 2.0, see NOTICE).
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["names", "path"]

_FOLDER = Path(__file__).resolve().parent


def names() -> list[str]:
    """Return the names of the files, sorted."""
    return sorted(file.name for file in _FOLDER.iterdir() if file.suffix in (".urdf", ".xml"))


def path(name: str) -> Path:
    """Return where the file of that name is.

    Raises:
        ValueError: there is no such file; the message has the names.
    """
    if name not in names():
        raise ValueError(f"name: expected one of {', '.join(names())}, got {name!r}")
    return _FOLDER / name
