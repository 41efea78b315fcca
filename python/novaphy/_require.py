"""What a part that is not built says."""

from __future__ import annotations

from . import _core


def require_diff(module: str) -> None:
    """Raise ImportError naming the CMake option unless the differentiable part is built."""
    if not _core.has_diff():
        raise ImportError(
            f"{module} is not part of this build of NovaPhy: it was configured with "
            "NOVAPHY_WITH_DIFF=OFF. Build with -DNOVAPHY_WITH_DIFF=ON.",
            name=module,
        )
