"""Parameters as rows of numbers, and a function that maps each row to a loss."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._core import Error
from .._core.nova import Tape, Tensor, active_tape, ones, random_normal, tensor

if TYPE_CHECKING:
    from .._core.solvers import GradientInfo
    from ..nova import AdjointRecord

Numbers = NDArray[np.float64]
Theta = Tensor | ArrayLike | Mapping[str, Tensor | ArrayLike]
Sigma = ArrayLike | Mapping[str, ArrayLike]
# The user's function: maps rows of parameters {worlds, ...} to losses {worlds}.
Function = Callable[..., Tensor]


def normal_numbers(count: int, width: int, seed: int, stream: int = 0) -> Numbers:
    """Return standard normal numbers {count, width}.

    A number depends only on seed, stream, row and column.
    """
    return random_normal((count, width), seed=seed, stream=stream).numpy().astype(np.float64)


@contextmanager
def outside_of_tapes() -> Iterator[Tape | None]:
    """Suspend the active tape, so that another tape can record. Yields the suspended tape."""
    tape = active_tape()
    if tape is not None:
        tape.__exit__(None, None, None)
    try:
        yield tape
    finally:
        if tape is not None:
            tape.__enter__()


class Parameters:
    """Parameters and their standard deviations, as flat numbers {n}.

    A tensor {n} or {1, n} is one entry without a name. A dict has named entries of any shape.
    """

    def __init__(self, user: str, theta: Theta, sigma: Sigma) -> None:
        self.user = user
        self.named = isinstance(theta, Mapping)
        given = dict(theta) if isinstance(theta, Mapping) else {"": theta}
        self.tensors = {name: self._tensor(name, entry) for name, entry in given.items()}
        self.size = sum(entry.size for entry in self.tensors.values())
        if self.size == 0:
            raise ValueError(f"{user}, theta: expected at least one parameter, got none")
        self.shapes = {name: tuple(entry.shape) for name, entry in self.tensors.items()}
        self.start: NDArray[np.float32] = np.concatenate(
            [entry.numpy().ravel() for entry in self.tensors.values()]
        )
        if not np.isfinite(self.start).all():
            raise ValueError(f"{user}, theta: expected finite numbers, got {self.start}")
        self.sigma = self._deviations(sigma)
        moved = np.float32(self.start + 0.01 * self.sigma) != self.start
        if not moved.all():
            k = int(np.argmin(moved))
            raise ValueError(
                f"{user}, sigma: expected deviations of at least 1e-5 of the parameter, which "
                f"float32 resolves, got {self.sigma[k]:g} for the parameter {self.start[k]:g}"
            )

    def _label(self, name: str) -> str:
        return f"{self.user}, theta[{name!r}]" if self.named else f"{self.user}, theta"

    def _tensor(self, name: str, entry: Tensor | ArrayLike) -> Tensor:
        if not isinstance(entry, Tensor):
            entry = tensor(self._array(self._label(name), entry, np.float32))
        if entry.dtype.name != "float32":
            raise TypeError(f"{self._label(name)}: expected float32, got {entry.dtype.name}")
        if self.named:
            return entry
        if entry.ndim == 2 and entry.shape[0] == 1:
            return entry.reshape(entry.size)
        if entry.ndim != 1:
            raise ValueError(f"{self._label(name)}: expected {{n}} or {{1, n}}, got {entry.shape}")
        return entry

    @staticmethod
    def _array(label: str, given: Any, dtype: Any) -> NDArray[Any]:
        try:
            return np.asarray(given, dtype)
        except (TypeError, ValueError):
            raise TypeError(f"{label}: expected numbers, got {given!r}") from None

    def _deviations(self, sigma: Sigma) -> Numbers:
        """Return sigma of each parameter."""
        user, shapes = self.user, self.shapes
        if isinstance(sigma, Mapping):
            if set(sigma) != set(shapes):
                raise ValueError(
                    f"{user}, sigma: expected the entries {list(shapes)}, as theta, got "
                    f"{list(sigma)}"
                )
            given = {
                name: self._array(f"{user}, sigma[{name!r}]", sigma[name], np.float64)
                for name in shapes
            }
        else:
            one = self._array(f"{user}, sigma", sigma, np.float64)
            if self.named and one.ndim > 0:
                raise ValueError(f"{user}, sigma: expected a number or a dict, got {one.shape}")
            given = dict.fromkeys(shapes, one)
        parts = []
        for name, shape in shapes.items():
            part = given[name]
            if part.ndim > 0 and part.shape not in (shape, (1, *shape)):
                raise ValueError(
                    f"{user}, sigma: expected a number or the shape {shape} of theta, got "
                    f"{part.shape}"
                )
            parts.append(np.broadcast_to(part.reshape(-1), int(np.prod(shape))))
        flat = np.concatenate(parts)
        if not (np.isfinite(flat) & (flat > 0)).all():
            raise ValueError(f"{user}, sigma: expected positive finite numbers, got {sigma!r}")
        return flat

    def rows(self, numbers: NDArray[np.float32], *, leaves: bool = False) -> Any:
        """Return rows {worlds, n} in the form that f takes: a tensor, or a dict of tensors."""
        made, at = {}, 0
        for name, shape in self.shapes.items():
            width = int(np.prod(shape))
            part = numbers[:, at : at + width].reshape(len(numbers), *shape)
            where = self.tensors[name].device
            made[name] = tensor(np.ascontiguousarray(part), device=where, requires_grad=leaves)
            at += width
        return made if self.named else made[""]

    def split(self, flat: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Return flat numbers {n} as a dict of arrays with the shapes of theta's entries."""
        ends = np.cumsum([int(np.prod(shape)) for shape in self.shapes.values()])
        parts = np.split(flat, ends[:-1])
        return {
            name: part.reshape(shape)
            for (name, shape), part in zip(self.shapes.items(), parts, strict=True)
        }

    def natural(self, flat: NDArray[Any]) -> Any:
        """Return flat numbers in the form of theta: an array {n}, or a dict of arrays."""
        return self.split(flat) if self.named else flat


class Slopes(NamedTuple):
    """Losses {worlds}, gradients {worlds, n} by parameters in units of sigma, and their label."""

    losses: Numbers
    gradients: Numbers
    info: GradientInfo | None


class Losses:
    """The user's function f, called with at most `batch` rows of parameters at a time."""

    def __init__(self, f: Function, parameters: Parameters, batch: int | None = None) -> None:
        if batch is not None and batch < 1:
            raise ValueError(f"{parameters.user}, batch: expected a number >= 1, got {batch}")
        if not callable(f):
            raise TypeError(f"{parameters.user}, f: expected a function, got {type(f).__name__}")
        self.f, self.parameters, self.batch = f, parameters, batch
        self.user = parameters.user

    def of_the_code(self) -> Losses | None:
        """Return the losses of f with contact_gradient="code"; None: f has no such argument."""
        try:
            known = inspect.signature(self.f).parameters
        except (TypeError, ValueError):
            return None
        if "contact_gradient" not in known:
            return None
        return Losses(partial(self.f, contact_gradient="code"), self.parameters, self.batch)

    def points(self, moves: Numbers) -> NDArray[np.float32]:
        """Return theta + moves * sigma for moves {worlds, n} in units of sigma."""
        return (self.parameters.start + moves * self.parameters.sigma).astype(np.float32)

    def _parts(self, moves: Numbers) -> Iterator[tuple[int, NDArray[np.float32]]]:
        points = self.points(moves)
        step = self.batch or len(points)
        for first in range(0, len(points), step):
            yield first, points[first : first + step]

    def _call(self, rows: Any, count: int) -> Tensor:
        losses = self.f(rows)
        if not isinstance(losses, Tensor):
            raise TypeError(
                f"{self.user}, f: expected a Tensor of losses, got {type(losses).__name__}"
            )
        if tuple(losses.shape) != (count,):
            raise ValueError(
                f"{self.user}, f: expected losses {{{count}}}, one of each row of theta, got the "
                f"shape {tuple(losses.shape)}"
            )
        return losses

    def _check(self, what: str, found: Numbers, first: int, points: NDArray[np.float32]) -> Numbers:
        finite = np.isfinite(found).reshape(len(found), -1).all(axis=1)
        if not finite.all():
            row = int(np.argmin(finite))
            raise ValueError(
                f"{self.user}, f: expected finite {what}, got {found[row]} in row {first + row}, "
                f"theta = {points[row]}"
            )
        return found

    def values(self, moves: Numbers) -> Numbers:
        """Return the losses {worlds} at theta + moves * sigma, moves {worlds, n}."""
        found = []
        for first, points in self._parts(moves):
            losses = self._call(self.parameters.rows(points), len(points))
            found.append(self._check("losses", losses.numpy().astype(float), first, points))
        return np.concatenate(found)

    def slopes(self, moves: Numbers) -> Slopes:
        """Return losses, gradients and GradientInfo at theta + moves * sigma.

        The info is that of the last batch.
        """
        # Each batch has its own tape. It is gone before the next batch lets f reuse its memory.
        parts = [self._slopes(first, points) for first, points in self._parts(moves)]
        losses, gradients = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        return Slopes(losses, gradients * self.parameters.sigma, parts[-1].info)

    def record(self) -> AdjointRecord | None:
        """Return the adjoint record at theta; None: the steps of f have no adjoint record."""
        leaves = self.parameters.rows(self.points(np.zeros((1, self.parameters.size))), leaves=True)
        with Tape() as tape:
            losses = self._call(leaves, 1)
            try:
                tape.backward(losses, record=True)
                entries = list(leaves.values()) if self.parameters.named else [leaves]
                return tape.adjoint_record([leaf for leaf in entries if leaf.grad is not None])
            except (NotImplementedError, Error):
                return None

    def _slopes(self, first: int, points: NDArray[np.float32]) -> Slopes:
        """Return losses and gradients of a batch, in the units of theta."""
        leaves = self.parameters.rows(points, leaves=True)
        with Tape() as tape:
            losses = self._call(leaves, len(points))
            if not tape.follows(losses):
                raise ValueError(
                    f"{self.user}, f: expected losses that the tape follows from theta, got "
                    "losses without a gradient path"
                )
            found = self._check("losses", losses.numpy().astype(float), first, points)
            tape.backward(losses, ones((len(points),), device=losses.device))
        each = [
            leaf.grad.numpy().reshape(len(points), -1)
            for leaf in (leaves.values() if self.parameters.named else [leaves])
        ]
        gradients = np.concatenate(each, axis=1).astype(np.float64)
        return Slopes(found, self._check("gradients", gradients, first, points), _info_of(tape))


def _info_of(tape: Tape) -> GradientInfo | None:
    """Return the GradientInfo of a tape; None: the tape has no steps of a solver."""
    try:
        return tape.gradient_info()
    except Error:
        return None
