#!/usr/bin/env python3
"""Compare gradients of the walking Ant with central differences, with more and more exact terms.

A frozen gradient treats contact points, normals and other terms as constant. Each row adds exact
terms to the gradient by the eight biases of demo_diffsim_ant_walk.py. The row has the cosine and
the ratio of norms with central differences of simulated rollouts, over H frames that begin with
walking Ants. No adjoint includes the begin and end of contacts. The last rows therefore use only
initial states whose sixteen displaced rollouts have the same pushing contacts in every step.
    python tools/bench/ant_gradient_terms.py
    python tools/bench/ant_gradient_terms.py --page      # the table of the guide
"""

from __future__ import annotations

import argparse
import functools
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
GUIDE = ROOT / "docs" / "guide" / "trained-policy.md"
sys.path[:0] = [str(ROOT / "python" / "demos"), str(ROOT / "python" / "demos" / "diff")]
import demo_diffsim_ant_walk as demo  # noqa: E402

# Name, kind of frames, exact terms.
ROWS = (
    ("frozen", "frozen", ()),
    ("frozen, and friction of contacts that stick", "frozen", ("sticking",)),
    ("frozen, and derivatives of mass matrix and bias", "frozen", ("dynamics",)),
    ("frozen, and observations across the refresh", "frozen", ("observations",)),
    ("frozen, and these three", "frozen", ("sticking", "dynamics", "observations")),
    ("exact, without observations across the refresh", "exact", ()),
    ("exact", "exact", ("observations",)),
)
FRAMES = (1, 2, 4, 8)
COLUMNS = "| gradient | " + " | ".join(f"H = {n}" for n in FRAMES) + " |"


class Watch:
    """Records whether all rollouts of a start have the same pushing contacts in every step."""

    def __init__(self, tuning: demo.Tuning, moves: int) -> None:
        """Prepare for worlds that simulate `moves` displacements of each start."""
        self.ants = tuning.worlds(moves * tuning.starts_count)
        self.moves, self.same = moves, np.ones(tuning.starts_count, bool)
        self.body_of_shape = self.ants.model.shape_body.numpy()
        self.ants.step = functools.partial(self.ants.step, each=self.look)
        tuning.search = self.ants

    def look(self, substep: int, state: object) -> None:
        """Read the contacts after a substep."""
        c = self.ants.contacts
        count = int(c.rigid_contact_count.numpy()[0])
        force, normal = (x.numpy()[:count] for x in (c.rigid_contact_force, c.rigid_contact_normal))
        pushes = (force * normal).sum(axis=1) != 0.0
        touched = np.zeros(self.ants.model.body_count, bool)
        for shapes in (c.rigid_contact_shape0, c.rigid_contact_shape1):
            body = self.body_of_shape[shapes.numpy()[:count][pushes]]
            touched[body[body >= 0]] = True
        touched = touched.reshape(self.moves, len(self.same), -1)
        self.same &= (touched == touched[:1]).all(axis=(0, 2))


def differences(tuning: demo.Tuning, eps: float) -> tuple[np.ndarray, np.ndarray]:
    """Return central differences of rollouts with respect to the biases, and a mask.

    The differences have the shape {starts, 8}. The mask is true for initial states whose displaced
    rollouts have the same contacts.
    """
    ways = tuning.directions()
    moves = eps * np.concatenate([ways, -ways])
    watch = Watch(tuning, len(moves))
    losses = tuning.losses_by_start(tuning.values + moves)
    return ((losses[: len(ways)] - losses[len(ways) :]) / (2.0 * eps)).T, watch.same


def agreement(ad: np.ndarray, fd: np.ndarray) -> str:
    """Return the cosine and the ratio of norms of the means over the starts, as text."""
    if not len(ad):
        return "–"
    ad, fd = ad.mean(axis=0), fd.mean(axis=0)
    sizes = np.linalg.norm(ad), np.linalg.norm(fd)
    return f"{ad @ fd / (sizes[0] * sizes[1]):.3f}, {sizes[0] / sizes[1]:.2f}"


def table(args: argparse.Namespace) -> list[str]:
    """Return the rows of the guide's table."""
    sys.argv = [demo.__file__, "--headless", "0", "--starts", str(args.starts)]
    actor, _ = demo.load_actor(demo.POLICY, "dva")
    tuning = demo.Tuning(actor, demo.arguments())
    cells: dict[str, list[str]] = {name: [] for name, _, _ in ROWS}
    few: dict[str, list[str]] = {name: [] for name in ("frozen", "exact")}
    counts = []
    for frames in FRAMES:
        tuning.horizon = tuning.segment = frames
        fd, same = differences(tuning, args.eps)
        counts.append(f"{same.sum()} of {len(same)}")
        for name, tuning.kind, tuning.terms in ROWS:
            tuning.frames = tuning.make_frames(tuning.starts_count)
            ad = tuning.pull(actor, tuning.record(tuning.values))
            cells[name].append(agreement(ad, fd))
            if name in few:
                few[name].append(agreement(ad[same], fd[same]))
    rows = [*cells.items()]
    rows += [(f"{name}, only starts whose contacts stay", x) for name, x in few.items()]
    rows.append(("starts whose contacts stay", counts))
    lines = [COLUMNS, "|" + "---|" * (len(FRAMES) + 1)]
    return [*lines, *(f"| {name} | {' | '.join(x)} |" for name, x in rows)]


def main() -> None:
    """Print the table, or write it to the guide."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--eps", type=float, default=3e-3, help="of the differences")
    parser.add_argument("--starts", type=int, default=64)
    parser.add_argument("--page", action="store_true", help="write the table into the guide")
    args = parser.parse_args()
    lines = table(args)
    print("\n".join(lines))
    if args.page:
        text = GUIDE.read_text("utf-8").splitlines()
        first = text.index(COLUMNS)
        last = next(k for k in range(first, len(text)) if not text[k].startswith("|"))
        text = [*text[:first], *lines, *text[last:]]
        GUIDE.write_text("\n".join(text) + "\n", "utf-8")


if __name__ == "__main__":
    main()
