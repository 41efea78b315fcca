#!/usr/bin/env python3
"""Time NovaPhy and its peers on the same scene, in one run, and write docs/performance.md.

Makes a virtual environment for each peer under build/ (from the package index, once). Then runs the
programs of this folder in turn, each measurement in a separate process. Before any timing, the loss
of the first iteration of one ball must have the same bits in Newton and in all modes of NovaPhy.
The losses of JAX and Dr.Jit must agree within 1e-5. Also measures the copy bandwidth of the
machine, the operations of the rollout, the instructions of an iteration (if valgrind is installed),
the start-up time of a fresh process, and the memory of a rollout.

A measurement that needs more memory than is free is left out, and the table says so. With `--slow`
the same holds for measurements that would take longer than this many seconds for an iteration.

Run it with the Python that has NovaPhy installed, on a machine without other load:

    .venv/bin/python tools/bench/run_peers.py
    .venv/bin/python tools/bench/run_peers.py --n 1 1000 --rounds 1 --output /tmp/performance.md
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
BENCH = ROOT / "tools" / "bench"
VENVS = ROOT / "build" / "venv"
REQUIREMENTS = {
    "newton": ("newton==1.8.0", "warp-lang==1.19.0", "numpy"),
    "jax": ("jax==0.10.2", "jaxlib==0.10.2", "numpy"),
    "drjit": ("drjit==1.5.0", "numpy"),
}
SUBSTEPS = 288
SAME_BITS = ("newton", "novaphy")
RELATIVE = 1.0e-5  # allowed relative difference of the first loss in other engines

# Column -> engine, mode, threads (0: all threads of the machine).
COLUMNS = {
    "Newton, eager": ("newton", "eager", 0),
    "Newton, captured": ("newton", "captured", 0),
    "Newton, captured, lean": ("newton", "captured-lean", 0),
    "JAX, full": ("jax", "full", 0),
    "JAX, lean": ("jax", "lean", 0),
    "Dr.Jit, lean": ("drjit", "lean", 0),
    "Dr.Jit, lean, frozen": ("drjit", "frozen", 0),
    "NovaPhy, step": ("novaphy", "step", 0),
    "NovaPhy, rollout": ("novaphy", "rollout", 0),
    "NovaPhy, captured": ("novaphy", "captured", 0),
    "NovaPhy, leaves": ("novaphy", "leaves", 0),
    "NovaPhy, leaves, 1 thread": ("novaphy", "leaves", 1),
}
BEST = "NovaPhy, leaves"
# Ratio of the table -> slower column, faster column.
RATIOS = {
    "step against Newton, eager": ("Newton, eager", "NovaPhy, step"),
    "captured against Newton, captured": ("Newton, captured", "NovaPhy, captured"),
    "leaves against Newton, captured": ("Newton, captured", BEST),
    "leaves, 1 thread, against Newton, captured": ("Newton, captured", "NovaPhy, leaves, 1 thread"),
    "leaves against Newton, captured, lean": ("Newton, captured, lean", BEST),
    "leaves against JAX, full": ("JAX, full", BEST),
    "leaves against JAX, lean": ("JAX, lean", BEST),
    "leaves against Dr.Jit, lean": ("Dr.Jit, lean", BEST),
    "leaves against Dr.Jit, lean, frozen": ("Dr.Jit, lean, frozen", BEST),
}
# Bytes for each particle and substep that a measurement needs, unless its program reports them:
# states of positions, velocities and forces, and their gradients.
NEEDED_BYTES = {"newton": 72, "step": 88, "rollout": 49, "captured": 49, "leaves": 25}
# Bytes for each particle and substep that a rollout and its backward pass must move. Positions and
# velocities are 24 bytes. A substep writes them, and its adjoint reads them.
MOVED_BYTES = 48
COPY_BYTES = 256 << 20


def python_of(engine: str) -> Path | str:
    """Return the Python of an engine. Make the virtual environment of a peer if it is missing."""
    if engine not in REQUIREMENTS:
        return sys.executable
    venv, wanted = VENVS / engine, f"{sys.version} {REQUIREMENTS[engine]}"
    python, stamp = venv / "bin" / "python", venv / "requirements.stamp"
    if not python.exists() or not stamp.exists() or stamp.read_text() != wanted:
        print(f"installing {', '.join(REQUIREMENTS[engine])}", file=sys.stderr)
        subprocess.run([sys.executable, "-m", "venv", "--clear", venv], check=True)
        pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        subprocess.run([*pip, *REQUIREMENTS[engine]], check=True)
        stamp.write_text(wanted)
    return python


def environment(threads: int = 0) -> dict[str, str]:
    """Return this process's environment without variables of NovaPhy, except the plugin path."""
    env = {k: v for k, v in os.environ.items() if not k.startswith(("NOVAPHY_", "NOVA_"))}
    if (
        "NOVAPHY_BACKEND_PATH" in os.environ
    ):  # set for a build tree; not needed for an installed package
        env["NOVAPHY_BACKEND_PATH"] = os.environ["NOVAPHY_BACKEND_PATH"]
    if threads:
        env["NOVAPHY_NUM_THREADS"] = str(threads)
    return env


def run(python: Path | str, script: str, *arguments: object, threads: int = 0) -> dict[str, object]:
    """Run a benchmark program. Return the record in its last line."""
    command = [str(python), str(BENCH / script), *map(str, arguments)]
    done = subprocess.run(
        command, env=environment(threads), stdout=subprocess.PIPE, text=True, check=True
    )
    record = json.loads(done.stdout.splitlines()[-1])
    print(json.dumps(record), flush=True)
    return record


def free_memory() -> int:
    """Return the bytes that a program can still allocate."""
    for line in Path("/proc/meminfo").read_text().splitlines():
        if line.startswith("MemAvailable"):
            return int(line.split()[1]) * 1024
    raise SystemExit("run_peers: /proc/meminfo does not tell the free memory")


def measure(column: str, n: int, iterations: int) -> dict[str, object]:
    """Run a measurement of a column. Return its record, with `skipped` if it did not run."""
    engine, mode, threads = COLUMNS[column]
    needed = NEEDED_BYTES.get(engine, NEEDED_BYTES.get(mode, 0)) * n * SUBSTEPS
    if needed > free_memory():
        return {"engine": engine, "skipped": f"needs {needed / 2**30:.0f} GiB"}
    options = ["--n", n, "--mode", mode, "--iterations", iterations]
    return run(python_of(engine), f"{engine}_ball.py", *options, threads=threads)


def check_losses() -> tuple[float, dict[str, str]]:
    """Return the first loss of one ball, which must agree in all engines, and their versions."""
    records = {column: measure(column, 1, 1) for column in COLUMNS}
    losses = {c: float(r["loss"]) for c, r in records.items() if "skipped" not in r}
    exact = {loss for c, loss in losses.items() if COLUMNS[c][0] in SAME_BITS}
    expected = losses[BEST]
    if len(exact) != 1 or any(abs(v - expected) > RELATIVE * expected for v in losses.values()):
        raise SystemExit(f"run_peers: the losses of the first iteration differ: {losses}")
    versions = {COLUMNS[c][0]: str(r["version"]) for c, r in records.items() if "version" in r}
    return expected, versions


def check_hashes(records: list[dict[str, object]]) -> bool:
    """Return whether final positions and gradients of Newton and all modes of NovaPhy are equal."""
    ran = [r for r in records if "result_hash" in r]
    hashes = {e: {r["result_hash"] for r in ran if r["engine"] == e} for e in SAME_BITS}
    if len(hashes["novaphy"]) > 1:
        raise SystemExit(f"run_peers: the results of NovaPhy differ: {sorted(hashes['novaphy'])}")
    return hashes["newton"] == hashes["novaphy"]


def iterations_for(n: int) -> int:
    """Return the number of timed iterations in a measurement."""
    return 30 if n <= 1000 else 5


class Results:
    """The results of all measurements, by number of balls and column."""

    def __init__(self, sizes: list[int], rounds: int, slow: float) -> None:
        """Run the measurements of all engines, in alternating order."""
        self.seconds: dict[int, dict[str, float]] = {}  # median times (s)
        self.first: dict[int, dict[str, float]] = {}  # times until the first iteration is done (s)
        self.skipped: dict[int, dict[str, str]] = {}
        self.same: list[int] = []  # sizes with equal bits in Newton and NovaPhy
        before = 0
        for n in sorted(sizes):
            records: dict[str, list[dict[str, object]]] = {column: [] for column in COLUMNS}
            self.skipped[n] = {}
            for _ in range(rounds):
                for column in [c for c in COLUMNS if c not in self.skipped[n]]:
                    expected = self.seconds.get(before, {}).get(column, 0.0) * n / max(before, 1)
                    if before and (column in self.skipped[before] or expected > slow):
                        self.skipped[n][column] = self.skipped[before].get(column, "too slow")
                        continue
                    record = measure(column, n, iterations_for(n))
                    if "skipped" in record:
                        self.skipped[n][column] = str(record["skipped"])
                    else:
                        records[column].append(record)
            if check_hashes([r for column in COLUMNS for r in records[column]]):
                self.same.append(n)
            self.seconds[n] = self.medians(records, "median_s")
            self.first[n] = self.medians(records, "first_s")
            before = n

    @staticmethod
    def medians(records: dict[str, list[dict[str, object]]], key: str) -> dict[str, float]:
        """Return the medians of a value over the rounds, by column."""
        return {c: statistics.median(float(r[key]) for r in rs) for c, rs in records.items() if rs}

    def cell(self, n: int, column: str) -> str:
        """Return the time of an iteration as text, or the reason why there is none."""
        if column in self.skipped[n]:
            return self.skipped[n][column]
        return duration(self.seconds[n][column])

    def ratio(self, n: int, slow: str, fast: str) -> str:
        """Return as text how many times faster one column is than another."""
        times = self.seconds[n]
        return f"{times[slow] / times[fast]:.3g}" if slow in times and fast in times else "–"


def copy_bandwidth(threads: int) -> float:
    """Return the bytes per second of a copy that is larger than the caches, the best of 5."""
    source = np.ones(COPY_BYTES, np.uint8)
    target = np.empty_like(source)
    parts = list(zip(np.array_split(target, threads), np.array_split(source, threads)))
    best = float("inf")
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(6):  # the first round touches the pages
            start = time.perf_counter()
            list(pool.map(lambda part: np.copyto(*part), parts))
            best = min(best, time.perf_counter() - start)
    return 2 * COPY_BYTES / best


def instructions(mode: str) -> str:
    """Return the instructions of an iteration of one ball by callgrind, or the reason for none."""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        return "not counted: valgrind is not installed"
    # callgrind would also count waiting threads of NumPy.
    env = environment(threads=1) | {"NOVAPHY_CPU_ISA": "avx2", "OPENBLAS_NUM_THREADS": "1"}
    counts = {}
    few, many = 10, 410
    for iterations in (few, many):
        command = [valgrind, "--tool=callgrind", "--callgrind-out-file=/dev/null", sys.executable]
        command += [str(BENCH / "novaphy_ball.py"), "--mode", mode, "--n", "1"]
        command += ["--iterations", str(iterations)]
        done = subprocess.run(command, env=env, capture_output=True, text=True)
        found = re.search(r"I\s+refs:\s+([\d,]+)", done.stderr)
        if done.returncode != 0 or found is None:
            return f"not counted: valgrind ended with {done.returncode}"
        counts[iterations] = int(found[1].replace(",", ""))
    each = (counts[many] - counts[few]) / (many - few)
    return f"{each:,.0f} ({each / SUBSTEPS:,.0f} per substep)"


def cpu_name() -> str:
    """Return the name of the processor."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.machine()


def machine() -> Iterator[tuple[str, str]]:
    """Yield facts about the machine of the measurements."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    yield "processor", f"{cpu_name()}, {len(os.sched_getaffinity(0))} CPUs used"
    yield "memory", f"{memory:.0f} GiB"
    yield "system", platform.freedesktop_os_release()["PRETTY_NAME"]
    yield "Python", platform.python_version()


def duration(seconds: float) -> str:
    """Return a duration as text with three digits."""
    return f"{seconds:.3g} s" if seconds >= 1 else f"{seconds * 1e3:.3g} ms"


def rows(header: list[str], body: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [header, ["---"] * len(header), *body]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def bandwidth_rows(results: Results, operations: float) -> list[list[str]]:
    """Return rows with the bytes and operations per second of the rollout."""
    body = []
    for n, seconds in results.seconds.items():
        if BEST in seconds:
            per_second = n * SUBSTEPS / seconds[BEST]
            moved, done = MOVED_BYTES * per_second / 1e9, operations * per_second / 1e9
            body.append([f"{n:,}", f"{moved:.3g}", f"{done:.3g}", f"{1e9 / per_second:.3g} ns"])
    return body


def memory_of(record: dict[str, object]) -> tuple[float, float, float]:
    """Return the bytes for each particle and substep: states; tape and gradients; both together."""
    states, tape = float(record["states_bytes"]), float(record["tape_bytes"])
    return states, tape, states + tape


def bytes_text(count: float) -> str:
    """Return a number of bytes as text with one decimal."""
    return f"{count:.1f}"


def page(
    results: Results,
    versions: dict[str, str],
    loss: float,
    start: dict[str, object],
    memory: list[dict[str, object]],
    bandwidth: dict[int, float],
    counted: dict[str, object],
    callgrind: dict[str, str],
    rounds: int,
) -> str:
    """Return the text of docs/performance.md."""
    sizes = list(results.seconds)
    by_size = [f"N = {n:,}" for n in sizes]
    times = [[c, *(results.cell(n, c) for n in sizes)] for c in COLUMNS]
    firsts = [
        [c, *(duration(results.first[n][c]) if c in results.first[n] else "–" for n in sizes)]
        for c in COLUMNS
    ]
    ratios = [
        [name, *(results.ratio(n, slow, fast) for n in sizes)]
        for name, (slow, fast) in RATIOS.items()
    ]
    names = {"newton": "Newton (Warp 1.19.0)", "jax": "JAX", "drjit": "Dr.Jit"}
    facts = [*machine(), *((names.get(e, "NovaPhy"), v) for e, v in versions.items())]
    equal = ", ".join(f"{n:,}" for n in results.same) or "none"
    operations = float(counted["operations"])
    used = [[str(m["mode"]), *map(bytes_text, memory_of(m))] for m in memory]
    copies = ", ".join(f"{b / 1e9:.3g} GB/s with {t} thread(s)" for t, b in bandwidth.items())
    programs = counted["programs"]
    return f"""# Performance

Written by `tools/bench/run_peers.py`; do not edit. Everything on this page was measured in one run.

{rows(["", ""], [list(fact) for fact in facts])}

## The ball, N times

One iteration has 288 substeps with contacts, the loss, `backward`, and the update of velocities.
Its time is the median over {rounds} processes, which take turns, of the median in each.

The loss of the first iteration of one ball, {loss!r}, is the same bits in every column of Newton
and NovaPhy. The other columns are within {RELATIVE:g} of it. After the last iteration, the
positions and the gradient have the same bits in Newton and NovaPhy for N = {equal}.

{rows(["", *by_size], times)}

How many times faster NovaPhy is (below 1: slower):

{rows(["", *by_size], ratios)}

* Newton: *eager* is a Python loop over the substeps, recorded anew in every iteration. *captured*
  is recorded once and replayed. *captured, lean* has a pipeline without rigid contacts, which
  spares it a kernel that does nothing in this scene. Its CPU device (Warp) runs on one thread.
* JAX: `jit(value_and_grad(scan))`, written for this page (`tools/bench/jax_ball.py`). *full* has
  every term of the contact law; in *lean*, the terms that are zero in this scene are left out by
  hand. The bits are not those of the other engines.
* Dr.Jit: LLVM backend, substeps unrolled, the *lean* law (`tools/bench/drjit_ball.py`). *frozen*
  replays a recording, otherwise Python traces every iteration.
* NovaPhy computes the full law. *step*: a Python loop over the substeps, recorded anew in every
  iteration. *rollout*: one call for all substeps. *captured*: recorded once and replayed. *leaves*:
  the same on a tape that keeps the gradients of leaves only. All CPUs, unless it says 1 thread.

The time from the start of building the scene until the first iteration is done, with all compiling
and tracing. Newton's kernels come compiled from its cache; imports are not included.

{rows(["", *by_size], firsts)}

## Bandwidth and operations

Copying {COPY_BYTES >> 20} MiB (bytes read and written): {copies}.

Counted are {MOVED_BYTES} bytes per particle and substep: the new position and velocity, 24 bytes,
are written, and the adjoint reads them. Where a trajectory exceeds the caches, the adjoint reads
them only in substeps in which a contact touches (design note 0008). More may then seem to move than
a copy moves. Data that can stay in the caches are not counted: contacts, materials, the gradients
from one substep to the next.

The Programs of a substep and its adjoint hold {programs["step_particles"]} and
{programs["step_particles.adjoint"]} float32 operations per particle with its two contacts. A fused
multiply-add is two, a comparison or selection none: {operations / MOVED_BYTES:.3g} operations per
byte. The number is an upper bound, and so are the operations per second below. The kernels skip
work that no lane of a vector takes, friction for one, and most balls touch nothing most of the
time. The rows are those of *leaves*:

{
        rows(
            ["N", "GB/s moved", "10⁹ operations/s, at most", "per particle and substep"],
            bandwidth_rows(results, operations),
        )
    }

Instructions per iteration for N = 1, by callgrind, which knows no AVX-512, as the difference of two
runs: *captured* {callgrind["captured"]}, *leaves* {callgrind["leaves"]}.

## Start-up

From starting `python` until the gradient of the ball is printed, in a fresh process:
{duration(float(start["median_s"]))} (median of {start["runs"]}; {duration(float(start["min_s"]))}
to {duration(float(start["max_s"]))}).

## Memory

Bytes per particle and substep, N = {memory[0]["n"]:,}, in the resident set: the states, then the
tape and all gradients. {SUBSTEPS} substeps have {SUBSTEPS + 1} states; positions and velocities are
24 bytes of each.

{rows(["", "states", "tape and gradients", "together"], used)}

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
    sizes = [1, 10, 100, 1000, 10_000, 100_000, 1_000_000]
    parser.add_argument("--n", type=int, nargs="+", default=sizes, help="balls")
    parser.add_argument("--rounds", type=int, default=3, help="processes per measurement")
    parser.add_argument(
        "--slow", type=float, default=60.0, help="leave out iterations expected to take longer (s)"
    )
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "performance.md")
    arguments = parser.parse_args()
    if min(arguments.n) < 1 or arguments.rounds < 1:
        parser.error("--n and --rounds must be positive")

    loss, versions = check_losses()
    bandwidth = {t: copy_bandwidth(t) for t in sorted({1, len(os.sched_getaffinity(0))})}
    print(json.dumps({"measure": "copy", "bytes_per_s": bandwidth}), flush=True)
    results = Results(arguments.n, arguments.rounds, arguments.slow)
    start = run(sys.executable, "start_up.py")
    memory = [
        run(sys.executable, "novaphy_ball.py", "--memory", "--n", 100_000, "--mode", mode)
        for mode in ("step", "rollout", "leaves")
    ]
    counted = run(sys.executable, "novaphy_ball.py", "--operations", "--mode", "leaves")
    callgrind = {mode: instructions(mode) for mode in ("captured", "leaves")}
    text = page(
        results,
        versions,
        loss,
        start,
        memory,
        bandwidth,
        counted,
        callgrind,
        arguments.rounds,
    )
    temporary = arguments.output.with_suffix(".md.part")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(arguments.output)
    print(f"written: {arguments.output}", file=sys.stderr)


if __name__ == "__main__":
    main()
