"""Import of packages that only some viewers need."""

from __future__ import annotations

import importlib
from typing import Any


class MissingPackageError(ImportError, RuntimeError):
    """Raised if a viewer cannot start; the message says what to install."""


def needs(module: str, extra: str, who: str) -> Any:
    """Import a module. ImportError: the module is missing; the message names the extra."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingPackageError(
            f"{who} needs the package {module.partition('.')[0]!r}: "
            f"pip install 'novaphy[{extra}]' ({error})",
            name=module,
        ) from error
