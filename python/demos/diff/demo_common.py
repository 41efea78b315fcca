"""Functions that the demos share: flags, gradient checks, training loops, figures, exit codes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

import novaphy
from novaphy import nova, viewer


def make_parser(doc: str, iterations: int) -> argparse.ArgumentParser:
    """Make a parser with the flags of every demo.

    `iterations` is the number of training iterations without --headless.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    viewer.add_arguments(parser, iterations, "training iterations")
    parser.add_argument("--device", default="cpu", help="cpu, cuda, cuda:1, ... or auto")
    parser.add_argument(
        "--check-grad", action="store_true", help="compare the gradient with central differences"
    )
    parser.add_argument(
        "--dump-states", metavar="PATH.npz", help="write the states of the last rollout"
    )
    parser.add_argument("--plot", metavar="PATH.png", help="draw the loss and the motion")
    return parser


def parse(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Parse and check the flags. In the result, `device` is the name of a device."""
    args = parser.parse_args()
    viewer.check_arguments(parser, args)
    if args.dump_states and not Path(args.dump_states).parent.is_dir():
        parser.error(f"the folder of {args.dump_states} does not exist")
    if args.device == "auto":
        args.device = "cuda" if novaphy.is_device_available("cuda") else "cpu"
    return args


def check_gradient(
    parameter: nova.Tensor,
    forward: Callable[[], nova.Tensor],
    eps: Callable[[float], float] | float,
    tolerance: float,
    indices: Iterable[int] | None = None,
) -> bool:
    """Compare the tape's gradient with central differences.

    Return whether the largest error, relative to the largest difference quotient, is within the
    tolerance.

    parameter: the tensor whose gradient is checked.
    forward: runs a rollout and returns the loss {1}.
    eps: the step of the differences, or a function that gives the step for a value.
    indices: the values of the parameter that are checked; None: all.
    """
    with nova.Tape() as tape:
        tape.backward(forward())
        gradient = parameter.grad.numpy().ravel()
        tape.zero()
    start = parameter.numpy()
    chosen = np.array(list(range(start.size) if indices is None else indices))
    ad, fd = gradient[chosen], np.zeros(chosen.size, np.float32)
    for n, k in enumerate(chosen):
        step = eps(float(start.flat[k])) if callable(eps) else eps
        values = []
        for sign in (1.0, -1.0):
            moved = start.copy()
            moved.flat[k] += np.float32(sign * step)
            parameter.assign(moved)
            values.append(forward().item())
        fd[n] = (values[0] - values[1]) / (2.0 * step)
    parameter.assign(start)
    error = float(np.max(np.abs(ad - fd)) / np.max(np.abs(fd)))
    print(f"gradient  ad {ad}  fd {fd}  relative error {error:.1e} (tolerance {tolerance:.0e})")
    return error <= tolerance


class Recorded:
    """A training iteration, which the first call records as a graph, and later calls replay."""

    def __init__(self, iterate: Callable[[], nova.Tensor]) -> None:
        """Take a function that does one iteration and returns the loss."""
        self.iterate = iterate
        self.graph = None

    def __call__(self) -> float:
        """Run one iteration. Return the loss before its update."""
        if self.graph is None:
            with nova.ScopedCapture() as capture:
                self.loss = self.iterate()
            self.graph = capture.graph
        self.graph.launch()
        return self.loss.item()


def train(
    scene,
    args: argparse.Namespace,
    substeps: int,
    plot: Callable,
    stage: viewer.Stage,
    path: Callable[[np.ndarray], np.ndarray] = lambda q: q.mean(axis=1),
) -> list[float]:
    """Train and show a scene, then save and plot the first and the last rollout. Return the losses.

    scene: an object with forward(), which runs a rollout and returns the loss, train(), which runs
    an iteration, and a trajectory.
    path: returns the points {n, 3} (m) to draw from the positions of a rollout; by default the
    centroids.
    """

    def paths() -> dict[str, np.ndarray]:
        return {"path": path(scene.trajectory.particle_q.numpy())}

    def frames() -> Iterable[tuple[float, novaphy.SimState]]:
        for k in range(0, scene.trajectory.steps + 1, substeps):
            yield k / substeps / stage.fps, scene.trajectory[k]

    scene.forward()
    rollouts = [scene.trajectory.particle_q.numpy()]
    losses = []
    for k in progress(range(args.headless)):
        losses.append(scene.train())
        stage.iteration(k, losses[-1], frames, paths)
    losses.append(scene.forward().item())
    stage.iteration(args.headless, losses[-1], frames, paths, last=True)
    rollouts.append(scene.trajectory.particle_q.numpy())
    if args.dump_states:
        dump_states(args.dump_states, rollouts[-1], substeps, losses)
    if args.plot:
        plot(args.plot, losses, rollouts)
    return losses


def loss_figure(losses: list[float], loss_label: str, widths: tuple[float, float] = (4.4, 6.6)):
    """Make a figure with the loss on the left; `widths` in inches. Return (figure, right axes)."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(
        1, 2, figsize=(sum(widths), 4.2), width_ratios=widths, layout="constrained"
    )
    left.semilogy(losses, color="#2a6f97", marker="o", markersize=3)
    left.set(xlabel="iteration", ylabel=loss_label, title="Loss")
    left.grid(alpha=0.3, which="both")
    return figure, right


def save_figure(figure, path: str) -> None:
    """Write the figure atomically: an error leaves no incomplete file."""
    import matplotlib.pyplot as plt

    with novaphy.io.atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=140)
    plt.close(figure)


def dump_states(path: str, q: np.ndarray, substeps: int, losses: list[float]) -> None:
    """Write positions q {steps + 1, n, 3} (m), those of frames separately, and the losses."""
    novaphy.io.save_npz(
        path, particle_q=q[::substeps], particle_q_substeps=q, loss=np.float32(losses)
    )


def progress(iterations: range):
    """Return the iterations, with a progress bar on a terminal."""
    if not sys.stderr.isatty():
        return iterations
    try:
        from tqdm import tqdm
    except ImportError:
        return iterations
    return tqdm(iterations, desc="training", unit="it", leave=False)


def verdict(checks: dict[str, bool]) -> str:
    """Return "ok", or a text with the names of the checks that failed."""
    failed = [name for name, passed in checks.items() if not passed]
    return "CHECK FAILED: expected " + "; ".join(failed) if failed else "ok"


def mostly_falls(losses: list[float]) -> bool:
    """Return whether the loss falls in at least 80 % of the iterations; True without iterations."""
    return len(losses) < 2 or float(np.mean(np.diff(losses) < 0.0)) >= 0.8


def run(main: Callable[[], int]) -> None:
    """Exit with the code of `main`. Print errors of the user as one line."""
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
    except (ValueError, OSError, novaphy.Error) as error:
        sys.exit(f"error: {error}")
