"""ImportErrors about optional parts of NovaPhy that the build does not have."""

from __future__ import annotations

from . import _core


def require_diff(module: str) -> None:
    """Raise ImportError, which names the CMake option, if the build has no differentiable part."""
    if not _core.has_diff():
        raise _missing(module, "NOVAPHY_WITH_DIFF")


def require_vbd(module: str) -> None:
    """Raise ImportError, which names the CMake option, if the build has no VBD."""
    if not _core.has_vbd():
        raise _missing(module, "NOVAPHY_BUILD_VBD")


def _missing(module: str, option: str) -> ImportError:
    return ImportError(
        f"{module} is not part of this build of NovaPhy: it was configured with "
        f"{option}=OFF. Build with -D{option}=ON.",
        name=module,
    )
