#!/usr/bin/env python3
"""Run scaling.py on 1, 2, 4 and 8 GPUs of a host: bits, weak and strong scaling, sum, restart.

    python tools/bench/run_scaling.py --gpus 1 2 4 8
    python tools/bench/run_scaling.py --gpus --ranks 1 2 4 --small --output /tmp/scaling

Each row is a run of torchrun with one process a GPU, or a run of one process with a thread a GPU.
`--ranks` adds runs on the CPU. All rows append lines of JSON to OUTPUT/lines.jsonl; a row that is
there is not run again. Then OUTPUT/page.md and OUTPUT/scaling.png are written. The result is 1
where hashes differ or a check fails. `--small` takes few worlds, to try the program.
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

HERE = Path(__file__).resolve().parent
SCALING = HERE / "scaling.py"
DEMO = HERE.parent.parent / "python/demos/diff/demo_distributed.py"
# Scene -> options of scaling.py. Sixty steps of boxes would take ten times what the others take.
SCENES = {"ants": [], "cloth": [], "boxes": ["--steps", 20]}
LIMIT = 400.0  # s, for a row
LINE = re.compile(r"\{.*\}$")
TORCHRUN = "torchrun --standalone"

Line = dict[str, object]


class Runs:
    """The lines of all rows, kept in a file."""

    def __init__(self, folder: Path, launcher: str) -> None:
        self.launcher = launcher.split()
        folder.mkdir(parents=True, exist_ok=True)
        self.file = folder / "lines.jsonl"
        text = self.file.read_text() if self.file.exists() else ""
        self.lines: list[Line] = [json.loads(line) for line in text.splitlines()]

    def add(self, row: str, where: str, count: int, lines: list[Line]) -> None:
        """Keeps the lines of a row on `count` ranks or threads."""
        with self.file.open("a") as file:
            for line in lines:
                self.lines.append({"row": row, "where": where, "count": count, **line})
                print(json.dumps(self.lines[-1]), file=file)

    def of(self, row: str, **wanted: object) -> list[Line]:
        """The lines of a row with some values."""
        return [
            line
            for line in self.lines
            if line["row"] == row and all(line.get(k) == v for k, v in wanted.items())
        ]

    def run(self, row: str, where: str, count: int, options: list[object]) -> None:
        """Runs scaling.py, unless the file has the row."""
        scene = options[options.index("--scene") + 1] if "--scene" in options else None
        if self.of(row, where=where, count=count, **({"scene": scene} if scene else {})):
            return
        begin = time.monotonic()
        try:
            done = subprocess.run(
                self.command(where, count, options), env=environment(where, count), text=True,
                capture_output=True, timeout=LIMIT,
            )  # fmt: skip
            text, code = done.stdout, done.returncode
            error = done.stderr[-2000:]
        except subprocess.TimeoutExpired:
            text, code, error = "", 1, f"more than {LIMIT:g} s"
        lines = [json.loads(found[0]) for t in text.splitlines() if (found := LINE.search(t))]
        if code or not lines:
            lines = [{"scene": scene, "failed": error}]
        self.add(row, where, count, lines)
        print(f"{row} {scene or ''} {count} {where}: {time.monotonic() - begin:.0f} s", flush=True)

    def command(self, where: str, count: int, options: list[object]) -> list[str]:
        """The command of a row: one process a rank, or a thread a GPU."""
        if where == "threads":
            devices: list[object] = ["--device", *(f"cuda:{k}" for k in range(count))]
            start: list[object] = [sys.executable]
        else:
            devices = ["--device", "cuda" if where == "GPU" else "cpu"]
            start = [*self.launcher, f"--nproc_per_node={count}"]
        return [str(part) for part in (*start, SCALING, *options, *devices)]


def environment(where: str, count: int) -> dict[str, str]:
    """Ranks on the CPU share its cores; ranks on GPUs keep NCCL's variables of the host."""
    threads = {"NOVAPHY_NUM_THREADS": str(max(1, len(os.sched_getaffinity(0)) // count))}
    return {**os.environ, **(threads if where == "CPU" else {})}


def worlds_of(args: argparse.Namespace) -> tuple[int, int, int]:
    """Worlds a GPU of weak scaling, of all GPUs, and of a block."""
    return (8, 32, 4) if args.small else (16_384, 65_536, 4_096)


def measure(args: argparse.Namespace, runs: Runs) -> None:
    """Runs all rows of scaling.py."""
    weak, strong, block = worlds_of(args)
    places = [("GPU", n) for n in args.gpus] + [("threads", n) for n in args.gpus if n > 1]
    places += [("CPU", n) for n in args.ranks if args.small]
    most = max(args.gpus, default=0)
    for scene in args.scenes:
        own = ["--scene", scene, *SCENES[scene]]
        common = [*own, "--repeats", args.repeats, "--block", block]
        for where, count in places:
            options = [*common, "--worlds", strong, "--iterations", 10]
            runs.run("strong", where, count, options)
        for where, count in places:
            options = [*common, "--worlds", weak * count, "--iterations", 1]
            runs.run("weak", where, count, options)
        # The CPU takes fewer worlds, on the ranks of the CPU and on the most GPUs.
        few = [*own, "--repeats", 0, "--iterations", 10, "--worlds", args.few,
               "--block", args.few // max(8, most)]  # fmt: skip
        for where, count in [("CPU", n) for n in args.ranks] + [("GPU", most)] * bool(most):
            runs.run("bits", where, count, few)
    for where, count in [("GPU", n) for n in args.gpus] or [("CPU", n) for n in args.ranks]:
        runs.run("sum", where, count, ["--reduction", "--repeats", 5])


def ranks_of(count: int, device: str, options: list[object]) -> list[subprocess.Popen]:
    """Starts the ranks of the demo by hand, so that one of them can be killed."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    shared = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": str(count)}
    return [
        subprocess.Popen(
            [
                sys.executable,
                str(DEMO),
                *map(str, options),
                "--device",
                f"cuda:{rank}" if device == "cuda" else "cpu",
            ],
            env={
                **environment("GPU" if device == "cuda" else "CPU", count),
                **shared,
                "RANK": str(rank),
                "LOCAL_RANK": str(rank),
            },
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for rank in range(count)
    ]


def last_lines(processes: list[subprocess.Popen]) -> list[str]:
    """The last line of each process, after its end."""
    return [(p.communicate(timeout=LIMIT)[0].strip().splitlines() or [""])[-1] for p in processes]


def restart(runs: Runs, folder: Path, count: int, device: str) -> None:
    """Kills a rank, and goes on from a checkpoint with half of the ranks."""
    where = "GPU" if device == "cuda" else "CPU"
    if count < 2 or runs.of("restart", where=where, count=count):
        return
    options: list[object] = ["--worlds", 1024 * count, "--block", 256]
    processes = ranks_of(count, device, [*options, "--iterations", 100_000])
    time.sleep(30)
    alive = all(p.poll() is None for p in processes)
    begin = time.monotonic()
    processes[-1].send_signal(signal.SIGKILL)
    ends = last_lines(processes)
    seconds = time.monotonic() - begin
    whole = last_lines(ranks_of(count, device, [*options, "--iterations", 40]))[0]
    kept = folder / "restart.npz"
    last_lines(ranks_of(count, device, [*options, "--iterations", 20, "--save", kept]))
    half = last_lines(
        ranks_of(count // 2, device, [*options, "--iterations", 40, "--resume", kept])
    )[0]
    line: Line = {
        "killed_while_running": alive, "ended_after_s": seconds, "error": ends[0],
        "rank_named": f"rank {count - 1}" in ends[0],
        "same_bits": len(whole) == 64 and whole == half,
    }  # fmt: skip
    runs.add("restart", where, count, [line])
    print("restart", count, where, json.dumps(line), flush=True)


def hashes_differ(runs: Runs) -> list[str]:
    """The groups of runs whose hashes should be equal and are not, and what failed."""
    wrong = [f"{r['row']} {r['scene']} {r['count']} {r['where']}: {r['failed']}"
             for r in runs.lines if "failed" in r]  # fmt: skip
    groups: dict[tuple, set] = {}
    for line in runs.lines:
        if "gradients" in line:
            same = tuple(line[k] for k in ("scene", "steps", "worlds", "block", "iterations"))
            groups.setdefault(same, set()).add((line["gradients"], line["parameters"]))
    wrong += [f"hashes differ: {group}" for group, found in groups.items() if len(found) > 1]
    for line in runs.of("restart"):
        if not (line["same_bits"] and line["rank_named"] and line["killed_while_running"]):
            wrong.append(f"restart: {line}")
    return wrong


def table(head: list[str], rows: list[list[object]]) -> list[str]:
    """A table of Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(str(cell) for cell in row) + " |" for row in lines] + [""]


def page(runs: Runs) -> str:
    """The tables of all rows."""
    lines = ["# Scaling over GPUs", ""]
    for row, title in (("weak", "Weak scaling"), ("strong", "Strong scaling")):
        cells = []
        for line in sorted(runs.of(row), key=lambda r: (r["scene"], r["where"], r["count"])):
            if "iteration_s" not in line:
                continue
            where = "GPU" if line["where"] == "threads" else line["where"]
            one = runs.of(row, scene=line["scene"], where=where, count=1)
            parts = [1.0 if row == "weak" else 1.0 / line["count"]]
            ratio = [
                f"{one[0][key] * parts[0] / line[key]:.3f}" if one and key in one[0] else "–"
                for key in ("forward_s", "iteration_s")
            ]
            cells.append([
                line["scene"], line["where"], line["count"], line["worlds"],
                f"{line['forward_s']:.3f}", f"{line['iteration_s']:.3f}", *ratio,
                f"{line['idle']:.3f}",
            ])  # fmt: skip
        lines += [f"## {title}", "", *table(
            ["scene", "by", "ranks", "worlds", "forward (s)", "iteration (s)",
             "forward, part of one", "iteration, part of one", "idle"], cells)]  # fmt: skip
    sums = [[r["where"], r["ranks"], f"{r['parameters']:.0e}", f"{1e3 * r['reduction_s']:.2f}"]
            for r in runs.of("sum") if "reduction_s" in r]  # fmt: skip
    lines += ["## The sum alone", "", *table(["by", "ranks", "parameters", "ms"], sums)]
    ends = [[r["where"], r["count"], f"{r['ended_after_s']:.1f}", r["rank_named"], r["same_bits"]]
            for r in runs.of("restart")]  # fmt: skip
    lines += ["## A rank is killed", "", *table(
        ["by", "ranks", "ended after (s)", "error names the rank",
         "restart with half of the ranks has the same bits"], ends)]  # fmt: skip
    wrong = hashes_differ(runs)
    return "\n".join([*lines, "## Hashes", "", *(wrong or ["All hashes are equal."]), ""])


def picture(runs: Runs, path: Path) -> None:
    """Weak and strong scaling over GPUs."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for axis, row in zip(axes, ("weak", "strong"), strict=True):
        found = [r for r in runs.of(row) if "iteration_s" in r and r["where"] != "threads"]
        for scene in dict.fromkeys(r["scene"] for r in found):
            lines = sorted((r for r in found if r["scene"] == scene), key=lambda r: r["count"])
            rates = [r["worlds"] / r["iteration_s"] for r in lines]
            counts = [r["count"] for r in lines]
            axis.plot(counts, [x / rates[0] for x in rates], "o-", label=scene)
            axis.plot(counts, counts, color="#adb5bd", linewidth=0.8, zorder=0)
        axis.set(title=f"{row} scaling", xlabel="ranks", ylabel="rate, relative to the first")
        axis.legend()
    figure.savefig(path, dpi=120)


def main() -> int:
    """Run what is not in the file yet, and write the page."""
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
    restart(runs, args.output, max(args.gpus or args.ranks), "cuda" if args.gpus else "cpu")
    (args.output / "page.md").write_text(page(runs))
    picture(runs, args.output / "scaling.png")
    wrong = hashes_differ(runs)
    print("\n".join(wrong or ["all hashes are equal"]))
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
