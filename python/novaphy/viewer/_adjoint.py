"""The views of an adjoint record: a part of a page over time, and arrows of contacts."""

from __future__ import annotations

import json
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ..nova import AdjointRecord
    from ._scene_viewer import SceneViewer

KEPT = ("step", "time", "point", "impulse", "adjoint", "carried", "held")
COLORS = {"impulse": (0.16, 0.44, 0.72), "adjoint": (0.82, 0.26, 0.1)}
THICKNESS = 0.03  # width of an arrow, as a part of the longest arrow's length


def pair_name(row: dict[str, Any]) -> str:
    """Return the name of a contact's pair, or of the joint of a limit."""
    if row.get("kind") == "limit":
        return f"joint {row['joint']}"
    if row["particle"] >= 0:
        return f"particle {row['particle']} and shape {max(row['shape0'], row['shape1'])}"
    return f"shapes {row['shape0']} and {row['shape1']}"


def _plain(value: Any) -> Any:
    """Return a value with seven digits for JSON. NaN and infinity become None."""
    if isinstance(value, float):
        return float(f"{value:.7g}") if np.isfinite(value) else None
    return [_plain(v) for v in value] if isinstance(value, list) else value


def fragment(record: AdjointRecord) -> str:
    """Return the HTML of the part of a page that shows a record over time."""
    times = {row["step"]: row["time"] for row in record.boundaries}
    content = {
        "title": f"{record.info.label}: {record.info.reason}",
        "boundaries": [{n: _plain(v) for n, v in row.items()} for row in record.boundaries],
        "contacts": [
            {name: _plain(row[name]) for name in KEPT} | {"pair": pair_name(row)}
            for row in record.contacts
        ],
        "events": [
            {"step": e["step"], "time": _plain(e["time"]), "kind": e["kind"], "pair": pair_name(e)}
            for e in record.info.event_list
        ],
        "suspects": [
            {"step": s["step"], "time": _plain(times[s["step"]]), "cause": s["cause"]}
            for s in record.suspects
        ],
    }
    template = resources.files(__package__).joinpath("assets/adjoint.html").read_text("utf-8")
    text = json.dumps(content, separators=(",", ":")).replace("</", "<\\/")
    return template.replace("/*RECORD*/", text)


def check_record(record: AdjointRecord, length: float) -> None:
    """Check a record and the length (m) of its longest arrow.

    TypeError: not an AdjointRecord. ValueError: no steps, or a length that is not positive.
    """
    if not hasattr(record, "boundaries"):
        raise TypeError(
            "log_adjoint_record, record: expected an AdjointRecord (tape.adjoint_record()), got "
            f"{type(record).__name__}"
        )
    if not record.boundaries:
        raise ValueError("log_adjoint_record, record: expected at least one step, got none")
    if not 0.0 < length < np.inf:
        raise ValueError(f"log_adjoint_record, length: expected > 0 and finite, got {length}")


def _later(time: float) -> float:
    """Return a time (s) plus a tolerance for the rounding of float32 time steps."""
    return time + 1e-7 + 1.2e-7 * abs(time) if np.isfinite(time) else time


def log_arrows_between(
    viewer: SceneViewer, record: AdjointRecord, after: float, until: float, length: float
) -> None:
    """Draw the arrows of contacts whose steps start in the times (after, until] (s).

    length: the length (m) of the longest impulse arrow, and of the longest adjoint arrow.
    """
    late = [c for c in record.contacts if _later(after) < c["time"] <= _later(until)]
    starts = np.array([c["point"] for c in late], np.float32).reshape(-1, 3)
    for name, color in COLORS.items():
        lengths = np.array([np.linalg.norm(c[name]) for c in record.contacts])
        longest = max(lengths[np.isfinite(lengths)], default=0.0) or 1.0
        vectors = np.array([c[name] for c in late], np.float64).reshape(-1, 3)
        vectors[~np.isfinite(vectors).all(axis=1)] = 0.0  # a length of 0 draws no arrow
        along = (vectors * (length / longest)).astype(np.float32)
        viewer.log_arrows(f"adjoint/{name}", starts, starts + along, color, THICKNESS * length)
