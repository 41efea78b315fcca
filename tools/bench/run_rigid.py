#!/usr/bin/env python3
"""Time NovaPhy, Newton and MuJoCo on rigid bodies, in one run, and write the page of the results.

Runs novaphy_rigid.py, newton_rigid.py and mujoco_rigid.py, each measurement in a separate process
on one thread, and writes docs/performance-rigid.md. The round with the least time of each
measurement counts. The peers have the environments of run_peers.py.
    .venv/bin/python tools/bench/run_rigid.py
    .venv/bin/python tools/bench/run_rigid.py --here  # peers are installed in this Python
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import run_peers
from run_peers import ROOT, duration, machine, python_of, rows, run

run_peers.REQUIREMENTS["mujoco"] = ("mujoco==4.0.0", "numpy")
ENGINES = {"NovaPhy": "novaphy", "Newton": "newton", "MuJoCo": "mujoco"}
TURNS = 2
SETTLED = ["--warm", 100, "--steps", 100]
# Scene -> arguments of the programs.
FORWARD = {
    "100 boxes in 10 columns": ["--scene", "columns", "--n", 100, *SETTLED],
    "1,000 boxes in 100 columns": ["--scene", "columns", "--n", 1000, *SETTLED],
    "the same, turned by 10°": ["--scene", "columns", "--n", 1000, "--turn", 10, *SETTLED],
    "one pile of 100": ["--scene", "pile", "--n", 100, *SETTLED],
    "one pile of 1,000": ["--scene", "pile", "--n", 1000, "--steps", 10, "--warm", 50],
}
DICE = {
    1: ["--scene", "dice", "--n", 1, "--warm", 2, "--steps", 20],
    1024: ["--scene", "dice", "--n", 1024, "--warm", 1, "--steps", 5],
}
MIXED = ["--scene", "mixed", "--n", 484, "--warm", 250, "--steps", 60]
GROWTH = (10, 100, 1000, 10_000, 16_000)
# Scenes that also have a row in which NovaPhy's boxes overlap as little as MuJoCo's.
EQUAL_DEPTH = ("1,000 boxes in 100 columns",)

Record = dict[str, object]


def race(engines: list[str], arguments: list[object], turns: int = TURNS) -> dict[str, Record]:
    """Run engines in alternating rounds. Return the record of each with the least time."""
    records: dict[str, list[Record]] = {engine: [] for engine in engines}
    for _ in range(turns):
        for engine in engines:
            record = run(python_of(engine), f"{engine}_rigid.py", *arguments, threads=1)
            records[engine].append(record)
    return {
        engine: min(of_engine, key=lambda record: float(record["cpu_median_s"]))
        for engine, of_engine in records.items()
    }


def best(engine: str, arguments: list[object], turns: int = TURNS) -> Record:
    """Run several rounds of an engine. Return the record with the least time."""
    return race([engine], arguments, turns)[engine]


def cells(scene: str, name: str, record: Record) -> list[str]:
    """Return a row of the table of forward scenes."""
    step = float(record["cpu_median_s"])
    return [
        scene,
        name,
        f"{1.0 / step:,.0f}",
        f"{float(record['dt_s']) / step:.3g}",
        f"{record['contacts']:,}",
        f"{record['touching']:,}",
        f"{float(record['mean_depth_m']) * 1e3:.3f} mm",
    ]


def forward() -> str:
    """Return the table of steps per second of boxes, with the contacts of each engine."""
    body = []
    for scene, arguments in FORWARD.items():
        records = race(list(ENGINES.values()), arguments)
        for name, engine in ENGINES.items():
            body.append(cells(scene if name == "NovaPhy" else "", name, records[engine]))
        if scene in EQUAL_DEPTH:
            depth = {engine: float(records[engine]["mean_depth_m"]) for engine in records}
            factor = depth["novaphy"] / depth["mujoco"]
            record = best("novaphy", [*arguments, "--stiffer", factor])
            body.append(cells("", f"NovaPhy, stiffness × {factor:.2g}", record))
    head = ["scene", "engine", "steps/s", "simulated s per s", "contacts", "touching", "mean depth"]
    return rows(head, body)


def mixed() -> str:
    """Return the table of shapes of all kinds on a mesh, in NovaPhy and Newton."""
    records = race(["novaphy", "newton"], MIXED)
    body = [cells("", name, records[ENGINES[name]])[1:] for name in ("NovaPhy", "Newton")]
    head = ["engine", "steps/s", "simulated s per s", "contacts", "touching", "mean depth"]
    return rows(head, body)


def dice() -> str:
    """Return the table of training iterations of dice."""
    body = []
    for n, arguments in DICE.items():
        record = best("novaphy", arguments)
        row = [f"{n:,}", duration(float(record["cpu_median_s"])), ""]
        if n == 1:
            newton = best("newton", [*arguments[:4], "--warm", 1, "--steps", 2], 1)
            row[2] = duration(float(newton["cpu_median_s"]))
        body.append(row)
    return rows(["dice", "NovaPhy, captured", "Newton, recorded anew"], body)


def growth() -> str:
    """Return the table of the time of a step over the number of contacts."""
    body = []
    for n in GROWTH:
        record = best("novaphy", ["--scene", "columns", "--n", n, "--steps", 50])
        each = float(record["cpu_median_s"]) / int(record["contacts"])
        row = [f"{n:,}", f"{record['contacts']:,}", duration(float(record["cpu_median_s"]))]
        body.append([*row, f"{each * 1e9:.0f} ns", f"{1e-6 / each:.2f} million/s"])
    return rows(["boxes", "contacts", "a step", "a contact", "contacts found and applied"], body)


def main() -> None:
    """Measure everything and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "performance-rigid.md")
    parser.add_argument("--here", action="store_true", help="with the peers of this Python")
    arguments = parser.parse_args()
    if arguments.here:
        run_peers.REQUIREMENTS.clear()
    facts = rows(["", ""], [list(fact) for fact in machine()])
    text = f"""# Performance of rigid bodies

Written by `tools/bench/run_rigid.py`; do not edit. Everything on this page was measured within an
hour on one machine, on one thread of each engine. Times are CPU times of the process, which other
work on the machine stretches less than wall time. The machine was shared (load average
{os.getloadavg()[1]:.1f}): caches were shared too, so times are upper bounds. Medians over the
steps, and of {TURNS} turns, in which the engines alternate, the fastest.

{facts}

## Boxes that rest

Boxes of 8 kg with a side of 0.2 m. NovaPhy and Newton step at 1/960 s by penalty forces (ke 200
kN/m, kd 300, kf 200, four rows a pair). Both find contacts in every step by sweep and prune. Their
rows include those within the gap of 0.2 m; *touching* rows have a force. MuJoCo 4.0 steps at 1/500
s with its own defaults; it solves for contacts as constraints, island by island, so one connected
pile costs it more.

Penalty forces need the smaller step, so the tables show simulated seconds per second, and how deep
the boxes overlap. A smaller depth needs a larger stiffness, and with it a smaller step.

{forward()}

*Stiffness × k*: the same boxes with k times the stiffness and a step that is √k times shorter, so
that they sink as deep as MuJoCo's. Columns start at rest; a pile still settles, differently in each
engine, so its depths are no comparison.

## Shapes of all kinds on a mesh

484 spheres, capsules, cylinders, boxes and hulls that lie on hills of 2,048 triangles, at 1/960 s;
rows within a gap of 0.04 m. (MuJoCo takes meshes as their convex hulls, so it has no such scene.)

{mixed()}

## Dice, with gradient

One training iteration: 768 substeps of a die of 12 kg that falls on the ground, loss, backward
pass. NovaPhy's iteration is captured once and replayed; Newton's tape is recorded in every
iteration, as its examples with contacts do.

{dice()}

## Cost of a contact

Boxes in columns of ten; `contacts` are rows, touching or not; the time is that of the whole step.

{growth()}

## Again

```sh
.venv/bin/python tools/bench/run_rigid.py
```
"""
    temporary = arguments.output.with_suffix(".md.part")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(arguments.output)
    print(f"written: {arguments.output}", file=sys.stderr)


if __name__ == "__main__":
    main()
