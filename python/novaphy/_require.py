"""Errors about optional parts that a build lacks."""

from __future__ import annotations

from . import _core


def require_diff(module: str) -> None:
    """Raise ImportError with the CMake option unless the build has the differentiable part."""
    if not _core.has_diff():
        raise _missing(module, "NOVAPHY_WITH_DIFF")


def require_vbd(module: str) -> None:
    """Raise ImportError with the CMake option unless the build has VBD."""
    if not _core.has_vbd():
        raise _missing(module, "NOVAPHY_BUILD_VBD")


def _missing(module: str, option: str) -> ImportError:
    return ImportError(
        f"{module} is not part of this build of NovaPhy: it was configured with "
        f"{option}=OFF. Build with -D{option}=ON.",
        name=module,
    )
