"""File access: reading meshes, and writing arrays atomically."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ._mesh import Mesh, TetMesh, height_field, load_mesh, load_tet_mesh

__all__ = [
    "Mesh",
    "TetMesh",
    "atomic_path",
    "height_field",
    "load_mesh",
    "load_tet_mesh",
    "save_npz",
]


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path`. At the end of the block the temporary file replaces
    `path`.

    The temporary name has the same extension. After an exception the temporary file is removed, and
    an existing file at `path` stays unchanged.

    Raises:
        ValueError: the folder of `path` does not exist, or `path` is a folder.
        OSError: the folder is not writable.
    """
    target = Path(path)
    if target.is_dir():
        raise ValueError(f"path: expected a file name, got the folder {target}")
    if target.exists() and not target.is_file():
        raise ValueError(f"path: expected a regular file, {target} is none")
    if not target.parent.is_dir():
        raise ValueError(f"path: the folder {target.parent} does not exist")
    handle, name = tempfile.mkstemp(
        prefix=f".{target.stem}.", suffix=target.suffix, dir=target.parent
    )
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # usual permissions, because mkstemp makes a private file
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def save_npz(path: str | os.PathLike[str], **arrays: Any) -> None:
    """Write named arrays to a compressed ``.npz`` file; the name must end in ``.npz``.

    Arrays may be anything that `numpy.asarray` accepts, including `novaphy.DeviceArray` and
    `nova.Tensor`.
    """
    if Path(path).suffix != ".npz":
        raise ValueError(f"path: expected a name that ends in .npz, got {os.fspath(path)!r}")
    values: dict[str, Any] = {name: np.asarray(value) for name, value in arrays.items()}
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **values)
