"""Packages that only some viewers need, imported when one of them is made."""

from __future__ import annotations

import importlib
from typing import Any


class MissingPackageError(ImportError, RuntimeError):
    """A viewer cannot start: the message says what to install."""


def needs(module: str, extra: str, who: str) -> Any:
    """Import a module; ImportError names the extra of novaphy that brings it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingPackageError(
            f"{who} needs the package {module.partition('.')[0]!r}: "
            f"pip install 'novaphy[{extra}]' ({error})",
            name=module,
        ) from error
