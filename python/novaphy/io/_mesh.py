"""Meshes from files, as NumPy arrays that ModelBuilder takes."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import _core


class Mesh(NamedTuple):
    """Triangles: ``builder.add_cloth_mesh(**mesh._asdict(), density=0.3)``."""

    vertices: NDArray[np.float32]
    """(n, 3) positions."""
    indices: NDArray[np.int32]
    """(m, 3) corners of triangles, counter-clockwise from outside."""


class TetMesh(NamedTuple):
    """Tetrahedra: ``builder.add_soft_mesh(mesh=mesh, density=300.0)``."""

    vertices: NDArray[np.float32]
    """(n, 3) positions."""
    indices: NDArray[np.int32]
    """(m, 4) corners of tetrahedra, of positive volume."""


def _check_opens(path: str | os.PathLike[str]) -> None:
    """Raise the OSError of Python itself: FileNotFoundError, IsADirectoryError, ..."""
    with open(path, "rb"):
        pass


def load_mesh(
    path: str | os.PathLike[str], *, join_vertices: bool = True, drop_degenerate: bool = False
) -> Mesh:
    """Read the triangles of an ``.obj``, ``.stl``, ``.ply`` or ``.dae`` file.

    Needs a build with ``NOVAPHY_WITH_IO=ON`` (`novaphy.has_io`), as wheels are.

    All meshes of the file come as one, each where the nodes of its scene put it. Polygons are cut
    into triangles; points, lines and vertices that no triangle uses are left out. A ``.dae`` says
    its unit and up axis, and comes in metres with z up; the other formats say nothing, and their
    numbers stay as they are: see ``scale`` and ``rot`` of `ModelBuilder.add_cloth_mesh`.

    Args:
        path: The file; the ending of its name says the format.
        join_vertices: Make one vertex of corners at the same position, to the bit. Most formats
            store the corners of each triangle, and without this the mesh falls apart.
        drop_degenerate: Leave out triangles with two corners at the same position instead of
            refusing them.

    Returns:
        ``vertices`` (n, 3) float32 in the order of their first use, ``indices`` (m, 3) int32.

    Raises:
        ImportError: this build has no mesh reader.
        OSError: the file is missing or cannot be opened.
        ValueError: the name ends in something else; the file is broken, or has no triangle; a
            position is not finite; a triangle has two corners in one place.
    """
    if _core.has_io():
        _check_opens(path)
    arrays = _core.io.load_mesh(path, join_vertices=join_vertices, drop_degenerate=drop_degenerate)
    return Mesh(*arrays)


def load_tet_mesh(path: str | os.PathLike[str], *, drop_loose_vertices: bool = False) -> TetMesh:
    """Read the 4-node tetrahedra of a Gmsh MSH 4.1 ASCII file. Every build can.

    The format is the "MSH file format" of https://gmsh.info/doc/texinfo/gmsh.html, what Gmsh writes
    by default. Points, lines, surfaces and physical groups in the file are skipped. Positions keep
    the unit and the axes of the file.

    Args:
        path: The file.
        drop_loose_vertices: Leave out nodes that no tetrahedron uses instead of refusing them.

    Returns:
        ``vertices`` (n, 3) float32 in the order of the file, ``indices`` (m, 4) int32.

    Raises:
        OSError: the file is missing or cannot be opened.
        ValueError: naming the line where there is one: another format, a broken or cut file, an
            empty mesh; a position that is not finite; solids that are no 4-node tetrahedra;
            degenerate or inverted tetrahedra, with how many there are; a face of more than two
            tetrahedra, or of two on one side; a loose vertex.
    """
    _check_opens(path)
    return TetMesh(*_core.io.load_tet_mesh(path, drop_loose_vertices=drop_loose_vertices))
