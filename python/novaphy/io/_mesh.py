"""Reads meshes from files as NumPy arrays for ModelBuilder."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core


class Mesh(NamedTuple):
    """A triangle mesh, for ``builder.add_cloth_mesh(**mesh._asdict(), density=0.3)``."""

    vertices: NDArray[np.float32]
    """(n, 3) positions, in the unit of the mesh."""
    indices: NDArray[np.int32]
    """(m, 3) corners of triangles, counter-clockwise from outside."""


class TetMesh(NamedTuple):
    """A tetrahedral mesh, for ``builder.add_soft_mesh(mesh=mesh, density=300.0)``."""

    vertices: NDArray[np.float32]
    """(n, 3) positions, in the unit of the mesh."""
    indices: NDArray[np.int32]
    """(m, 4) corners of tetrahedra, of positive volume."""


def height_field(heights: ArrayLike, cell_x: float, cell_y: float | None = None) -> Mesh:
    """Make the triangle mesh of a terrain from a grid of heights.

    The front of the mesh is the upper side. A terrain encloses no volume, so it has no mass. Attach
    the terrain to the world (body -1), or to a body with ``density=0``:
    ``builder.add_shape_mesh(-1, mesh=height_field(z, 0.25), cfg=...)``.

    Args:
        heights: {rows, columns} (m), at least 2 x 2. The coordinate x grows with the column by
            ``cell_x``, and y with the row by ``cell_y``. The origin is the middle of the grid.
        cell_x: distance between neighboring columns (m).
        cell_y: distance between neighboring rows (m). None: ``cell_x``.

    Returns:
        A Mesh with rows * columns vertices, row by row, and two triangles per cell. The two
        triangles share the diagonal from the corner with the smallest x and y.

    Raises:
        ValueError: the shape does not fit, a height is not finite, or a distance is not > 0.
    """
    z = np.asarray(heights, dtype=np.float32)
    if z.ndim != 2 or min(z.shape) < 2:
        raise ValueError(f"heights: expected at least 2 rows and 2 columns, got {z.shape}")
    if not np.isfinite(z).all():
        j, i = np.argwhere(~np.isfinite(z))[0]
        raise ValueError(f"heights[{j}, {i}]: expected a finite number, got {z[j, i]}")
    cells = {"cell_x": cell_x, "cell_y": cell_x if cell_y is None else cell_y}
    for name, cell in cells.items():
        if not (np.isfinite(cell) and cell > 0):
            raise ValueError(f"{name}: expected a finite number > 0, got {cell}")
    rows, columns = z.shape
    x = (np.arange(columns) - (columns - 1) / 2) * cells["cell_x"]
    y = (np.arange(rows) - (rows - 1) / 2) * cells["cell_y"]
    vertices = np.stack([*np.meshgrid(x, y), z], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)
    right, up = 1, columns
    of_cell = np.array([(0, right, right + up), (0, right + up, up)])
    triangles = corner.reshape(-1, 1, 1) + of_cell
    return Mesh(vertices, triangles.reshape(-1, 3).astype(np.int32))


def _check_opens(path: str | os.PathLike[str]) -> None:
    """Open a file, so that a failure raises Python's own OSError (such as FileNotFoundError)."""
    with open(path, "rb"):
        pass


def load_mesh(
    path: str | os.PathLike[str], *, join_vertices: bool = True, drop_degenerate: bool = False
) -> Mesh:
    """Read the triangles of an ``.obj``, ``.stl``, ``.ply``, ``.dae`` or ``.glb`` file.

    Needs a build with ``NOVAPHY_WITH_IO=ON`` (`novaphy.has_io`), as in the wheels.

    All meshes of the file become one mesh, with the transforms of the file's scene nodes. Polygons
    are cut into triangles. Points, lines and vertices without a triangle are left out. A ``.dae``
    file defines its unit and up axis and is converted to meters with z up. Coordinates of other
    formats stay unchanged; see ``scale`` and ``rot`` of `ModelBuilder.add_cloth_mesh`.

    Args:
        path: the file; its extension gives the format.
        join_vertices: merge corners with exactly the same position into one vertex. Most formats
            store the corners of each triangle separately. Without merging, the triangles of such a
            mesh are not connected.
        drop_degenerate: leave out triangles with two corners at the same position. False: raise an
            error for them.

    Returns:
        ``vertices`` (n, 3) float32 in the order of their first use, ``indices`` (m, 3) int32.

    Raises:
        ImportError: this build has no mesh reader.
        OSError: the file is missing or cannot be opened.
        ValueError: the extension is unknown; the file is corrupt, or has no triangle; a position is
            not finite; a triangle has two corners in one place.
    """
    if _core.has_io():
        _check_opens(path)
    arrays = _core.io.load_mesh(path, join_vertices=join_vertices, drop_degenerate=drop_degenerate)
    return Mesh(*arrays)


def load_tet_mesh(path: str | os.PathLike[str], *, drop_loose_vertices: bool = False) -> TetMesh:
    """Read the 4-node tetrahedra of a Gmsh MSH 4.1 ASCII file. Every build has this reader.

    The format is the "MSH file format" of https://gmsh.info/doc/texinfo/gmsh.html, Gmsh's default.
    Points, lines, surfaces and physical groups of the file are ignored. Positions keep the unit and
    the axes of the file.

    Args:
        path: the file.
        drop_loose_vertices: leave out nodes without a tetrahedron. False: raise an error for them.

    Returns:
        ``vertices`` (n, 3) float32 in the order of the file, ``indices`` (m, 4) int32.

    Raises:
        OSError: the file is missing or cannot be opened.
        ValueError: the file has another format, is corrupt or truncated, or has an empty mesh. A
            position is not finite. A solid element is not a 4-node tetrahedron. Tetrahedra are
            degenerate or inverted. A face has more than two tetrahedra, or two on one side. A
            vertex belongs to no tetrahedron. The message has the line of the file, if known.
    """
    _check_opens(path)
    return TetMesh(*_core.io.load_tet_mesh(path, drop_loose_vertices=drop_loose_vertices))
