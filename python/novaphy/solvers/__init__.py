"""Solvers. The differentiable ones need a build with NOVAPHY_WITH_DIFF=ON."""

from __future__ import annotations

from .._core import has_diff
from .._core.solvers import SolverBase, SolverSemiImplicit

__all__ = ["SolverBase", "SolverSemiImplicit"]

if has_diff():
    from .._core.solvers import DiffSemiImplicitSolver, DiffSolverConfig

    __all__ += ["DiffSemiImplicitSolver", "DiffSolverConfig"]
else:

    def __getattr__(name: str) -> object:
        """Say why a differentiable solver is not there."""
        if name in ("DiffSemiImplicitSolver", "DiffSolverConfig"):
            from .._require import require_diff

            require_diff(f"novaphy.solvers.{name}")
        raise AttributeError(f"module 'novaphy.solvers' has no attribute '{name}'")
