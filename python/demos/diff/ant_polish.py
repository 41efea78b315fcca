"""The last stage of the Ant that learns from zero: a search on the measured gait.

Slip, clearance and touchdowns depend on contacts that begin and end. The differentiable loss
contains only smooth substitutes for these measures. Therefore an evolution strategy improves the
weights that the gradients have found, and simulates each candidate on floors of three frictions.
The strategy is (mu/mu_w, lambda) with cumulative step-size adaptation and without covariance
adaptation (N. Hansen, The CMA Evolution Strategy: A Tutorial, 2016, eq. 6, 9, 31, 32).
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

FLOORS = (0.5, 0.75, 1.2)  # friction coefficients of the floors
FRAMES, CANDIDATES, WIDTH = 300, 24, 0.02
GENERATIONS = 80


def over(x: np.ndarray, most: float) -> np.ndarray:
    """Return by how much x exceeds a bound; 0 below the bound."""
    return np.maximum(x - most, 0.0)


def excess(result: dict[str, np.ndarray], way: float) -> np.ndarray:
    """Return {n}: the weighted sum of a gait's violations of its bounds; 0: all bounds are met.

    The bounds are stricter than those of the demo's checks.

    Args:
        result: the result of `validate` after FRAMES frames.
        way: the distance that the Ant should walk in this time (m).
    """
    missing = (
        over(result["slip"], 0.12)
        + 0.3 * over(result["tilt"], 4.6)  # degrees
        + 4.0 * over(result["drift"], 0.15)  # m
        + 2.0 * over(-result["distance"], -way)  # m
        + 40.0 * over(-result["clearance"], -0.026)  # m
        + over(-result["touchdowns"], -0.7).sum(axis=1)  # per period
        + over(result["touchdowns"], 1.8).sum(axis=1)
        + 150.0 * over(-result["lowest"], 3.5e-3)  # m
        + 10.0 * over(result["excess"], 0.05)  # rad
        + 20.0 * ~result["upright"]
    )
    return np.where(np.isfinite(missing), missing, 1e3)


def polish(
    play: Callable[[np.ndarray], dict[str, np.ndarray]],
    weights: np.ndarray,
    way: float,
    seed: int,
    generations: int,
    until: float = np.inf,
) -> tuple[np.ndarray, list[float]]:
    """Search from weights {8, 10} until all bounds are met, for at most `generations` generations.

    Args:
        play: returns the result of `validate` for weights {n, 8, 10} on all floors {n * floors}, in
            this order.
        weights: the initial weights.
        way: the distance that the Ants should walk (m).
        seed: the seed of the draws.
        generations: the largest number of generations.
        until: the time at which the search ends (time.perf_counter, s).

    Returns:
        The best weights {8, 10}, and `excess` of the best candidate of every generation.
    """
    rng = np.random.Generator(np.random.Philox(key=[seed, 11]))
    n, parents = weights.size, CANDIDATES // 2
    share = np.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
    share /= share.sum()
    mass = 1.0 / (share**2).sum()
    decay = (mass + 2.0) / (n + mass + 5.0)
    damping = 1.0 + 2.0 * max(0.0, np.sqrt((mass - 1.0) / (n + 1.0)) - 1.0) + decay
    length = np.sqrt(n) * (
        1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n**2)
    )  # the expected length of a normal random vector
    mean, width, path = weights.ravel(), WIDTH, np.zeros(n)
    best, least, lacks = weights, np.inf, []
    for _ in range(generations):
        if time.perf_counter() > until or least == 0.0:
            break
        draws = rng.standard_normal((CANDIDATES, n))
        if not lacks:
            draws[0] = 0.0  # the first candidate has the initial weights
        # Candidates are rounded to float32, as a file stores them.
        candidates = np.float32(mean + width * draws).astype(float).reshape(-1, *weights.shape)
        lack = excess(play(candidates), way).reshape(CANDIDATES, -1).mean(axis=1)
        order = np.argsort(lack, kind="stable")
        lacks.append(float(lack[order[0]]))
        if lacks[-1] < least:
            best, least = candidates[order[0]], lacks[-1]
        step = share @ draws[order[:parents]]
        mean = mean + width * step
        path = (1.0 - decay) * path + np.sqrt(decay * (2.0 - decay) * mass) * step
        width *= np.exp(decay / damping * (np.linalg.norm(path) / length - 1.0))
    return best, lacks
