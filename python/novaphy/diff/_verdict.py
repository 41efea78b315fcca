"""The verdict on a gradient, from differences of the loss and from samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from ._parameters import Numbers

STEPS = (1.0, 0.3, 0.1, 0.01)  # step sizes of central differences (sigmas)
# Largest values, relative to the longer vector:
AGREES = 0.2  # distance of gradient and differences over 0.3 sigma, for agreement
SETTLED = 0.25  # change of the differences from 0.3 to 0.1 sigma, for settled differences
AGREES_CLOSELY = 0.05  # distance over 0.01 sigma, for the verdict "local"
CONVERGED = 0.02  # distance over 0.01 sigma, for differences that converge to the gradient
KNOWN = 0.15  # standard error of a smoothed gradient that counts as known
HEAVY = 10.0  # longest sample gradient in median lengths, for samples without a heavy tail
# Smallest values:
APART = 3.0  # time steps between two events that do not disturb differences
SHORT = 10.0  # time steps of a penalty contact that is resolved in time
SEEN = 0.02  # part of the gradient, for a component whose sign is compared
ROUNDING = 2.0**-23  # relative rounding error of a loss in float32


class Evidence(NamedTuple):
    """The numbers behind a verdict. Derivatives are per sigma."""

    slopes: Numbers  # {m}: the gradient's components along the directions
    differences: Numbers  # {4, m}: central differences over STEPS along the directions
    noise: Numbers  # {4}: rounding error of a difference for each of STEPS
    tail: float
    info: Any  # GradientInfo or None
    shift: float | None  # largest change of an event's time, in time steps per sigma
    gradient: Numbers  # {n}
    smoothed: Numbers  # {n}: zeroth-order gradient from samples of deviation 0.25 sigma
    error: Numbers  # {n}: standard error of `smoothed`
    sampled: Numbers  # {m}: the smoothed gradient's components along the directions


def disagreements(of: Evidence) -> Numbers:
    """Return {4}: the distance of gradient and differences minus rounding, for each of STEPS.

    The distance is relative to the longer vector.
    """
    floor = 3.0 * of.noise * np.sqrt(len(of.slopes))
    lengths = np.maximum(np.linalg.norm(of.differences, axis=1), np.linalg.norm(of.slopes))
    apart = np.linalg.norm(of.differences - of.slopes, axis=1)
    return np.maximum(apart - floor, 0.0) / np.maximum(lengths, 1e-300)


def is_hidden(of: Evidence, step: int, part: float) -> bool:
    """Return whether rounding exceeds `part` of both the gradient and the differences of a step."""
    floor = 3.0 * of.noise[step] * np.sqrt(len(of.slopes))
    length = max(np.linalg.norm(of.differences[step]), np.linalg.norm(of.slopes))
    return bool(floor > part * length)


def is_settled(of: Evidence) -> bool:
    """Return whether differences over 0.3 and 0.1 sigma agree up to rounding."""
    _, wide, narrow, _ = of.differences
    floor = 3.0 * of.noise[2] * np.sqrt(len(of.slopes))
    return bool(np.linalg.norm(wide - narrow) <= SETTLED * np.linalg.norm(wide) + floor)


def is_contradicted(of: Evidence) -> bool:
    """Return whether the samples support the gradient, and exclude the differences over 0.3 sigma.

    Differences over 0.3 and 0.1 sigma of a rough loss can agree by chance.
    """
    from_wide = float(np.linalg.norm(of.sampled - of.differences[1]))
    from_slopes = float(np.linalg.norm(of.sampled - of.slopes))
    return from_wide > max(3.0 * float(np.linalg.norm(of.error)), 2.0 * from_slopes)


def is_converging(of: Evidence) -> bool:
    """Return whether the differences converge to the gradient as their step shrinks.

    Central differences of a smooth loss converge with the square of the step. Differences over
    small steps also agree with a gradient that omits the times of contacts, because a small move
    leaves each contact in its time step. The result is False for such a gradient.
    """
    _, wide, narrow, tiny = disagreements(of)
    falls = narrow <= wide * (STEPS[2] / STEPS[1]) and tiny <= CONVERGED
    return bool(falls) and not is_hidden(of, 3, CONVERGED) and not _leaves_times_out(of)


def reversed_component(of: Evidence) -> int | None:
    """Return the direction in which the gradient has the wrong sign; None: no such direction.

    A direction counts if the gradient and the differences have opposite signs. The differences over
    0.3 and 0.1 sigma must agree, and the slope of the samples must be nearer to them. Components
    below 2 % of the gradient do not count, because roughness of the loss can change their sign. The
    direction with the largest error is returned.
    """
    _, wide, narrow, _ = of.differences
    apart = np.abs(wide - of.slopes)
    length = max(float(np.linalg.norm(wide)), float(np.linalg.norm(of.slopes)))
    settled = np.abs(wide - narrow) <= SETTLED * np.abs(wide)
    floor = max(SEEN * length, 3.0 * float(of.noise[1] + of.noise[2]))
    clear = np.minimum(np.abs(wide), np.abs(of.slopes)) > floor
    nearer = np.abs(of.sampled - wide) < np.abs(of.sampled - of.slopes)
    wrong = settled & (wide * of.slopes < 0.0) & clear & nearer
    return int(np.argmax(np.where(wrong, apart, -1.0))) if wrong.any() else None


def is_zero(of: Evidence) -> bool:
    """Return whether gradient and differences are zero up to rounding."""
    return not of.slopes.any() and bool((np.abs(of.differences) <= 3.0 * of.noise[:, None]).all())


def is_known(of: Evidence) -> bool:
    """Return whether the samples determine the smoothed gradient: small error, no heavy tail.

    Losses that rounding makes equal determine nothing.
    """
    length = np.linalg.norm(of.smoothed)
    seen = length > 0.0 or not is_hidden(of, 1, 0.5)
    return bool(seen and np.linalg.norm(of.error) <= KNOWN * length and of.tail <= HEAVY)


def from_smoothed(of: Evidence) -> float:
    """Return the distance of gradient and smoothed gradient, relative to the longer vector."""
    lengths = float(np.linalg.norm(of.gradient)), float(np.linalg.norm(of.smoothed))
    return float(np.linalg.norm(of.gradient - of.smoothed)) / max(*lengths, 1e-300)


def is_apart(of: Evidence) -> bool:
    """Return whether the smoothed gradient is known, and disagrees by more than its error."""
    lengths = float(np.linalg.norm(of.gradient)), float(np.linalg.norm(of.smoothed))
    error = float(np.linalg.norm(of.error)) / max(*lengths, 1e-300)
    return is_known(of) and from_smoothed(of) > AGREES + error


def judge(of: Evidence) -> tuple[str, str]:
    """Return the verdict and a sentence with the reason (see Certificate)."""
    _, at_wide, _, at_tiny = disagreements(of)
    if is_zero(of):
        return "zero", "The loss does not change within one sigma: the motion reaches nothing."
    settled = is_settled(of) and not is_hidden(of, 1, 0.5)
    settled = settled and (at_wide <= AGREES or not is_contradicted(of))
    by_samples = f"{100.0 * from_smoothed(of):.0f} %"
    wrong = reversed_component(of)
    if settled and at_wide <= AGREES and wrong is not None:
        return "biased", (
            f"Differences of the loss agree with the gradient but along direction {wrong}: there "
            f"the slope is {of.differences[1, wrong]:.3g} per sigma, and the gradient says "
            f"{of.slopes[wrong]:.3g}.{_advice(of)}"
        )
    if settled and at_wide <= AGREES:
        return "of the motion", (
            "Differences of the loss over 0.3 sigma agree with the gradient within "
            f"{100.0 * at_wide:.0f} %."
        )
    if is_known(of) and from_smoothed(of) <= AGREES:
        return "of the motion", (
            "Differences of the loss over 0.3 sigma are rough, but the slope of the samples agrees "
            f"with the gradient within {by_samples}."
        )
    if settled and is_converging(of):
        return "local", (
            "The gradient holds for small moves only: differences approach it as their step "
            f"shrinks, and over 0.3 sigma they are {100.0 * at_wide:.0f} % from it."
        )
    if settled:
        return "biased", (
            f"Differences of the loss settle at another slope: over 0.3 sigma they are "
            f"{100.0 * at_wide:.0f} % from the gradient.{_advice(of)}"
        )
    is_biased = is_known(of) and _leaves_times_out(of)
    close = at_tiny <= AGREES_CLOSELY and not is_hidden(of, 3, 1.0)
    if close and of.tail <= HEAVY and not is_biased:
        return "local", (
            "The gradient holds for tiny moves only: differences over 0.01 sigma agree, and those "
            "over 0.1 and 0.3 sigma do not settle."
        )
    if is_apart(of):
        return "biased", (
            f"The slope of the samples is {by_samples} from the gradient.{_advice(of)}"
        )
    return "chaotic", f"The loss is rough at the scale of sigma: {_cause(of)}."


def _leaves_times_out(of: Evidence) -> bool:
    """Return whether contacts begin or end, and the gradient omits changes of their times."""
    return of.info is not None and of.info.events > 0 and not of.info.event_list


def _advice(of: Evidence) -> str:
    if of.info is None:
        return ""
    if _leaves_times_out(of):
        return (
            f" Contacts changed {of.info.events} times, and the gradient leaves their times out: "
            'try contact_gradient="motion" where the solver has it.'
        )
    coarse = ""
    if of.shift is not None and STEPS[1] * of.shift < 1.0:
        coarse = (
            f" {STEPS[1]:g} sigma moves contacts by {STEPS[1] * of.shift:.2g} steps only, so the "
            "losses show the phase of the steps: a larger sigma or a smaller dt would tell more."
        )
    return f' The label is "{of.info.label}".{coarse}'


def _cause(of: Evidence) -> str:
    causes = []
    if is_hidden(of, 1, 0.5):
        causes.append("rounding of the loss hides its slope: take a constant off, or raise sigma")
    if of.tail > HEAVY:
        causes.append(f"the longest gradient of the samples has {of.tail:.3g} median lengths")
    if of.info is not None and of.info.steps_per_contact < SHORT:
        causes.append(
            f"a penalty contact pushes for {of.info.steps_per_contact:.2g} steps only, so softer "
            "contacts or a smaller dt would tell more"
        )
    elif of.info is not None and any(e["kind"] == "spring" for e in of.info.event_list):
        causes.append(
            "the speed behind a penalty contact depends on the phase of its steps, which "
            'penalty_law="mean" removes'
        )
    if of.info is not None and of.info.least_separation < APART:
        causes.append(f"two events are {of.info.least_separation:.2g} steps apart")
    if of.shift is not None and 0.1 * of.shift < 1.0:
        causes.append(
            f"0.1 sigma moves contacts by {0.1 * of.shift:.2g} steps, so a larger sigma or a "
            "smaller dt would tell more"
        )
    if not causes:
        causes.append("differences over 0.1 and 0.3 sigma do not settle")
    return ", and ".join(causes)
