"""Run a method that lowers the loss of a task: Adam with a gradient, or a search."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from certify_tasks import function_of
from cma_es import CmaEs
from event_task_scenes import Task
from event_tasks import start_of

import novaphy
from novaphy import diff, nova

STEP = 1.0  # step of Adam (sigmas), which falls to a tenth
PART = 0.25  # standard deviation (sigmas) of the samples of diff.smoothed
SPREAD = 2.0  # spread (sigmas) of random search and of CMA-ES at the start
EVERY = 5  # iterations of Adam between two evaluated points
GRADIENTS = ("motion", "code")
ORDERS: dict[str, Any] = {"smoothed 0": 0, "smoothed 1": 1, "smoothed mixed": "mixed"}
SEARCHES = ("random search", "CMA-ES")
Slope = Callable[[np.ndarray], np.ndarray]


def methods_of(kind: type[Task]) -> list[str]:
    """Return the methods of a task. The searches get the processor time of the first method."""
    return [mode for mode in GRADIENTS if mode in kind.modes] + [*ORDERS, *SEARCHES]


class Problem:
    """A task around one start, with parameters in units of sigma."""

    def __init__(self, kind: type[Task], number: int, worlds: int) -> None:
        self.kind, self.worlds = kind, worlds
        self.start = start_of(kind, number)
        self.size = len(self.start)
        self.sigma = np.broadcast_to(np.float64(kind.sigma), self.start.shape)
        self.functions = {mode: function_of(kind, mode) for mode in kind.modes}
        self.first = float(self.losses(np.zeros((1, self.size)))[0])

    def losses(self, moves: np.ndarray) -> np.ndarray:
        """Return the losses {rows} of displacements {rows, n} in units of sigma."""
        theta = nova.tensor(np.float32(self.start + moves * self.sigma))
        return self.functions["code"](theta).numpy().astype(np.float64)

    def slope_of(self, mode: str) -> Slope:
        """Return a function that maps a displacement to the gradient of a mode or order."""

        def slope(move: np.ndarray) -> np.ndarray:
            theta = nova.tensor(
                np.float32(self.start + move * self.sigma)[None], requires_grad=True
            )
            with nova.Tape() as tape:
                tape.backward(self.functions[mode](theta), nova.ones((1,)))
            return theta.grad.numpy()[0] * self.sigma

        return slope

    def smooth_slope(self, order: Any, mode: str) -> Slope:
        """Return the gradient function of the mean loss over samples. Each call has new samples."""
        calls = iter(range(1 << 30))

        def slope(move: np.ndarray) -> np.ndarray:
            info: dict[str, Any] = {}
            diff.smoothed(
                self.functions[mode], np.float32(self.start + move * self.sigma),
                PART * self.sigma, self.worlds, order, seed=next(calls), info=info,
            )  # fmt: skip
            return np.float64(info["gradient"]) * self.sigma

        return slope


class Run:
    """The best relative loss of a run over processor time (s), within a limit of wall time (s)."""

    def __init__(self, first: float, limit: float) -> None:
        self.first, self.limit = first, limit
        self.seconds, self.best, self.iterations = [0.0], [1.0], 0
        self.begin()

    def begin(self) -> None:
        """Start the clocks at 0."""
        self.began, self.before, self.outside = time.monotonic(), time.process_time(), 0.0

    @property
    def is_over(self) -> bool:
        """Return whether the limit is reached."""
        return time.monotonic() - self.began > self.limit

    @property
    def spent(self) -> float:
        """Return the processor time (s), without the time spent outside of the method."""
        return time.process_time() - self.before - self.outside

    def note(self, seconds: float, loss: float) -> None:
        """Add a point of the curve. A loss that is not finite does not count."""
        self.seconds.append(seconds)
        known = np.isfinite(loss)
        self.best.append(min(self.best[-1], loss / self.first) if known else self.best[-1])


def adam(slope: Slope, size: int, iterations: int) -> Iterator[np.ndarray]:
    """Yield the points of Adam from 0. The step size falls to a tenth along a cosine."""
    x, m, v = np.zeros(size), np.zeros(size), np.zeros(size)
    for k in range(iterations):
        g = slope(x)
        m, v = 0.9 * m + 0.1 * g, 0.99 * v + 0.01 * g * g
        part = 0.55 + 0.45 * np.cos(np.pi * k / iterations)
        moved = m / (1 - 0.9 ** (k + 1)) / (np.sqrt(v / (1 - 0.99 ** (k + 1))) + 1e-12)
        x = x - STEP * part * moved
        yield x


def random_search(size: int, population: int, seed: int) -> Iterator[np.ndarray]:
    """Yield points around the best point, and receive their losses."""
    rng, width, at, best = np.random.default_rng(seed), SPREAD, np.zeros(size), 0.0
    while True:
        moves = at + width * rng.normal(size=(population, size))
        rises = yield moves
        k = int(np.argmin(rises))
        if rises[k] < best:
            best, at = float(rises[k]), moves[k]
        else:
            width = max(0.7 * width, 1e-3)


def cma_es(size: int, population: int, seed: int) -> Iterator[np.ndarray]:
    """Yield the generations of CMA-ES, and receive their losses."""
    search = CmaEs(size, 0.5 * SPREAD, population, seed)
    while True:
        moves = search.ask()
        search.tell(moves, (yield moves))


def run_adam(run: Run, problem: Problem, slope: Slope, iterations: int) -> None:
    """Run Adam. The time of evaluating the losses of its points does not count."""
    slope(np.zeros(problem.size))  # compiles
    run.begin()
    for k, move in enumerate(adam(slope, problem.size, iterations), 1):
        seconds, run.iterations = run.spent, k
        if k % EVERY == 0 or k == iterations or run.is_over:
            before = time.process_time()
            run.note(seconds, float(problem.losses(move[None])[0]))
            run.outside += time.process_time() - before
        if run.is_over:
            return


def run_search(run: Run, problem: Problem, search: Iterator[np.ndarray], seconds: float) -> None:
    """Run a search for a given processor time (s)."""
    problem.losses(np.zeros((problem.worlds, problem.size)))  # compiles
    run.begin()
    moves = next(search)
    while run.spent < seconds and not run.is_over:
        losses = problem.losses(moves)
        losses = np.where(np.isfinite(losses), losses, np.inf)
        run.iterations += 1
        run.note(run.spent, float(losses.min()))
        moves = search.send(losses - problem.first)


def run_one(
    kind: type[Task], number: int, method: str, worlds: int, iterations: int, limit: float,
    seconds: float,
) -> dict[str, Any]:  # fmt: skip
    """Return the line of a run. An error of the engine ends the run, and is written to the line.

    seconds: the processor time of a search. limit: the longest wall time of any run (s).
    """
    warnings.simplefilter("ignore", RuntimeWarning)
    problem = Problem(kind, number, worlds)
    run, error = Run(problem.first, limit), None
    try:
        if method in SEARCHES:
            search = random_search if method == "random search" else cma_es
            run_search(run, problem, search(problem.size, worlds, number), seconds)
        elif method in ORDERS:
            mode = "motion" if "motion" in kind.modes else "code"
            run_adam(run, problem, problem.smooth_slope(ORDERS[method], mode), iterations)
        else:
            run_adam(run, problem, problem.slope_of(method), iterations)
    except (novaphy.Error, ValueError) as reason:
        error = str(reason)
    return {
        "task": kind.name, "solver": kind.solver_name, "start": number, "method": method,
        "iterations": run.iterations, "seconds": run.seconds, "best": run.best, "error": error,
    }  # fmt: skip
