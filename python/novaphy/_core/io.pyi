"""Types of novaphy.io's native part."""

import os

import numpy as np
from numpy.typing import NDArray

def load_mesh(
    path: str | bytes | os.PathLike[str],
    *,
    join_vertices: bool = True,
    drop_degenerate: bool = False,
) -> tuple[NDArray[np.float32], NDArray[np.int32]]: ...
def load_tet_mesh(
    path: str | bytes | os.PathLike[str], *, drop_loose_vertices: bool = False
) -> tuple[NDArray[np.float32], NDArray[np.int32]]: ...
