#!/usr/bin/env python3
"""Time a linear layer, x @ weight.T, and its two gradients: NovaPhy and torch, on one thread.

The engines take turns. Prints a JSON line: milliseconds (the fastest round), their ratio, and a
hash of the result.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Callable

import numpy as np
import torch

import novaphy
from novaphy import nova


def seconds(function: Callable[[], object]) -> float:
    """Return the time (s) of one call."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def main() -> None:
    """Measure one size, and print the line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, nargs=3, default=(4096, 256, 256), metavar="N")
    parser.add_argument("--turns", type=int, default=15)
    arguments = parser.parse_args()
    novaphy.set_num_threads(1)
    torch.set_num_threads(1)
    n, k, m = arguments.size
    rng = np.random.default_rng(0)
    x, w = (rng.normal(size=s).astype(np.float32) for s in ((n, k), (m, k)))
    ours = [nova.tensor(v, requires_grad=True) for v in (x, w)]
    theirs = [torch.tensor(v, requires_grad=True) for v in (x, w)]

    def train() -> None:
        with nova.Tape() as tape:
            tape.backward(nova.sum(nova.linear(*ours)))

    programs = {
        "forward": lambda: nova.linear(*ours),
        "forward_torch": lambda: torch.nn.functional.linear(*theirs).detach(),
        "gradient": train,
        "gradient_torch": lambda: torch.nn.functional.linear(*theirs).sum().backward(),
    }
    fastest = dict.fromkeys(programs, float("inf"))
    for _ in range(arguments.turns):
        for name, program in programs.items():
            fastest[name] = min(fastest[name], seconds(program))
    result = {name + "_ms": round(1e3 * value, 3) for name, value in fastest.items()}
    for name in ("forward", "gradient"):
        result[name + "_ratio"] = round(fastest[name] / fastest[name + "_torch"], 2)
    result["hash"] = hashlib.sha256(nova.linear(*ours).numpy().tobytes()).hexdigest()[:16]
    print(json.dumps({"size": [n, k, m]} | result))


if __name__ == "__main__":
    main()
