#!/usr/bin/env python3
"""Time NovaPhy and Newton on soft bodies and cloth, in one run, and write the page of the results.

Runs newton_deformable.py and novaphy_deformable.py alternately, each measurement in a separate
process, and writes docs/performance-deformable.md. Newton has the environment of run_peers.py.
Before any timing, the final positions of the first soft body must have the same bits in both
engines.

A shared machine is slower for seconds or minutes at a time. Everything is therefore measured in
several rounds, minutes apart, and the fastest median of each measurement counts.

Large scenes are timed over fewer substeps, and the times are scaled to the substeps of the example.
Newton without changes is left out if an iteration takes minutes.
    .venv/bin/python tools/bench/run_deformable.py
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from deformable import STEPS
from run_peers import ROOT, duration, machine, python_of, rows, run

# Column -> engine, mode, threads (0: all threads of the machine).
COLUMNS = {
    "Newton, shipped": ("newton", "captured", 0),
    "Newton, lean": ("newton", "captured-lean", 0),
    "Newton, bare": ("newton", "captured-bare", 0),
    "NovaPhy": ("novaphy", "captured", 0),
    "NovaPhy, 1 thread": ("novaphy", "captured", 1),
}
# Scene -> size -> substeps, columns that are left out.
SIZES = {
    "soft_body": {
        2: (960, ()),
        4: (960, ()),
        8: (960, ()),
        16: (96, ("Newton, shipped",)),
    },
    "cloth": {
        16: (1920, ("Newton, bare",)),
        32: (192, ("Newton, bare",)),
        64: (96, ("Newton, bare",)),
        128: (96, ("Newton, shipped", "Newton, bare")),
    },
}
# Rounds of each measurement. Newton without changes has one round, because it takes minutes.
TURNS = 4
# For the time per element: cells per side -> substeps.
GROWTH = {6: 96, 13: 48, 28: 24, 59: 12}
# For the memory per element: cells per side -> substeps of a short rollout and of a long one.
MEMORY = {8: (96, 1920), 16: (48, 960), 28: (24, 240)}


# A measurement: column, scene, cells per side, substeps.
Job = tuple[str, str, int, int]
Record = dict[str, object]


def measure(column: str, scene: str, n: int, steps: int) -> Record:
    """Run one measurement."""
    engine, mode, threads = COLUMNS[column]
    iterations = 9 if engine == "novaphy" else 2
    options = ["--scene", scene, "--n", n, "--mode", mode, "--steps", steps]
    options += ["--iterations", iterations]
    return run(python_of(engine), f"{engine}_deformable.py", *options, threads=threads)


def jobs() -> list[Job]:
    """Return all measurements."""
    return [
        (column, scene, n, steps)
        for scene, sizes in SIZES.items()
        for n, (steps, left_out) in sizes.items()
        for column in COLUMNS
        if column not in left_out
    ] + [("NovaPhy", "soft_body", n, steps) for n, steps in GROWTH.items()]


def fastest() -> dict[Job, Record]:
    """Return the record with the smallest median of each measurement."""
    best: dict[Job, Record] = {}
    for turn in range(TURNS):
        for job in jobs():
            if turn > 0 and job[0] == "Newton, shipped":
                continue
            record = measure(*job)
            if job not in best or record["median_s"] < best[job]["median_s"]:
                best[job] = record
    return best


def check_bits() -> str:
    """Return the hash of the final positions of the example, which is the same in all runs."""
    columns = ("Newton, shipped", "NovaPhy")
    steps = STEPS["soft_body"]
    hashes = {c: str(measure(c, "soft_body", 2, steps)["result_hash"]) for c in columns}
    if len(set(hashes.values())) != 1:
        raise SystemExit(f"run_deformable: the final positions differ: {hashes}")
    return next(iter(hashes.values()))


def table(best: dict[Job, Record], scene: str) -> str:
    """Return the table of times per iteration of a scene, with the speedup of NovaPhy."""
    body, ratios = [], []
    for n, (steps, left_out) in SIZES[scene].items():
        records = {c: best[c, scene, n, steps] for c in COLUMNS if c not in left_out}
        times = {c: float(r["median_s"]) / steps * STEPS[scene] for c, r in records.items()}
        elements = next(iter(records.values()))["elements"]
        label = [f"{n}", f"{elements:,}"]
        body.append([*label, *(duration(times[c]) if c in times else "" for c in COLUMNS)])
        ratios.append(
            [*label]
            + [
                f"{times[c] / times['NovaPhy']:.1f}" if c in times else ""
                for c in COLUMNS
                if c.startswith("Newton")
            ]
        )
    kind = "tetrahedra" if scene == "soft_body" else "triangles"
    faster = rows(["N", kind, *(c for c in COLUMNS if c.startswith("Newton"))], ratios)
    return (
        rows(["N", kind, *COLUMNS], body)
        + "\n\nHow many times faster NovaPhy is than each:\n\n"
        + faster
    )


def growth(best: dict[Job, Record]) -> str:
    """Return the table of the time per tetrahedron and substep."""
    body = []
    for n, steps in GROWTH.items():
        record = best["NovaPhy", "soft_body", n, steps]
        per = float(record["median_s"]) / steps / int(record["elements"])
        body.append([f"{n}", f"{record['elements']:,}", f"{steps}", f"{per * 1e9:.0f} ns"])
    return rows(["N", "tetrahedra", "substeps", "per tetrahedron and substep"], body)


def memory() -> str:
    """Return the table of bytes per substep, from the resident memory of two rollouts."""
    body = []
    for n, lengths in MEMORY.items():
        short, long = (measure("NovaPhy", "soft_body", n, steps) for steps in lengths)
        more = float(long["peak_bytes"]) - float(short["peak_bytes"])
        per = more / (lengths[1] - lengths[0])
        tetrahedra, particles = int(long["elements"]), (n + 1) ** 3
        each = (f"{per / tetrahedra:.1f}", f"{per / particles:.1f}", f"{per / 1e3:.1f} kB")
        body.append([f"{n}", f"{tetrahedra:,}", *each])
    head = ["N", "tetrahedra", "bytes per tetrahedron", "bytes per particle", "together"]
    return rows(head, body)


def main() -> None:
    """Measure everything and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "performance-deformable.md")
    arguments = parser.parse_args()
    same, best = check_bits(), fastest()
    facts = rows(["", ""], [list(fact) for fact in machine()])
    text = f"""# Performance of soft bodies and cloth

Written by `tools/bench/run_deformable.py`; do not edit. Everything on this page was measured on one
machine, against Newton 1.8.0 on Warp 1.19.0.

{facts}

The table has the time of one iteration of Newton's examples, captured once and replayed. An
iteration is the rollout (960 substeps of the soft body, 1,920 of the cloth), the loss, `backward`,
and the update. Times are medians, and of {TURNS} turns the fastest (Newton as shipped had one),
because the machine has slow phases. From soft bodies of N = 16 and cloths of N = 32 on, fewer
substeps were timed, and the times scaled.

* *shipped*: as the examples are.
* *lean*: without the hash grid of the particles and the pass over (triangle, particle) pairs, which
  do nothing there.
* *bare*: also without 1,000 empty slots for rigid contacts.

Newton's CPU device runs on one thread; NovaPhy uses all CPUs unless it says 1 thread. The final
positions of the soft body at N = 2 are the same bits in both engines (hash {same}).

Gradients that have no compiled kernel ([which](design/0008-kernels-compiled-ahead.md#known-gaps))
take about twice as long; none of them is timed here.

## Soft body, N³ cells

{table(best, "soft_body")}

## Cloth, N² cells

Newton as shipped looks for contacts between particles, which at N = 128 lie closer together than
their diameter.

{table(best, "cloth")}

## Cost of elements

Contacts, integration, surface triangles and both passes included.

{growth(best)}

## Memory

A recorded rollout, per substep: the resident set of a long rollout less that of a short one.

{memory()}

A substep keeps 36 bytes per particle (positions, velocities, forces) and the records of its
launches. Nothing is kept per element: what the elements write, forward and backward, is used again
in every substep, and the adjoint computes it once more.

## Again

```sh
.venv/bin/python tools/bench/run_deformable.py
```
"""
    temporary = arguments.output.with_suffix(".md.part")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(arguments.output)
    print(f"written: {arguments.output}", file=sys.stderr)


if __name__ == "__main__":
    main()
