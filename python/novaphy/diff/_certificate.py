"""Certificates: a gradient is compared with differences and samples, and gets a verdict."""

from __future__ import annotations

import os
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._core import Error
from .._core.nova import grad_enabled
from ._events import Margin, Trust, by_world, trust
from ._parameters import Losses, Parameters, Slopes, normal_numbers, outside_of_tapes
from ._smoothing import check_worlds, draw, mean_and_error, tail_of
from ._verdict import ROUNDING, STEPS, Evidence, disagreements, judge

if TYPE_CHECKING:
    from .._core.solvers import GradientInfo
    from ._parameters import Function, Numbers, Sigma, Theta

PART = 0.25  # standard deviation of the samples, in sigmas
EVENT_STEP = 0.1  # sigmas: how far worlds are moved to difference their events
MOST_DIRECTIONS = 8


@dataclass(frozen=True, eq=False, repr=False)
class Certificate:
    """A verdict on a gradient at one point, with the numbers behind the verdict.

    All derivatives are per sigma: a derivative by parameter i is multiplied by sigma_i.

    verdict, sentence: the verdict, and its reason. The first verdict that holds is taken:

      * Verdict "zero": the loss does not change within one sigma.
      * Verdict "of the motion": settled differences of the loss, or the slope of the samples, are
        within 20 % of the gradient. Differences settle if those over 0.3 and 0.1 sigma agree. A
        component above 2 % of the gradient may not have the opposite sign of settled differences.

      * Verdict "biased": differences or samples settle at another slope.
      * Verdict "local": the gradient is right for small moves only, such as 0.01 sigma.
      * Verdict "chaotic": neither the differences nor the gradients of the samples settle.

    info: the GradientInfo of the gradient, or None without a solver.
    loss, worlds: the loss, and the number of samples.
    gradient, code_gradient: {n}, the gradient, and the gradient with contact_gradient="code" (None
      unless f takes `contact_gradient`).
    directions, steps, differences: central differences {4, m} of the loss along unit directions
      {m, n} over steps {4} (sigmas).
    disagreements: {4}, the distance of gradient and differences, relative to the longer vector.
    smoothed, standard_error: {n}, the zeroth-order gradient from samples of deviation 0.25 sigma.
    cosine, length: the cosine of the angle between gradient and smoothed gradient, and the ratio of
      their lengths.
    tail: the length of the longest sample gradient in units of the median length.
    margins: rows (what, step, pair, sigmas): how far the parameters may move until events change.
    trust_radius, limited_by: how far the parameters may move downhill (sigmas) until the order of
      events changes, and the event that changes. None without a list of events.
    steps_per_contact: for how many steps the stiffest penalty contact pushes; inf without one.
    cost, seconds: the time of the certificate in units of one gradient, and the time of one
      gradient (s).
    """

    verdict: str
    sentence: str
    info: GradientInfo | None
    loss: float
    worlds: int
    gradient: Numbers
    code_gradient: Numbers | None
    directions: Numbers
    steps: Numbers
    differences: Numbers
    disagreements: Numbers
    smoothed: Numbers
    standard_error: Numbers
    cosine: float
    length: float
    tail: float
    margins: list[Margin]
    trust_radius: float | None
    limited_by: str | None
    steps_per_contact: float
    cost: float
    seconds: float

    def __repr__(self) -> str:
        """Return the verdict and the sizes."""
        return f"Certificate({self.verdict!r}, n={self.gradient.size}, worlds={self.worlds})"

    def __str__(self) -> str:
        """Return the table as text."""
        from ._certificate_view import text

        return text(self)

    def print(self) -> None:
        """Print the table."""
        print(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the picture as .html, which needs no package, or as .png, which needs Matplotlib.

        Raises:
            ValueError: the path has another extension.
            ImportError: Matplotlib is not installed.
        """
        from ._certificate_view import save

        save(self, path)


class _Measured(NamedTuple):
    """The measurements of certify. Derivatives are per sigma."""

    at: Slopes
    code: Slopes | None
    directions: Numbers
    differences: Numbers
    noise: Numbers
    samples: Slopes
    w: Numbers  # {worlds, n}: the normal offsets of the samples, variance 1
    events: Trust | None


def certify(
    f: Function, theta: Theta, sigma: Sigma, worlds: int = 64, seed: int = 0
) -> Certificate:
    """Compare the gradient of f with differences and samples of the loss, and give a verdict.

    Args:
        f: maps parameters {worlds, n} to losses {worlds}, a Tensor. For a dict theta, f takes a
            dict of tensors {worlds, ...}. The number of worlds differs between calls, and f must
            give the same bits for the same rows. If f has an argument `contact_gradient`, f is also
            called with contact_gradient="code".
        theta: the parameters: {n} or {1, n}, or a dict of entries of any shape, float32.
        sigma: how far the parameters will move, in the units of theta: a number, or an array of
            theta's shape.
        worlds: the number of samples, an even number.
        seed: the seed of directions and samples.

    Returns:
        The Certificate. `Certificate.print()` prints the certificate as a table.

    Raises:
        TypeError: theta is no float32, sigma has no numbers, worlds is no integer, or f is no
            function or returns no Tensor.
        ValueError: calls of f with the same parameters differ, theta has no parameter, or the
            losses do not depend on theta by recorded operations.
        ValueError: sigma is not positive, not finite or of another shape.
        ValueError: losses have another shape or are not finite (the message has the row), or the
            call is inside of no_grad.
    """
    check_worlds("certify", worlds)
    if not grad_enabled():
        raise ValueError("certify: expected a call outside of no_grad")
    losses_of = Losses(f, Parameters("certify", theta, sigma))
    began = perf_counter()
    with outside_of_tapes():
        at, first = _gradient(losses_of)
        code = losses_of.of_the_code()
        directions = _directions(at.gradients[0], seed)
        of_code = None if code is None else code.slopes(np.zeros((1, losses_of.parameters.size)))
        differences, noise = _differences(losses_of, directions)
        samples, w, events = _samples(losses_of, worlds, seed, at, directions)
        again, second = _gradient(losses_of)
    seconds = min(first, second)
    _check_same(float(at.losses[0]), float(again.losses[0]))
    found = _Measured(at, of_code, directions, differences, noise, samples, w, events)
    return _certificate(found, (perf_counter() - began) / seconds, seconds)


def _certificate(of: _Measured, cost: float, seconds: float) -> Certificate:
    """Return the certificate of measurements."""
    slope, events = of.at.gradients[0], of.events
    smooth, error = _smooth_slope(of.samples.losses, of.w, slope)
    tail = tail_of(of.samples.gradients)
    shift = None if events is None else events.shift
    evidence = Evidence(
        of.directions @ slope, of.differences, of.noise, tail, of.at.info, shift,
        slope, smooth, error, of.directions @ smooth,
    )  # fmt: skip
    verdict, sentence = judge(evidence)
    long, wanted = float(np.linalg.norm(slope)), float(np.linalg.norm(smooth))
    return Certificate(
        verdict=verdict,
        sentence=sentence,
        info=of.at.info,
        loss=float(of.at.losses[0]),
        worlds=len(of.w),
        gradient=slope,
        code_gradient=None if of.code is None else of.code.gradients[0],
        directions=of.directions,
        steps=np.array(STEPS),
        differences=of.differences,
        disagreements=disagreements(evidence),
        smoothed=smooth,
        standard_error=error,
        cosine=float(slope @ smooth / (long * wanted)) if long * wanted > 0.0 else float("nan"),
        length=long / wanted if wanted > 0.0 else float("nan"),
        tail=tail,
        margins=[] if events is None else events.margins,
        trust_radius=None if events is None else events.radius,
        limited_by=None if events is None else events.limited_by,
        steps_per_contact=float("inf") if of.at.info is None else of.at.info.steps_per_contact,
        cost=cost,
        seconds=seconds,
    )


def _gradient(losses_of: Losses) -> tuple[Slopes, float]:
    """Return loss and gradient at theta, and the time that they took (s)."""
    began = perf_counter()
    found = losses_of.slopes(np.zeros((1, losses_of.parameters.size)))
    return found, perf_counter() - began


def _check_same(first: float, then: float) -> None:
    """Raise ValueError if f is not deterministic: if two losses at theta differ."""
    if first != then:
        raise ValueError(
            "certify, f: expected the same loss for the same parameters, got "
            f"{first!r} and then {then!r}"
        )


def _directions(gradient: Numbers, seed: int) -> Numbers:
    """Return orthogonal unit vectors {m, n}: the axes of up to 8 parameters, else 8 directions.

    The first of the 8 directions is against the gradient, and the others are random.
    """
    n = len(gradient)
    if n <= MOST_DIRECTIONS:
        return np.eye(n)
    first = normal_numbers(MOST_DIRECTIONS, n, seed, stream=1)
    if gradient.any():
        first[0] = -gradient / np.linalg.norm(gradient)
    q, r = np.linalg.qr(first.T)
    return (q * np.sign(np.diag(r))).T


def _differences(losses_of: Losses, directions: Numbers) -> tuple[Numbers, Numbers]:
    """Return central differences {4, m} of the loss per sigma, and their rounding errors {4}."""
    m, n = directions.shape
    steps, signs = np.array(STEPS)[:, None, None, None], np.array([1.0, -1.0])[:, None]
    moves = (steps * signs * directions[:, None, :]).reshape(-1, n)
    losses = losses_of.values(moves).reshape(len(STEPS), m, 2)
    # Parameters are rounded to float32, so the actual change is used, not the step.
    points = losses_of.points(moves).astype(np.float64).reshape(len(STEPS), m, 2, n)
    moved = (points[:, :, 0] - points[:, :, 1]) / losses_of.parameters.sigma
    length = np.einsum("emn,mn->em", moved, directions)
    noise = ROUNDING * np.abs(losses).max() / (2.0 * np.array(STEPS))
    return (losses[:, :, 0] - losses[:, :, 1]) / length, noise


def _samples(
    losses_of: Losses, worlds: int, seed: int, at: Slopes, directions: Numbers
) -> tuple[Slopes, Numbers, Trust | None]:
    """Return losses and gradients of antithetic samples at a part of sigma, the samples, and how
    far the events hold. The latter is None where the solver lists no events.

    One call of f takes the samples, and the moves that show how events change.
    """
    w = draw(worlds, losses_of.parameters.size, seed, True)
    if at.info is None or not at.info.event_list:
        return losses_of.slopes(PART * w), w, None
    signs = np.array([1.0, -1.0])[:, None]
    moves = (EVENT_STEP * signs * directions[:, None, :]).reshape(-1, directions.shape[1])
    try:
        losses, gradients, info = losses_of.slopes(np.concatenate([PART * w, moves]))
    except Error as error:  # such as contacts that have not converged
        return losses_of.slopes(PART * w), w, Trust([], None, f"unknown: {error}", None)
    rows = by_world(info.event_list if info is not None else [], worlds + len(moves))[worlds:]
    slope = at.gradients[0]
    downhill = -(directions @ slope) / max(float(np.linalg.norm(slope)), 1e-300)
    events = trust(at.info.event_list, rows, EVENT_STEP, downhill)
    return Slopes(losses[:worlds], gradients[:worlds], info), w, events


def _smooth_slope(losses: Numbers, w: Numbers, gradient: Numbers) -> tuple[Numbers, Numbers]:
    """Return the zeroth-order gradient {n} of antithetic samples, and its standard error {n}.

    The slope of the loss over infinitely many normal samples is the smoothed gradient (Stein's
    lemma). With at least two pairs of samples per parameter, the slope is fitted by least squares,
    which has far less noise than the mean of loss times w. With fewer pairs the mean is used, with
    the gradient as control variate.
    """
    rises, w = 0.5 * (losses[0::2] - losses[1::2]) / PART, w[0::2]
    pairs, n = w.shape
    if pairs < 2 * n:
        mean, error = mean_and_error((rises - w @ gradient)[:, None] * w)
        return gradient + mean, error
    slope = np.asarray(np.linalg.lstsq(w, rises, rcond=None)[0], np.float64)
    variance = ((rises - w @ slope) ** 2).sum() / (pairs - n)
    return slope, np.sqrt(variance * np.diag(np.linalg.inv(w.T @ w)))
