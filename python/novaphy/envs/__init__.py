"""Environments for training policies: batches of worlds, and Gymnasium interfaces.

`AntWorlds` needs only NovaPhy. `AntEnv` and `AntVectorEnv` need the package gymnasium.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._ant import (
    ACTIONS,
    ANTS,
    FEET,
    OBSERVATIONS,
    VARIED,
    AntWorlds,
    asset_hash,
    check_meta,
    feet,
    observations,
    rotate,
    rotate_back,
)

if TYPE_CHECKING:
    from ._gym import AntEnv, AntVectorEnv

__all__ = [
    "ACTIONS",
    "ANTS",
    "FEET",
    "OBSERVATIONS",
    "VARIED",
    "AntEnv",
    "AntVectorEnv",
    "AntWorlds",
    "asset_hash",
    "check_meta",
    "feet",
    "observations",
    "rotate",
    "rotate_back",
]


def __getattr__(name: str) -> object:
    """Import the classes that need gymnasium at their first use."""
    if name in ("AntEnv", "AntVectorEnv"):
        from . import _gym

        return getattr(_gym, name)
    raise AttributeError(f"module 'novaphy.envs' has no attribute {name!r}")
