#!/usr/bin/env python3
"""Run scaling.py on 1, 2, 4 and 8 GPUs of a host: bits, weak and strong scaling, sum, restart.
    python tools/bench/run_scaling.py --gpus 1 2 4 8
    python tools/bench/run_scaling.py --gpus --ranks 1 2 4 --small --output /tmp/scaling

A row is a run of torchrun with one process for each GPU, or a run of one process with one thread
for each GPU. `--ranks` adds runs on the CPU. The rows append JSON lines to OUTPUT/lines.jsonl. A
row in this file does not run again, but a row that failed does. At the end the program writes
OUTPUT/page.md and OUTPUT/scaling.png. The exit code is 1 if hashes differ or a check fails.
`--small` uses few worlds, to try the program.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from run_peers import BENCH, ROOT, environment, rows

DEMO = ROOT / "python" / "demos" / "diff" / "demo_distributed.py"
# Scene -> options of scaling.py. Boxes have fewer steps, because sixty would take ten times longer.
SCENES = {"ants": [], "cloth": [], "boxes": ["--steps", 20]}
LIMIT = 400.0  # time limit of a row (s)
LINE = re.compile(r"\{.*\}$")
TORCHRUN = "torchrun --standalone"

Line = dict[str, object]


class Runs:
    """The JSON lines of all rows, which are stored in a file."""

    def __init__(self, folder: Path, launcher: str) -> None:
        self.launcher = launcher.split()
        folder.mkdir(parents=True, exist_ok=True)
        self.file = folder / "lines.jsonl"
        text = self.file.read_text() if self.file.exists() else ""
        self.lines: list[Line] = [json.loads(line) for line in text.splitlines()]

    def add(self, row: str, where: str, count: int, lines: list[Line]) -> None:
        """Add the lines of a row on `count` ranks or threads. The file gets successful lines."""
        with self.file.open("a") as file:
            for line in lines:
                self.lines.append({"row": row, "where": where, "count": count, **line})
                if "failed" not in line:
                    print(json.dumps(self.lines[-1]), file=file)

    def of(self, row: str, **wanted: object) -> list[Line]:
        """Return the lines of a row that have the given values."""
        return [
            line
            for line in self.lines
            if line["row"] == row and all(line.get(k) == v for k, v in wanted.items())
        ]

    def run(
        self, row: str, where: str, count: int, options: list[object], scene: str | None = None
    ) -> None:
        """Run scaling.py for a row, unless the file has the row."""
        own = {"scene": scene} if scene else {}
        if self.of(row, where=where, count=count, **own):
            return
        begin = time.monotonic()
        command = self.command(where, count, [*scene_options(scene), *options])
        try:
            done = subprocess.run(
                command, env=environment(threads_of(where, count)), text=True, capture_output=True,
                timeout=LIMIT,
            )  # fmt: skip
            text, code, error = done.stdout, done.returncode, done.stderr[-2000:]
        except subprocess.TimeoutExpired:
            text, code, error = "", 1, f"more than {LIMIT:g} s"
        lines = [json.loads(found[0]) for t in text.splitlines() if (found := LINE.search(t))]
        if code or not lines:
            lines = [{**own, "failed": error}]
        self.add(row, where, count, lines)
        print(f"{row} {scene or ''} {count} {where}: {time.monotonic() - begin:.0f} s", flush=True)

    def command(self, where: str, count: int, options: list[object]) -> list[str]:
        """Return the command of a row: one process for each rank, or one thread for each GPU."""
        if where == "threads":
            devices: list[object] = ["--device", *(f"cuda:{k}" for k in range(count))]
            start: list[object] = [sys.executable]
        else:
            devices = ["--device", "cuda" if where == "GPU" else "cpu"]
            start = [*self.launcher, f"--nproc_per_node={count}"]
        return [str(part) for part in (*start, BENCH / "scaling.py", *options, *devices)]


def threads_of(where: str, count: int) -> int:
    """Return the threads of a rank: CPU ranks share the cores; 0: all threads of the machine."""
    return max(1, len(os.sched_getaffinity(0)) // count) if where == "CPU" else 0


def scene_options(scene: str | None) -> list[object]:
    """Return the options of scaling.py for a scene."""
    return ["--scene", scene, *SCENES[scene]] if scene else []


def worlds_of(args: argparse.Namespace) -> tuple[int, int, int]:
    """Return the worlds per GPU of weak scaling, of all GPUs of strong scaling, and of a block."""
    return (8, 32, 4) if args.small else (16_384, 65_536, 4_096)


def measure(args: argparse.Namespace, runs: Runs) -> None:
    """Run all rows of scaling.py."""
    weak, strong, block = worlds_of(args)
    places = [("GPU", n) for n in args.gpus] + [("threads", n) for n in args.gpus if n > 1]
    places += [("CPU", n) for n in args.ranks if args.small]
    most = max(args.gpus, default=0)
    common = ["--repeats", args.repeats, "--block", block]
    # CPU runs have fewer worlds. The same worlds also run on the most GPUs.
    few = ["--repeats", 0, "--iterations", 10, "--worlds", args.few,
           "--block", args.few // max(8, most)]  # fmt: skip
    for scene in args.scenes:
        for where, count in places:
            options = [*common, "--worlds", strong, "--iterations", 10]
            runs.run("strong", where, count, options, scene)
        for where, count in places:
            options = [*common, "--worlds", weak * count, "--iterations", 1]
            runs.run("weak", where, count, options, scene)
        for where, count in [("CPU", n) for n in args.ranks] + [("GPU", most)] * bool(most):
            runs.run("bits", where, count, few, scene)
    for where, count in [("GPU", n) for n in args.gpus] or [("CPU", n) for n in args.ranks]:
        runs.run("sum", where, count, ["--reduction", "--repeats", 5])


def ranks_of(where: str, count: int, options: list[object]) -> list[subprocess.Popen]:
    """Start the ranks of the demo directly, so that a rank can be killed."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    shared = {
        **environment(threads_of(where, count)),
        "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": str(count),
    }  # fmt: skip
    processes = []
    for rank in range(count):
        device = f"cuda:{rank}" if where == "GPU" else "cpu"
        command = [sys.executable, str(DEMO), *map(str, options), "--device", device]
        env = {**shared, "RANK": str(rank), "LOCAL_RANK": str(rank)}
        processes.append(
            subprocess.Popen(
                command, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            )
        )
    return processes


def last_lines(processes: list[subprocess.Popen]) -> list[str]:
    """Wait for each process, and return its last line."""
    return [(p.communicate(timeout=LIMIT)[0].strip().splitlines() or [""])[-1] for p in processes]


def restart(runs: Runs, folder: Path, where: str, count: int) -> None:
    """Kill a rank, and restart from a checkpoint with half of the ranks."""
    if count < 2 or runs.of("restart", where=where, count=count):
        return
    options: list[object] = ["--worlds", 1024 * count, "--block", 256]
    processes = ranks_of(where, count, [*options, "--iterations", 100_000])
    time.sleep(30)
    alive = all(p.poll() is None for p in processes)
    begin = time.monotonic()
    processes[-1].send_signal(signal.SIGKILL)
    ends = last_lines(processes)
    seconds = time.monotonic() - begin
    whole = last_lines(ranks_of(where, count, [*options, "--iterations", 40]))[0]
    kept = folder / "restart.npz"
    last_lines(ranks_of(where, count, [*options, "--iterations", 20, "--save", kept]))
    half = last_lines(
        ranks_of(where, count // 2, [*options, "--iterations", 40, "--resume", kept])
    )[0]
    line: Line = {
        "killed_while_running": alive, "ended_after_s": seconds, "error": ends[0],
        "rank_named": f"rank {count - 1}" in ends[0],
        "same_bits": len(whole) == 64 and whole == half,
    }  # fmt: skip
    runs.add("restart", where, count, [line])
    print("restart", count, where, json.dumps(line), flush=True)


def faults_of(runs: Runs) -> list[str]:
    """Return messages for failed rows, for runs with different hashes, and for failed restarts."""
    faults = [f"{r['row']} {r.get('scene', '')} {r['count']} {r['where']}: {r['failed']}"
              for r in runs.lines if "failed" in r]  # fmt: skip
    groups: dict[tuple, set] = {}
    for line in runs.lines:
        if "gradients" in line:
            same = tuple(line[k] for k in ("scene", "steps", "worlds", "block", "iterations"))
            groups.setdefault(same, set()).add((line["gradients"], line["parameters"]))
    faults += [f"hashes differ: {group}" for group, found in groups.items() if len(found) > 1]
    for line in runs.of("restart"):
        if not (line["same_bits"] and line["rank_named"] and line["killed_while_running"]):
            faults.append(f"restart: {line}")
    return faults


def timed(runs: Runs, row: str) -> list[Line]:
    """Return the lines of a row that have times."""
    found = [line for line in runs.of(row) if "iteration_s" in line]
    return sorted(found, key=lambda r: (r["scene"], r["where"], r["count"]))


def scaling_rows(runs: Runs, row: str) -> list[list[str]]:
    """Return the table cells of weak or strong scaling. Threads are compared with one process."""
    cells = []
    for line in timed(runs, row):
        where = "GPU" if line["where"] == "threads" else line["where"]
        one = next((r for r in timed(runs, row)
                    if (r["scene"], r["where"], r["count"]) == (line["scene"], where, 1)),
                   None)  # fmt: skip
        share = 1 if row == "weak" else line["count"]
        keys = ("forward_s", "iteration_s")
        ratios = [f"{one[key] / (share * line[key]):.3f}" if one else "–" for key in keys]
        cells.append([
            line["scene"], line["where"], str(line["count"]), str(line["worlds"]),
            *(f"{line[key]:.3f}" for key in keys), *ratios, f"{line['idle']:.3f}",
        ])  # fmt: skip
    return cells


def page(runs: Runs, faults: list[str]) -> str:
    """Return the text of the page with the tables of all rows."""
    head = ["scene", "by", "ranks", "worlds", "forward (s)", "iteration (s)",
            "forward, part of one", "iteration, part of one", "idle"]  # fmt: skip
    sums = [[r["where"], str(r["ranks"]), f"{r['parameters']:.0e}", f"{1e3 * r['reduction_s']:.2f}"]
            for r in runs.of("sum") if "reduction_s" in r]  # fmt: skip
    ends = [[r["where"], str(r["count"]), f"{r['ended_after_s']:.1f}", str(r["rank_named"]),
             str(r["same_bits"])] for r in runs.of("restart")]  # fmt: skip
    killed = ["by", "ranks", "ended after (s)", "error names the rank",
              "restart with half of the ranks has the same bits"]  # fmt: skip
    return "\n\n".join([
        "# Scaling over GPUs",
        "## Weak scaling", rows(head, scaling_rows(runs, "weak")),
        "## Strong scaling", rows(head, scaling_rows(runs, "strong")),
        "## The sum alone", rows(["by", "ranks", "parameters", "ms"], sums),
        "## A rank is killed", rows(killed, ends),
        "## Hashes", "\n".join(faults or ["All hashes are equal."]),
    ]) + "\n"  # fmt: skip


def picture(runs: Runs, path: Path) -> None:
    """Draw weak and strong scaling over the number of GPUs."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for axis, row in zip(axes, ("weak", "strong"), strict=True):
        found = [r for r in timed(runs, row) if r["where"] != "threads"]
        for scene in dict.fromkeys(r["scene"] for r in found):
            lines = [r for r in found if r["scene"] == scene]
            rates = [r["worlds"] / r["iteration_s"] for r in lines]
            counts = [r["count"] for r in lines]
            axis.plot(counts, [x / rates[0] for x in rates], "o-", label=scene)
            axis.plot(counts, counts, color="#adb5bd", linewidth=0.8, zorder=0)
        axis.set(title=f"{row} scaling", xlabel="ranks", ylabel="rate, relative to the first")
        axis.legend()
    figure.savefig(path, dpi=120)


def main() -> int:
    """Run the rows that the file does not have, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gpus", type=int, nargs="*", default=[1, 2], help="counts of GPUs")
    parser.add_argument("--ranks", type=int, nargs="*", default=[4], help="counts of CPU ranks")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    parser.add_argument("--repeats", type=int, default=20, help="timed iterations")
    parser.add_argument("--few", type=int, default=1024, help="worlds of the runs on the CPU")
    parser.add_argument("--small", action="store_true", help="few worlds everywhere")
    parser.add_argument("--launcher", default=TORCHRUN, help="without the number of processes")
    parser.add_argument("--output", type=Path, default=Path("build/scaling"))
    args = parser.parse_args()
    runs = Runs(args.output, args.launcher)
    measure(args, runs)
    restart(runs, args.output, "GPU" if args.gpus else "CPU", max(args.gpus or args.ranks))
    faults = faults_of(runs)
    (args.output / "page.md").write_text(page(runs, faults))
    picture(runs, args.output / "scaling.png")
    print("\n".join(faults or ["all hashes are equal"]))
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
