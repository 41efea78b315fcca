"""How far parameters may move until events change their order or vanish.

Event i has the time t_i and the approach speed a_i. When the parameters move along a direction,
t_i and a_i change with the slopes dt_i and da_i. Two events i and j change their order after a move
of |t_i - t_j| / |dt_i - dt_j|. An event vanishes after a move of |a_i| / |da_i|. Moves are in units
of sigma. The slopes are central differences of events in worlds that are moved by ± step sigma.
Source: the trust radius of saltation matrices.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from ._parameters import Numbers

Event = dict[str, Any]


class Margin(NamedTuple):
    """The smallest move of the parameters that changes an event, in any direction."""

    what: str
    step: int  # the time step of the event
    pair: str
    sigmas: float


class Trust(NamedTuple):
    """The moves that change an event (ascending), and the largest move that changes no event."""

    margins: list[Margin]
    radius: float | None  # sigmas downhill; inf: no event limits the move, None: unknown
    limited_by: str
    shift: float | None  # largest change of an event's time, in time steps per sigma


def pair_of(event: Event) -> str:
    """Return a name of the shapes, the particle or the joint of an event."""
    if event["kind"] == "limit":
        return f"joint {event['joint']}"
    if event.get("particle", -1) >= 0:
        shape = max(event["shape0"], event["shape1"])
        return f"particle {event['particle']} and shape {shape}"
    return f"shapes {event['shape0']} and {event['shape1']}"


def _signature(events: list[Event]) -> list[tuple[Any, ...]]:
    """Return the kind and pair of each event, for comparison between worlds.

    Indices of shapes, joints and particles are replaced by their rank among the events, so that
    equal worlds have equal signatures.
    """
    found = []
    for key in ("shape0", "shape1", "joint", "particle"):
        numbers = sorted({e[key] for e in events if e.get(key, -1) >= 0})
        found.append([numbers.index(e[key]) if e.get(key, -1) >= 0 else -1 for e in events])
    return [(e["kind"], *rest) for e, *rest in zip(events, *found, strict=True)]


def by_world(events: list[Event], worlds: int) -> list[list[Event]]:
    """Return the events of each world, in order of time."""
    rows: list[list[Event]] = [[] for _ in range(worlds)]
    for event in events:
        rows[max(event["world"], 0)].append(event)
    return rows


def _with_times(events: list[Event]) -> list[Event]:
    return [event for event in events if np.isfinite(event["time"])]


def trust(base: list[Event], moved: list[list[Event]], step: float, downhill: Numbers) -> Trust:
    """Return how far the parameters may move until the events of a motion change.

    Args:
        base: the events of the motion. Contacts from the start on have no time, and do not count.
        moved: the events of worlds that are moved by +step and -step along direction 0, then along
            direction 1, and so on.
        step: the size of the moves (sigmas).
        downhill: the components {directions} of the unit vector against the gradient.
    """
    base, moved = _with_times(base), [_with_times(events) for events in moved]
    signature, changes = _signature(base), []
    slopes = np.full((len(moved) // 2, 2, len(base)), np.nan)  # of time and approach speed
    for k in range(len(moved) // 2):
        plus, minus = moved[2 * k], moved[2 * k + 1]
        if _signature(plus) != signature or _signature(minus) != signature:
            changes.append(k)
            continue
        for j, key in enumerate(("time", "approach")):
            slopes[k, j] = [
                (a[key] - b[key]) / (2.0 * step) for a, b in zip(plus, minus, strict=True)
            ]
    known = np.isfinite(slopes[:, 0]).all(axis=1)
    steepest = np.sqrt((slopes[known] ** 2).sum(axis=0))  # {2, events}
    along = np.einsum("k,kje->je", downhill[known], slopes[known])
    margins: list[Margin] = []
    radius, limit = np.inf, "nothing"
    for what, event, size, slope, ahead in _changes(base, slopes[known], steepest, along):
        margins.append(Margin(what, event["step"], pair_of(event), _ratio(size, slope)))
        if (reach := _ratio(size, ahead)) < radius:
            radius = reach
            limit = f"{what}: {event['kind']} of {pair_of(event)} in step {event['step']}"
    if changes:
        where = ", ".join(str(k) for k in changes)
        text = f"number or order of events within {step:g} sigma along direction {where}"
        margins.append(Margin("other events", base[0]["step"] if base else 0, text, step))
        if step < radius:
            radius, limit = step, text
    steps = max(
        (np.linalg.norm(slopes[known][:, 0, i]) / _dt(e) for i, e in enumerate(base)), default=0
    )
    margins.sort(key=lambda margin: margin.sigmas)
    return Trust(margins, float(radius), limit, float(steps))


def _dt(event: Event) -> float:
    """Return the length of a step (s) from the time of an event."""
    return float(event["time"] / max(event["step"] + event["phase"], 1e-3))


def _ratio(size: float, slope: float) -> float:
    return float(size / slope) if slope > 0.0 else float("inf")


def _changes(base: list[Event], slopes: Numbers, steepest: Numbers, along: Numbers) -> Any:
    """Yield each change of the list of events that a move of the parameters can cause.

    A change has five values: its name, the event, the distance to the change, the largest slope of
    the distance, and the slope in the downhill direction.
    """
    if not len(slopes):
        return
    for i, event in enumerate(base):
        size = abs(event["approach"])
        yield "event vanishes", event, size, steepest[1, i], abs(along[1, i])
        if i + 1 < len(base):
            apart = base[i + 1]["time"] - event["time"]
            closing = np.sqrt(((slopes[:, 0, i + 1] - slopes[:, 0, i]) ** 2).sum())
            ahead = abs(along[0, i + 1] - along[0, i])
            yield "order with the next event", event, apart, closing, ahead
