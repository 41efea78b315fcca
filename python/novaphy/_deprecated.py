"""Deprecated names of arguments. Each old name works for one version, with a warning."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def renamed_argument(
    old: str, new: str
) -> Callable[[Callable[Parameters, Result]], Callable[Parameters, Result]]:
    """Make a decorator that accepts an argument by its old name, with a DeprecationWarning.

    Args:
        old: the old name of a keyword argument.
        new: the name in the function's signature.

    Raises:
        TypeError: a call gives both names.
    """

    def decorate(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Result:
            if old in kwargs:
                if new in kwargs:
                    raise TypeError(f"expected {new} or its old name {old}, got both")
                warnings.warn(f"{old} is now called {new}", DeprecationWarning, stacklevel=2)
                kwargs[new] = kwargs.pop(old)
            return function(*args, **kwargs)

        return call

    return decorate
