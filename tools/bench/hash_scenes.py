#!/usr/bin/env python3
"""Hash states and gradients of the scenes of tools/bench after a few steps, and compare them.
    python tools/bench/hash_scenes.py              # compare with tests/golden/scenes.txt
    python tools/bench/hash_scenes.py --write      # write this file
    python tools/bench/hash_scenes.py --print --scene ball fr3

Each scene runs with one thread and with two, and with every instruction set of the processor. All
hashes must be the same. With --device cuda:0, scenes that support devices run on that device
instead. A line of the file has the scene, the name of the hashed array, and the hash. "inputs" is
the hash of a scene's initial values. If this hash differs, NumPy computed other values, and the
engine is not the cause.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from hashed_scenes import ON_DEVICES, SCENES

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden" / "scenes.txt"
LEVELS = {"baseline": "", "avx2": "avx2", "avx512": "avx512f"}  # level -> processor feature


def digest(arrays: list[np.ndarray]) -> str:
    """Return the hash of the bits of float32 values. ValueError: a value is NaN."""
    found = hashlib.sha256()
    for array in arrays:
        values = np.ascontiguousarray(array, np.float32)
        if not np.isfinite(values).all():
            raise ValueError("a number that is not finite")
        found.update(values.tobytes())
    return found.hexdigest()[:16]


def run(names: list[str], device: str) -> None:
    """Print the lines of scenes, which run in this process."""
    import novaphy

    for name in names:
        for what, arrays in SCENES[name](device).items():
            if what != "inputs" and not any(np.any(array) for array in arrays):
                raise ValueError(f"{name}, {what}: nothing but zeros")
            print(f"{name} | {what} | {digest(arrays)}", flush=True)
        novaphy.synchronize(device)


def in_process(label: str, names: list[str], **environment: str) -> tuple[str, list[str]]:
    """Hash scenes in a separate process with the given environment. Return label and lines."""
    device = environment.pop("device", "cpu")
    command = [sys.executable, __file__, "--print", "--device", device, "--scene", *names]
    done = subprocess.run(
        command, env=os.environ | environment, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise SystemExit(f"{label}: {done.stderr[-2000:]}")
    return label, done.stdout.splitlines()


def runs(device: str) -> list[tuple[str, dict[str, str]]]:
    """Return the label and the environment of every way to run a scene."""
    if device != "cpu":
        return [(device, {"device": device})]
    flags = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    wanted = [("cpu, 1 thread", {"NOVAPHY_NUM_THREADS": "1"})]
    for level, flag in LEVELS.items():
        if flag in flags:
            two = {"NOVAPHY_NUM_THREADS": "2", "NOVAPHY_CPU_ISA": level}
            wanted.append((f"cpu, {level}, 2 threads", two))
    return wanted


def differences(label: str, lines: list[str], golden: dict[str, str]) -> list[str]:
    """Return the differences between the lines of a run and the golden lines of its scenes."""
    found = dict(line.rsplit(" | ", 1) for line in lines)
    scenes = {name.split(" | ")[0] for name in found}
    wanted = [name for name in golden if name.split(" | ")[0] in scenes]
    return [
        f"{label}: {name}: expected {golden.get(name, 'no line')}, got {found.get(name, 'none')}"
        for name in dict.fromkeys([*wanted, *found])
        if golden.get(name) != found.get(name)
    ]


def main() -> int:
    """Print, write or compare the hashes. Return 0 if no hash differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="write the file")
    parser.add_argument("--print", action="store_true", help="print the hashes of one run")
    parser.add_argument("--device", default="cpu", help="where the scenes run")
    parser.add_argument("--scene", nargs="+", choices=SCENES, default=list(SCENES))
    arguments = parser.parse_args()
    if arguments.write and (arguments.device != "cpu" or set(arguments.scene) != set(SCENES)):
        parser.error("--write: expected all scenes, on the cpu")
    if arguments.print:
        run(arguments.scene, arguments.device)
        return 0
    jobs = [
        (label, [n for n in arguments.scene if "device" not in env or n in ON_DEVICES], env)
        for label, env in runs(arguments.device)
    ]
    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(lambda job: in_process(job[0], job[1], **job[2]), jobs))
    if arguments.write:
        GOLDEN.write_text("".join(line + "\n" for line in results[0][1]), encoding="utf-8")
    lines = GOLDEN.read_text(encoding="utf-8").splitlines()
    golden = dict(line.rsplit(" | ", 1) for line in lines)
    faults = [f for label, found in results for f in differences(label, found, golden)]
    for fault in faults:
        print(fault)
    count = max(len(names) for _, names, _ in jobs)
    print(f"hash_scenes: {count} scenes, {len(jobs)} runs, {len(faults)} differ")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
