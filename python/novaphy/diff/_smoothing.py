"""smoothed: the mean of a function over normal samples of its parameters, with a gradient."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from .._core.nova import Tape, Tensor, grad_enabled, sum, tensor
from ._parameters import Losses, Parameters, normal_numbers, outside_of_tapes

if TYPE_CHECKING:
    from ._parameters import Function, Numbers, Sigma, Theta


class Estimate(NamedTuple):
    """A smoothed gradient {n} per sigma, estimated from samples, with its statistics."""

    gradient: Numbers
    standard_error: Numbers
    alpha: float  # weight of the first-order estimate, 0 to 1
    clipped: float  # share of the sample gradients that were shortened
    tail: float  # length of the longest sample gradient in units of the median length

    def entries(self, parameters: Parameters) -> dict[str, Any]:
        """Return the entries for the argument `info` of smoothed, in units and form of theta."""
        sigma, form = parameters.sigma, parameters.natural
        return {
            "gradient": form(self.gradient / sigma),
            "standard_error": form(self.standard_error / sigma),
            "alpha": self.alpha,
            "clipped": self.clipped,
            "tail": self.tail,
        }


def check_worlds(user: str, worlds: int, antithetic: bool = True) -> None:
    """Raise ValueError if there are too few samples, or an odd number of antithetic samples."""
    if not isinstance(worlds, int | np.integer):
        raise TypeError(f"{user}, worlds: expected an integer, got {type(worlds).__name__}")
    least, what = (4, "an even number") if antithetic else (2, "a number")
    if worlds < least or (antithetic and worlds % 2):
        raise ValueError(f"{user}, worlds: expected {what} >= {least}, got {worlds}")


def draw(worlds: int, width: int, seed: int, antithetic: bool) -> Numbers:
    """Return normal samples {worlds, width} of variance 1. Antithetic: rows are pairs w, -w."""
    if not antithetic:
        return normal_numbers(worlds, width, seed)
    half = normal_numbers(worlds // 2, width, seed)
    return np.stack([half, -half], axis=1).reshape(worlds, width)


def zeroth_order(losses: Numbers, w: Numbers, antithetic: bool) -> Numbers:
    """Return terms {samples, n}, whose mean is the zeroth-order gradient per sigma.

    `samples` is the number of antithetic pairs, or the number of worlds without pairs.
    """
    if antithetic:
        return 0.5 * (losses[0::2] - losses[1::2])[:, None] * w[0::2]
    # The mean loss of the other samples is the baseline, so that the estimate has no bias.
    return ((losses - losses.mean()) * (len(w) / (len(w) - 1)))[:, None] * w


def first_order(gradients: Numbers, antithetic: bool) -> Numbers:
    """Return terms {samples, n}, whose mean is the first-order gradient.

    `samples` is the number of antithetic pairs, or the number of worlds without pairs.
    """
    return 0.5 * (gradients[0::2] + gradients[1::2]) if antithetic else gradients


def tail_of(gradients: Numbers) -> float:
    """Return the length of the longest row divided by the median length; 1 if all rows are 0."""
    lengths = np.linalg.norm(gradients, axis=1)
    largest, median = lengths.max(), np.median(lengths)
    if largest == 0.0:
        return 1.0
    return float(largest / median) if median > 0.0 else float("inf")


def clip_to_median(gradients: Numbers) -> tuple[Numbers, float]:
    """Scale longer rows to the median length. Return all rows, and the part that was scaled."""
    lengths = np.linalg.norm(gradients, axis=1)
    median = np.median(lengths)
    longer = lengths > median
    if median == 0.0 or not longer.any():
        return gradients, 0.0
    factor = np.where(longer, median / np.maximum(lengths, 1e-300), 1.0)
    return gradients * factor[:, None], float(longer.mean())


def mean_and_error(terms: Numbers) -> tuple[Numbers, Numbers]:
    """Return the mean {n} of rows and the standard error {n} of the mean."""
    return terms.mean(axis=0), terms.std(axis=0, ddof=1) / np.sqrt(len(terms))


def _estimate(
    losses: Numbers,
    gradients: Numbers | None,
    w: Numbers,
    order: int | str,
    antithetic: bool,
    clip: str | None,
) -> Estimate:
    """Return the smoothed gradient from losses and gradients of samples; see smoothed."""
    zeroth = zeroth_order(losses, w, antithetic)
    g0, e0 = mean_and_error(zeroth)
    if order == 0 or gradients is None:
        return Estimate(g0, e0, 0.0, 0.0, tail_of(zeroth))
    tail, clipped = tail_of(gradients), 0.0
    if order == 1:
        if clip == "median":
            gradients, clipped = clip_to_median(gradients)
        return Estimate(*mean_and_error(first_order(gradients, antithetic)), 1.0, clipped, tail)
    first = first_order(gradients, antithetic)
    g1, e1 = mean_and_error(first)
    v0, v1 = float((e0**2).sum()), float((e1**2).sum())
    apart = float(np.linalg.norm(g1 - g0))
    alpha = 0.0 if apart > 3.0 * np.sqrt(v0 + v1) else v0 / (v0 + v1) if v0 + v1 > 0.0 else 1.0
    mixed = mean_and_error(alpha * first + (1.0 - alpha) * zeroth)
    return Estimate(*mixed, alpha, clipped, tail)


def _linear_model(parameters: Parameters, value: float, slope: Numbers) -> Tensor:
    """Record value + slope . (theta - theta0): a tensor with this value, gradient and tangent."""
    total = None
    parts = parameters.split(slope.astype(np.float32))
    for name, entry in parameters.tensors.items():
        by = tensor(parts[name], device=entry.device)
        moved = sum((entry - entry.detach()) * by)
        total = moved if total is None else total + moved.to(total.device)
    assert total is not None
    return total + tensor([value], device=total.device).reshape(total.shape)


def _check_choices(order: Any, clip: Any) -> None:
    if order not in (0, 1, "mixed"):
        raise ValueError(f'smoothed, order: expected 0, 1 or "mixed", got {order!r}')
    if clip not in ("median", None):
        raise ValueError(f'smoothed, clip: expected "median" or None, got {clip!r}')


def smoothed(
    f: Function,
    theta: Theta,
    sigma: Sigma,
    worlds: int = 64,
    order: Literal[0, 1, "mixed"] = 0,
    antithetic: bool = True,
    clip: Literal["median"] | None = "median",
    seed: int = 0,
    batch: int | None = None,
    info: dict[str, Any] | None = None,
) -> Tensor:
    """Return the mean of f(theta + sigma w) over normal samples w, with the gradient of the mean.

    The active tape records the result with the smoothed gradient as its derivative. A sample's
    numbers depend only on the seed and the indices of sample and parameter. Therefore two calls use
    the same samples, and every `batch` gives the same bits. Source: arXiv 2202.00817 (2022).

    Args:
        f: maps parameters {worlds, n} to losses {worlds}, a Tensor. For a dict theta, f takes a
            dict of tensors {worlds, ...}. Other values of f are constants.
        theta: the parameters: {n} or {1, n}, or a dict of entries of any shape, float32.
        sigma: the standard deviation of the samples, in the units of theta: a number, or an array
            of theta's shape.
        worlds: the number of samples.
        order: 0: estimate the gradient from losses. 1: average the gradients of f. "mixed": the
            mean of both with the least variance, or order 0 if they are 3 standard errors apart.
        antithetic: use the samples +w and -w in rows 2 i and 2 i + 1.
        clip: "median": for order 1, shorten long sample gradients (per sigma) to median length.
        seed: the seed of the samples.
        batch: the number of samples in one call of f; None: all.
        info: a dict that gets "gradient" and "standard_error", in the units and the form of theta.
            Further entries are "alpha" (weight of order 1), "clipped" (share of clipped samples)
            and "tail" (length of the longest sample gradient in median lengths).

    Returns:
        A Tensor with one value, float32, on the device of theta's first entry.

    Raises:
        TypeError: theta is not float32, or f returns no Tensor.
        ValueError: theta has no parameter, or sigma is not positive and finite or does not fit.
        ValueError: losses have another shape or are not finite (the message has the row), or the
            losses do not depend on theta by recorded operations.
    """
    _check_choices(order, clip)
    check_worlds("smoothed", worlds, antithetic)
    parameters = Parameters("smoothed", theta, sigma)
    w = draw(worlds, parameters.size, seed, antithetic)
    with outside_of_tapes() as tape:
        on_tape = tape is not None and _follows(tape, parameters)
        wanted = on_tape or info is not None
        losses, gradients = _sample(Losses(f, parameters, batch), w, order if wanted else 0)
    value = float(losses.mean())
    if wanted:
        found = _estimate(losses, gradients, w, order, antithetic, clip)
        if info is not None:
            info.update(found.entries(parameters))
        if on_tape:
            return _linear_model(parameters, value, found.gradient / parameters.sigma)
    return tensor([value], device=next(iter(parameters.tensors.values())).device)


def _sample(losses_of: Losses, w: Numbers, order: int | str) -> tuple[Numbers, Numbers | None]:
    """Return the losses of samples, and their gradients for order 1 and "mixed"."""
    if order == 0:
        return losses_of.values(w), None
    if not grad_enabled():
        raise ValueError(
            f"smoothed, info: expected order 0 inside of no_grad, got a call with order {order!r}"
        )
    losses, gradients, _ = losses_of.slopes(w)
    return losses, gradients


def _follows(tape: Tape, parameters: Parameters) -> bool:
    return any(tape.follows(entry) for entry in parameters.tensors.values())
