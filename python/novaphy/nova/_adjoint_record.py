"""The record of a backward pass, step by step: a debugger of gradients."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .._core.solvers import GradientInfo

Row = dict[str, Any]
Numbers = NDArray[np.float64]
SUSPECT = 0.01  # drift of H that makes a step suspect, as a part of the largest |H|


class AdjointRecord:
    """The gradient at each step of a rollout, recorded by backward(loss, record=True).

    boundaries: one dict per boundary between two steps. `step` is the step that starts there, and
      `time` its time (s). `norm` is the length of p, the gradient of the loss by positions and
      velocities. `h` is the scalar H = p . f, where f has the velocities and accelerations of the
      step before. A smooth motion keeps H constant. `h` is None after a step in which a contact of
      articulations begins. `drift` is how far the step from this boundary changes H, relative to
      the largest |H|.

    contacts: one dict per step and pushing contact, in the order of time. The keys `step`, `time`
      (s, start of the step), `world`, `shape0` and `shape1` name the contact. `point` (m) and
      `normal` {3} are in the world frame. `held` says whether the derivative keeps point and normal
      constant. `begins` says whether the pair did not push in the step before.

      A contact of a particle in DiffSolverVBD has the index `particle`, and `shape1` is -1. Other
      contacts have `particle` -1.

      `impulse` {3} (N s) acts on shape1, or on the particle. `adjoint` {3} is the derivative of the
      loss by the impulse. `change` {3} is the derivative of the impulse along the unit vector
      against the gradient. `carried` is adjoint . change + moved: the part of the loss's change due
      to this contact. `moved` is the part due to moved times at which the contact begins and ends,
      with contact_gradient="motion", and 0 for landings of articulations.

      A penalty contact pushes over several steps. Its `change` leaves out the effect of the same
      pair's changes in earlier steps. The sum of `carried` over the steps of a pair is the part of
      the derivative that goes through the pair. All particles that touch one shape in one world
      count as one pair.

    suspects: one dict per pair and cause whose drift is above 1 % of the largest |H|, in descending
      order of drift. The keys are `step`, `world`, `shape0`, `shape1`, `drift` and `cause`.
    info: the GradientInfo of the tape.
    """

    def __init__(self, steps: list[Row], info: GradientInfo) -> None:
        """Make the record from the steps of the engine."""
        self.info = info
        self.contacts = _contacts(steps)
        self.boundaries = _boundaries(steps, self.contacts)
        self._springs = {s["number"] for s in steps if s["of_springs"]}
        self.suspects = _suspects(self.boundaries, self.contacts, info.event_list, self._springs)

    def __repr__(self) -> str:
        """Return the sizes."""
        return (
            f"AdjointRecord(steps={len(self.boundaries) - 1}, contacts={len(self.contacts)}, "
            f"suspects={len(self.suspects)})"
        )

    def __str__(self) -> str:
        """Return the suspects and the eight contacts with the largest |carried| as text."""
        lines = [f"{self.info.label}: {self.info.reason}"]
        for s in self.suspects:
            lines.append(f"step {s['step']}: {s['cause']}, H drifts by {100 * s['drift']:.3g} %")
        for c in sorted(self._touches(), key=lambda c: -abs(c["carried"]))[:8]:
            lines.append(f"step {c['step']}: {c['pair']} carried {c['carried']:.4g}")
        return "\n".join(lines)

    def _touches(self) -> list[Row]:
        """Return the contacts. The steps of one penalty contact are one row with their sum."""
        rows, open_ones = list[Row](), dict[Any, Row]()
        for c in self.contacts:
            key = c["world"], c["shape0"], c["shape1"]
            last = open_ones.get(key)
            if last and c["step"] in self._springs and c["step"] - last["end"] in (0, 1):
                last["carried"] += c["carried"]
                last["end"] = c["step"]
                continue
            name = f"particles and shape {c['shape0']}" if c["particle"] >= 0 else pair_of(c)
            rows.append({**c, "pair": name, "end": c["step"]})
            open_ones[key] = rows[-1]
        return rows


def pair_of(row: Row) -> str:
    """Return "shapes A and B", or "particle A and shape B", for the pair of a contact."""
    if row["particle"] >= 0:
        return f"particle {row['particle']} and shape {row['shape0']}"
    return f"shapes {row['shape0']} and {row['shape1']}"


def _times(steps: list[Row]) -> list[float]:
    """Return the times (s) of the boundaries.

    A step whose number is not above the previous one starts a new rollout at number * dt.
    """
    times, now = list[float](), 0.0
    for k, step in enumerate(steps):
        if k == 0 or step["number"] <= steps[k - 1]["number"]:
            now = step["number"] * step["dt"]
        times.append(now)
        now += step["dt"]
    return [*times, now]


def _contacts(steps: list[Row]) -> list[Row]:
    rows, times, before = list[Row](), _times(steps), set[Any]()
    for step, time in zip(steps, times[:-1], strict=True):
        now = {_pair_of_world(c) for c in step["contacts"]}
        for contact in step["contacts"]:
            row = {"step": step["number"], "time": time, **contact}
            row["carried"] = float(np.dot(contact["adjoint"], contact["change"])) + row["moved"]
            row["begins"] = _pair_of_world(row) not in before
            rows.append(row)
        before = now
    return rows


def _smooth_rates(step: Row, hit: bool) -> Numbers | None:
    """Return f = (new velocities, accelerations) of a step; None if unknown or not smooth."""
    if not step["rates"] or (hit and not step["of_springs"]):
        return None
    return np.array(step["rates"])


def _boundaries(steps: list[Row], contacts: list[Row]) -> list[Row]:
    hits = {c["step"] for c in contacts if c["begins"]}
    smooth = [_smooth_rates(s, s["number"] in hits) for s in steps]
    rows = list[Row]()
    for k, time in enumerate(_times(steps)):
        last, step = steps[k - 1] if k else None, steps[k] if k < len(steps) else None
        end = last["end"] if last else []
        p = np.array(end or (step["start"] if step else []))
        f = smooth[k - 1] if end else smooth[k] if step else None
        number = step["number"] if step else steps[-1]["number"] + 1 if steps else 0
        h = float(p @ f) if f is not None else None
        rows.append({"step": number, "time": time, "norm": float(np.linalg.norm(p)), "h": h})
    largest = max((abs(r["h"]) for r in rows if r["h"] is not None), default=0.0)
    for row, miss in zip(rows, [*_misses(steps, smooth), 0.0], strict=True):
        row["drift"] = abs(miss) / largest if largest > 0.0 else 0.0
    return rows


def _misses(steps: list[Row], smooth: list[Numbers | None]) -> list[float]:
    """Return the change of H over each step: start . f_before - end . f_behind.

    `start` and `end` are the gradients by the states before and after the step. The state changes
    at the rate f_before in this step, and at f_behind in the next step. A step in which a contact
    begins is joined with the next step, because the derivative of a landing takes two steps.
    Then f_before is the rate before both steps, and f_behind the rate in the second step.
    """
    misses, k = [0.0] * len(steps), 1
    while k + 1 < len(steps):
        end = k
        while end + 1 < len(steps) and smooth[end] is None:
            end += 1
        before = smooth[k - 1] if end > k else smooth[k]
        behind = smooth[end] if end > k else smooth[k + 1]
        chained = all(
            steps[i]["number"] == steps[i - 1]["number"] + 1
            and steps[i]["dt"] == steps[i - 1]["dt"]
            for i in range(k, end + 1)
        )
        if chained and before is not None and behind is not None and steps[end]["end"]:
            misses[k] = float(steps[k]["start"] @ before - np.array(steps[end]["end"]) @ behind)
        k = end + 1
    return misses


def _changes(here: list[Row], next_ones: list[Row]) -> list[Row]:
    """Return the contacts of pairs that push in exactly one of two consecutive steps."""
    pairs = [{_pair_of_world(c) for c in rows} for rows in (here, next_ones)]
    return [c for c in [*here, *next_ones] if _pair_of_world(c) in pairs[0] ^ pairs[1]]


def _pair_of_world(c: Row) -> tuple[int, frozenset[int], int]:
    return c["world"], frozenset((c["shape0"], c["shape1"])), c["particle"]


def _suspects(
    boundaries: list[Row], contacts: list[Row], events: list[Row], springs: set[int]
) -> list[Row]:
    known = {(e["step"], frozenset((e["shape0"], e["shape1"]))) for e in events}
    by_step: dict[int, list[Row]] = {}
    for contact in contacts:
        by_step.setdefault(contact["step"], []).append(contact)
    worst: dict[Any, Row] = {}
    for row in boundaries:
        here = by_step.get(row["step"], [])
        # The force of a penalty contact begins or ends between this step and the next one.
        changed = _changes(here, by_step.get(row["step"] + 1, [])) if row["step"] in springs else []
        here = changed or here
        if row["drift"] <= SUSPECT or not here:
            continue
        at = max(here, key=lambda c: (c["begins"], c["held"], np.linalg.norm(c["impulse"])))
        pair = frozenset((at["shape0"], at["shape1"]))
        cause = "a contact drifts"
        if (at["begins"] or changed) and (at["step"], pair) not in known:
            cause = "missed event"
        elif at["held"]:
            cause = "frozen point and normal"
        found = {name: at[name] for name in ("step", "world", "shape0", "shape1")}
        found |= {"drift": row["drift"], "cause": f"{cause} of {pair_of(at)}"}
        key = (at["world"], pair, cause)
        if key not in worst or worst[key]["drift"] < row["drift"]:
            worst[key] = found
    return sorted(worst.values(), key=lambda found: -found["drift"])
