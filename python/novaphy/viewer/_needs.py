"""Import of packages that only some viewers need."""

from __future__ import annotations

import importlib
from typing import Any


class MissingPackageError(ImportError, RuntimeError):
    """Raised if a viewer cannot start. The message names the package or library to install."""


def needs(module: str, extra: str, who: str) -> Any:
    """Import and return a module.

    ImportError: the module is missing. The message names `who` needs it and the extra to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingPackageError(
            f"{who} needs the package {module.partition('.')[0]!r}: "
            f"pip install 'novaphy[{extra}]' ({error})",
            name=module,
        ) from error
