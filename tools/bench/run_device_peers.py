#!/usr/bin/env python3
"""Time one large world in NovaPhy and peers on a machine with a GPU, and write the results.

Runs novaphy_rigid_cuda.py and newton_rigid_cuda.py on columns of boxes, and large_worlds.py on one
thread of the CPU. Each measurement is a separate process, and ends after `--limit` seconds. Newton
compiles its kernels first, in a process without a limit. The peers have the environments of
run_peers.py. Writes docs/performance-device.md and its picture.
    .venv/bin/python tools/bench/run_device_peers.py
    .venv/bin/python tools/bench/run_device_peers.py --here --n 1000 --output /tmp/page.md
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from math import log10
from pathlib import Path

import run_peers
from run_peers import BENCH, ROOT, duration, environment, machine, python_of, rows

SIZES = [100, 1000, 10_000, 100_000]
PEERS = {"Newton, sap": "sap", "Newton, nxn": "nxn"}
NOVAPHY = "NovaPhy"
COLORS = {NOVAPHY: "#1f77b4", "Newton, sap": "#d62728", "Newton, nxn": "#ff9896"}
# Row of the table -> arguments of large_worlds.py, and the key of the value.
CPU = {
    "8 × 8 × 8 cubes, a step with its search": (["--scene", "cubes", "--n", 8], "step_s"),
    "8 × 8 × 8 cubes, a search over all gaps": (["--scene", "cubes", "--n", 8], "search_s"),
    "20 boxes on 1,000,000 triangles, a search": (["--scene", "terrain", "--n", 707], "search_s"),
    "the same, pipeline and first search": (["--scene", "terrain", "--n", 707], "first_s"),
}

Record = dict[str, object]


def run(python: Path | str, script: str, arguments: list[object], limit: float | None) -> Record:
    """Return the record in a program's last line. `failed` has the reason if there is no record."""
    command = [str(python), str(BENCH / script), *map(str, arguments)]
    threads = 1 if script == "large_worlds.py" else 0
    try:
        done = subprocess.run(
            command, env=environment(threads), capture_output=True, text=True, timeout=limit
        )
    except subprocess.TimeoutExpired:
        return {"failed": f"more than {limit:g} s"}
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines() or [f"ended with {done.returncode}"]
        return {"failed": lines[-1].replace("|", "/")[:80]}
    record = json.loads(done.stdout.splitlines()[-1])
    print(json.dumps(record), flush=True)
    return record


def cell(record: Record, key: str) -> str:
    """Return a time as text, or the reason why there is none."""
    return duration(float(record[key])) if key in record else str(record["failed"])


def measure(n: int, limit: float) -> dict[str, Record]:
    """Return the records of n boxes, by engine."""
    options = ["--scene", "columns", "--n", n]
    records = {NOVAPHY: run(sys.executable, "novaphy_rigid_cuda.py", options, limit)}
    for name, phase in PEERS.items():
        options = ["--n", n, "--broad-phase", phase]
        records[name] = run(python_of("newton"), "newton_rigid_cuda.py", options, limit)
    return records


def picture(results: dict[int, dict[str, Record]], key: str) -> str:
    """Return an SVG of times over sizes, with logarithmic axes."""
    width, height, left, low = 640, 400, 70, 350
    times = [float(r[key]) for of in results.values() for r in of.values() if key in r]
    if not times:
        return ""
    first, last = int(log10(min(times)) // 1), int(log10(max(times)) // 1) + 1
    smallest, largest = log10(min(results)), max(log10(max(results)), log10(min(results)) + 1)

    def at(n: float, seconds: float) -> tuple[float, float]:
        x = left + (width - left - 160) * (log10(n) - smallest) / (largest - smallest)
        return x, low - (low - 20) * (log10(seconds) - first) / (last - first)

    text = 'font-family="sans-serif" font-size="12"'
    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" {text}>']
    lines.append(f'<rect width="{width}" height="{height}" fill="white"/>')
    for power in range(first, last + 1):
        _, y = at(min(results), 10.0**power)
        lines.append(f'<path d="M{left},{y:.1f}H{width - 160}" stroke="#ddd"/>')
        lines.append(f'<text x="5" y="{y + 4:.1f}">{duration(10.0**power)}</text>')
    for n in results:
        lines.append(f'<text x="{at(n, 10.0**first)[0] - 15:.1f}" y="{low + 20}">{n:,}</text>')
    for row, (name, color) in enumerate(COLORS.items()):
        points = [at(n, float(of[name][key])) for n, of in results.items() if key in of[name]]
        if not points:
            continue
        path = "M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in points)
        lines.append(f'<path d="{path}" fill="none" stroke="{color}" stroke-width="2"/>')
        lines.append(f'<text x="{width - 150}" y="{40 + 20 * row}" fill="{color}">{name}</text>')
    return "\n".join([*lines, "</svg>\n"])


def table(results: dict[int, dict[str, Record]], key: str) -> str:
    """Return the table of times over sizes, with the ratio of NovaPhy and the best peer."""
    body = []
    for name in COLORS:
        body.append([name, *(cell(of[name], key) for of in results.values())])
    ratios = ["best peer ÷ NovaPhy"]
    for of in results.values():
        peers = [float(of[name][key]) for name in PEERS if key in of[name]]
        own = of[NOVAPHY]
        ratios.append(f"{min(peers) / float(own[key]):.2f}" if peers and key in own else "–")
    return rows(["", *(f"{n:,} boxes" for n in results)], [*body, ratios])


def gpu_name() -> str:
    """Return the name of the first GPU."""
    if shutil.which("nvidia-smi") is None:
        return "none"
    query = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    done = subprocess.run(query, capture_output=True, text=True)
    return done.stdout.splitlines()[0] if done.returncode == 0 and done.stdout else "none"


def main() -> None:
    """Measure everything and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--n", type=int, nargs="+", default=SIZES, help="boxes")
    parser.add_argument("--limit", type=float, default=60.0, help="of a measurement, s")
    parser.add_argument("--here", action="store_true", help="with the peers of this Python")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "performance-device.md")
    arguments = parser.parse_args()
    if arguments.here:
        run_peers.REQUIREMENTS.clear()
    for phase in PEERS.values():
        run(python_of("newton"), "newton_rigid_cuda.py", ["--n", 100, "--broad-phase", phase], None)
    results = {n: measure(n, arguments.limit) for n in sorted(arguments.n)}
    cpu: dict[str, Record] = {}
    body = []
    for name, (options, key) in CPU.items():
        scene = str(options)
        if scene not in cpu:
            cpu[scene] = run(sys.executable, "large_worlds.py", list(options), arguments.limit)
        body.append([name, cell(cpu[scene], key)])
    facts = [*machine(), ("GPU", gpu_name())]
    drawn = picture(results, "captured_step_s")
    image = arguments.output.with_suffix(".svg")
    text = f"""# Performance of one large world

Written by `tools/bench/run_device_peers.py`; do not edit. Everything on this page was measured in
one run, each row in a process of its own.

{rows(["", ""], [list(fact) for fact in facts])}

## Boxes in columns of ten, on the GPU

A step finds contacts anew. Steps and searches are captured and replayed.

A step with its search:

{table(results, "captured_step_s")}

![Time of a step over the number of boxes]({image.name})

A search alone:

{table(results, "captured_search_s")}

## One thread of the CPU

{rows(["", "NovaPhy"], body)}

## Again

```sh
.venv/bin/python tools/bench/run_device_peers.py
```
"""
    image.write_text(drawn, encoding="utf-8")
    arguments.output.write_text(text, encoding="utf-8")
    print(f"written: {arguments.output}", file=sys.stderr)


if __name__ == "__main__":
    main()
