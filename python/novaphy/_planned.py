"""Names that are agreed and not built yet: asking for one raises an error that says so.

A name leaves the table when it is built; a test fails while it is in both places.
"""

from __future__ import annotations

from collections.abc import Callable

# Owner -> what its missing names belong to -> the names.
PLANNED: dict[str, dict[str, tuple[str, ...]]] = {
    "novaphy": {
        "streams": ("Stream", "ScopedStream", "get_stream"),
        "surface meshes as objects": ("geometry",),
        "helpers for poses and colours": ("utils",),
    },
    "novaphy.solvers": {
        "rigid bodies": ("SolverXPBD", "SolverSequentialImpulse"),
        "articulations": ("SolverMuJoCo",),
    },
    "ModelBuilder": {
        "robots from USD files": ("add_usd",),
    },
}


class PlannedError(NotImplementedError, AttributeError):
    """A planned member of an object was asked for: hasattr(builder, "add_usd") stays False."""


def missing_from_module(module: str, name: str) -> Exception:
    """Return what a module raises for a name that it does not have.

    For a planned one not an AttributeError, which ``from module import name`` would replace by
    "cannot import name".
    """
    planned = _sentence(module, name)
    if planned:
        return NotImplementedError(planned)
    return AttributeError(f"module {module!r} has no attribute {name!r}")


def getattr_of_class(owner: str) -> Callable[[object, str], object]:
    """Make the __getattr__ of a class, which Python asks for what it did not find."""

    def get(self: object, name: str) -> object:
        planned = _sentence(owner, name)
        if planned:
            raise PlannedError(planned)
        raise AttributeError(f"{owner!r} object has no attribute {name!r}")

    return get


def _sentence(owner: str, name: str) -> str | None:
    """Say of a name what it belongs to; None when it is not planned."""
    for part, names in PLANNED[owner].items():
        if name in names:
            return f"{owner}.{name} is planned, not built: it belongs to {part}"
    return None
