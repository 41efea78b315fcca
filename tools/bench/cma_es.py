"""CMA-ES: optimization by samples of a normal distribution whose covariance is adapted.

Source of the default parameters: Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv
1604.00772.
"""

from __future__ import annotations

import numpy as np


class CmaEs:
    """The normal distribution, which starts at 0 with the standard deviation `width`."""

    def __init__(self, size: int, width: float, population: int, seed: int) -> None:
        """Make the distribution for points of `size` numbers."""
        self.rng, self.population = np.random.default_rng(seed), population
        self.mean, self.width, self.generation = np.zeros(size), width, 0
        self.covariance = np.eye(size)
        self.path, self.path_of_width = np.zeros(size), np.zeros(size)
        weights = np.log((population + 1) / 2) - np.log(np.arange(1, population // 2 + 1))
        self.weights = weights / weights.sum()
        mass = self.mass = 1 / (self.weights**2).sum()
        self.rate_of_width = (mass + 2) / (size + mass + 5)
        self.damping = 1 + 2 * max(0.0, np.sqrt((mass - 1) / (size + 1)) - 1) + self.rate_of_width
        self.rate = (4 + mass / size) / (size + 4 + 2 * mass / size)
        self.rank_one = 2 / ((size + 1.3) ** 2 + mass)
        self.rank_mu = min(1 - self.rank_one, 2 * (mass - 2 + 1 / mass) / ((size + 2) ** 2 + mass))
        self.length = np.sqrt(size) * (
            1 - 1 / (4 * size) + 1 / (21 * size**2)
        )  # mean length of a sample

    def ask(self) -> np.ndarray:
        """Return new points {population, size} of a generation."""
        variances, self.axes = np.linalg.eigh(self.covariance)
        self.deviations = np.sqrt(np.maximum(variances, 1e-30))
        samples = self.rng.normal(size=(self.population, len(self.mean)))
        return self.mean + self.width * (samples * self.deviations) @ self.axes.T

    def tell(self, points: np.ndarray, losses: np.ndarray) -> None:
        """Adapt the distribution to the losses of the points. A NaN counts as the largest loss."""
        self.generation += 1
        best = points[np.argsort(losses)[: len(self.weights)]]
        steps = (best - self.mean) / self.width
        step = self.weights @ steps
        self.mean = self.mean + self.width * step
        white = self.axes @ ((step @ self.axes) / self.deviations)
        keep = 1 - self.rate_of_width
        self.path_of_width = keep * self.path_of_width + np.sqrt((1 - keep**2) * self.mass) * white
        stretch = np.linalg.norm(self.path_of_width) / self.length
        grown = stretch / np.sqrt(1 - keep ** (2 * self.generation))
        moves = float(grown < 1.4 + 2 / (len(self.mean) + 1))
        keep = 1 - self.rate
        self.path = keep * self.path + moves * np.sqrt((1 - keep**2) * self.mass) * step
        missing = self.rank_one * (1 - moves) * (1 - keep**2)
        self.covariance = (
            (1 - self.rank_one - self.rank_mu + missing) * self.covariance
            + self.rank_one * np.outer(self.path, self.path)
            + self.rank_mu * (steps.T * self.weights) @ steps
        )
        self.width *= np.exp(self.rate_of_width / self.damping * (stretch - 1))
