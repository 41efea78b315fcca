"""Solvers. The differentiable solvers need a build with NOVAPHY_WITH_DIFF=ON."""

from __future__ import annotations

from .._core import has_diff, has_vbd
from .._core.solvers import (
    FeatherstoneAnalyticControlSensitivity,
    SolverBase,
    SolverFeatherstone,
    SolverSemiImplicit,
)
from .._planned import explain_members, missing_from_module
from .._require import require_diff, require_vbd

__all__ = [
    "FeatherstoneAnalyticControlSensitivity",
    "SolverBase",
    "SolverFeatherstone",
    "SolverSemiImplicit",
]

if has_vbd():
    from .._core.solvers import SolverVBD, VbdResidual, VbdSelfContacts

    __all__ += ["SolverVBD", "VbdResidual", "VbdSelfContacts"]

if has_diff():
    from .._core.solvers import (
        DiffFeatherstoneSolver,
        DiffSemiImplicitSolver,
        DiffSolverConfig,
        GradientInfo,
    )

    __all__ += [
        "DiffFeatherstoneSolver",
        "DiffSemiImplicitSolver",
        "DiffSolverConfig",
        "GradientInfo",
    ]

if has_diff() and has_vbd():
    from .._core.solvers import DiffSolverVBD

    VbdGradientInfo = GradientInfo  # the older name, from when only VBD had a GradientInfo
    __all__ += ["DiffSolverVBD", "VbdGradientInfo"]

explain_members(SolverBase, base="SolverBase")


def __getattr__(name: str) -> object:
    """Explain why a solver is missing: the build lacks it, or it is not supported."""
    if name in (
        "DiffFeatherstoneSolver",
        "DiffSemiImplicitSolver",
        "DiffSolverConfig",
        "DiffSolverVBD",
        "GradientInfo",
        "VbdGradientInfo",
    ):
        require_diff(f"novaphy.solvers.{name}")
    if name in (
        "SolverVBD",
        "VbdResidual",
        "VbdSelfContacts",
        "DiffSolverVBD",
        "VbdGradientInfo",
    ):
        require_vbd(f"novaphy.solvers.{name}")
    raise missing_from_module("novaphy.solvers", name)
