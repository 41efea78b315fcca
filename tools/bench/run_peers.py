#!/usr/bin/env python3
"""Time NovaPhy and Newton on the same scene, in one run, and write docs/performance.md.

Makes a virtual environment with Newton under build/ (from the package index, once), then runs
newton_ball.py and novaphy_ball.py in turn, each measurement in a process of its own. Before any
timing, the loss of the first iteration of one ball must be the same bits in both engines and in all
modes. Adds the start-up time of a fresh process (start_up.py) and the memory of the step loop.

Run it with the Python that has NovaPhy installed, on a machine that does nothing else:

    .venv/bin/python tools/bench/run_peers.py
    .venv/bin/python tools/bench/run_peers.py --n 1 1000 --rounds 1 --output /tmp/performance.md
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BENCH = ROOT / "tools" / "bench"
VENV = ROOT / "build" / "venv" / "peers"
REQUIREMENTS = ("newton==1.8.0", "warp-lang==1.19.0", "numpy")

ENGINES = ("newton", "novaphy")
# Column -> engine, mode, threads (0: as many as there are).
COLUMNS = {
    "Newton, eager": ("newton", "eager", 0),
    "Newton, captured": ("newton", "captured", 0),
    "Newton, captured, lean": ("newton", "captured-lean", 0),
    "NovaPhy, step": ("novaphy", "step", 0),
    "NovaPhy, rollout": ("novaphy", "rollout", 0),
    "NovaPhy, captured": ("novaphy", "captured", 0),
    "NovaPhy, captured, 1 thread": ("novaphy", "captured", 1),
}
# Ratio -> slower column, faster column.
RATIOS = {
    "step loop against Newton eager": ("Newton, eager", "NovaPhy, step"),
    "step loop against Newton captured": ("Newton, captured", "NovaPhy, step"),
    "captured against captured": ("Newton, captured", "NovaPhy, captured"),
    "captured against captured, lean": ("Newton, captured, lean", "NovaPhy, captured"),
    "captured, 1 thread, against captured": ("Newton, captured", "NovaPhy, captured, 1 thread"),
    "captured, 1 thread, against captured, lean": (
        "Newton, captured, lean",
        "NovaPhy, captured, 1 thread",
    ),
}


def newton_python() -> Path:
    """The Python of an environment with Newton, made once."""
    python, stamp = VENV / "bin" / "python", VENV / "requirements.stamp"
    wanted = f"{sys.version} {REQUIREMENTS}"
    if not python.exists() or not stamp.exists() or stamp.read_text() != wanted:
        print(f"installing {', '.join(REQUIREMENTS)}", file=sys.stderr)
        subprocess.run([sys.executable, "-m", "venv", "--clear", VENV], check=True)
        pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        subprocess.run([*pip, *REQUIREMENTS], check=True)
        stamp.write_text(wanted)
    return python


def run(python: Path | str, script: str, *arguments: object, threads: int = 0) -> dict[str, object]:
    """Run a benchmark program; the record of its last line."""
    env = {k: v for k, v in os.environ.items() if not k.startswith(("NOVAPHY_", "NOVA_"))}
    if threads:
        env["NOVAPHY_NUM_THREADS"] = str(threads)
    command = [str(python), str(BENCH / script), *map(str, arguments)]
    done = subprocess.run(command, env=env, stdout=subprocess.PIPE, text=True, check=True)
    record = json.loads(done.stdout.splitlines()[-1])
    print(json.dumps(record), flush=True)
    return record


def measure(column: str, newton: Path, n: int, iterations: int) -> dict[str, object]:
    """One measurement of a column of the table."""
    engine, mode, threads = COLUMNS[column]
    python = newton if engine == "newton" else sys.executable
    options = ["--n", n, "--mode", mode, "--iterations", iterations]
    return run(python, f"{engine}_ball.py", *options, threads=threads)


def check_bits(newton: Path) -> float:
    """The loss of the first iteration of one ball, which must be the same everywhere."""
    losses = {column: measure(column, newton, 1, 1)["loss"] for column in COLUMNS}
    if len(set(losses.values())) != 1:
        raise SystemExit(f"run_peers: the losses of the first iteration differ: {losses}")
    return float(next(iter(losses.values())))


def check_hashes(records: list[dict[str, object]]) -> bool:
    """Whether Newton's final positions and gradient are NovaPhy's, which are one in all modes."""
    hashes = {e: {r["result_hash"] for r in records if r["engine"] == e} for e in ENGINES}
    if len(hashes["novaphy"]) > 1:
        raise SystemExit(f"run_peers: the results of NovaPhy differ: {sorted(hashes['novaphy'])}")
    return hashes["newton"] == hashes["novaphy"]


def iterations_for(n: int) -> int:
    """Timed iterations per measurement."""
    return 30 if n <= 1000 else 5 if n <= 10_000 else 2


def time_all(
    newton: Path, sizes: list[int], rounds: int
) -> tuple[dict[int, dict[str, float]], list[int]]:
    """Median seconds by number of balls and column, and for how many balls both had the same bits.

    The engines take turns.
    """
    table: dict[int, dict[str, float]] = {}
    same: list[int] = []
    for n in sizes:
        seconds: dict[str, list[float]] = {column: [] for column in COLUMNS}
        records = []
        for _ in range(rounds):
            for column in COLUMNS:
                records.append(measure(column, newton, n, iterations_for(n)))
                seconds[column].append(float(records[-1]["median_s"]))
        if check_hashes(records):
            same.append(n)
        table[n] = {column: statistics.median(values) for column, values in seconds.items()}
    return table, same


def cpu_name() -> str:
    """The processor's name."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.machine()


def machine() -> Iterator[tuple[str, str]]:
    """What the numbers were measured on."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    yield "processor", f"{cpu_name()}, {len(os.sched_getaffinity(0))} CPUs used"
    yield "memory", f"{memory:.0f} GiB"
    yield "system", platform.freedesktop_os_release()["PRETTY_NAME"]
    yield "Python", platform.python_version()


def duration(seconds: float) -> str:
    """Seconds with three digits."""
    return f"{seconds:.3g} s" if seconds >= 1 else f"{seconds * 1e3:.3g} ms"


def rows(header: list[str], body: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *body]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def page(
    table: dict[int, dict[str, float]],
    same: list[int],
    versions: dict[str, str],
    loss: float,
    start: dict[str, object],
    memory: dict[str, object],
    rounds: int,
) -> str:
    """docs/performance.md."""
    sizes = list(table)
    times = [[f"{n:,}", *(duration(table[n][c]) for c in COLUMNS)] for n in sizes]
    ratios = [
        [name, *(f"{table[n][slow] / table[n][fast]:.1f}" for n in sizes)]
        for name, (slow, fast) in RATIOS.items()
    ]
    facts = [*machine(), *((name, version) for name, version in versions.items())]
    equal = ", ".join(f"{n:,}" for n in same) or "none"
    total = float(memory["states_bytes"]) + float(memory["tape_bytes"])
    return f"""# Performance

Written by `tools/bench/run_peers.py`; do not edit. Everything on this page was measured in one
run.

{rows(["", ""], [list(fact) for fact in facts])}

## The ball, N times

One iteration is what the example does: 288 substeps with contacts, the loss, `backward`, the
update of the initial velocities. Time per iteration: the median within a process, and of that the
median over {rounds} processes, in which the engines took turns. The loss of the first iteration of
one ball, {loss!r}, is the same bits in every column. After the last iteration, the positions and
the gradient have the same bits in both engines for N = {equal}.

{rows(["N", *COLUMNS], times)}

How many times faster NovaPhy is:

{rows(["", *(f"N = {n:,}" for n in sizes)], ratios)}

*eager* and *step*: a Python loop over the substeps, recorded anew in every iteration. *rollout*:
one call for all substeps. *captured*: recorded once and replayed. *lean*: Newton with a pipeline
without rigid contacts, which spares it a kernel that does nothing in this scene. Newton's CPU
device (Warp) runs on one thread; NovaPhy uses all CPUs unless it says 1 thread.

## Start-up

From starting `python` until the gradient of the ball is printed, in a fresh process:
{duration(float(start["median_s"]))} (median of {start["runs"]};
{duration(float(start["min_s"]))} to {duration(float(start["max_s"]))}).

## Memory

The Python loop of `step`, N = {memory["n"]:,}: {float(memory["states_bytes"]):.0f} bytes per
particle and substep for the states (positions, velocities and forces are 36 of them), and
{float(memory["tape_bytes"]):.0f} more for what the tape keeps and for all gradients: {total:.0f}
together.

## Again

```sh
.venv/bin/python tools/bench/run_peers.py
```
"""


def main() -> None:
    """Measure everything and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--n", type=int, nargs="+", default=[1, 10, 100, 1000, 10_000, 100_000], help="balls"
    )
    parser.add_argument("--rounds", type=int, default=3, help="processes per measurement")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "performance.md")
    arguments = parser.parse_args()
    if min(arguments.n) < 1 or arguments.rounds < 1:
        parser.error("--n and --rounds must be positive")

    newton = newton_python()
    loss = check_bits(newton)
    versions = {
        "NovaPhy": str(measure("NovaPhy, captured", newton, 1, 1)["version"]),
        "Newton": "1.8.0, Warp 1.19.0",
    }
    table, same = time_all(newton, arguments.n, arguments.rounds)
    start = run(sys.executable, "start_up.py")
    memory = run(sys.executable, "novaphy_ball.py", "--memory", "--n", 10_000)
    text = page(table, same, versions, loss, start, memory, arguments.rounds)
    temporary = arguments.output.with_suffix(".md.part")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(arguments.output)
    print(f"written: {arguments.output}", file=sys.stderr)


if __name__ == "__main__":
    main()
