"""Worlds that differ, and pushes: what an Ant should withstand.

Every seed has its friction, its mass, a slope whose uphill is anywhere, and pushes of the torso:
once in a while a force along the ground, in any direction, for one frame.
"""

from __future__ import annotations

import numpy as np

from novaphy.envs import AntWorlds

FRICTION, MASS = (0.5, 1.2), (0.9, 1.1)
SLOPE = 3.0  # degrees
IMPULSE = 20.0  # N s, of a push; an Ant of 182 kg gets 0.11 m/s
EVERY, MOST, FPS = 60, 64, 20  # frames between two pushes; directions; frames of a second
NAMES = ("pushes", "friction", "mass", "slope")


class Disturbances:
    """What differs from world to world, drawn from a seed for each."""

    def __init__(self, ants: AntWorlds, seeds: np.ndarray, names: tuple[str, ...] = NAMES) -> None:
        """Change the worlds: each by what its seed draws, of what is named."""
        self.worlds, self.names = ants.num_worlds, names
        rngs = [np.random.Generator(np.random.Philox(key=[int(seed), 17])) for seed in seeds]
        draws = np.array([rng.uniform(0.0, 1.0, 4) for rng in rngs])
        self.angles = np.array([rng.uniform(0.0, 2.0 * np.pi, MOST) for rng in rngs])
        self.first = (EVERY * draws[:, 3]).astype(int)
        spans = {"friction": FRICTION, "mass": MASS}
        self.changes = {
            name: low + (high - low) * draws[:, k]
            for k, (name, (low, high)) in enumerate(spans.items())
            if name in names
        }
        if "slope" in names:
            slope = np.full(len(draws), np.radians(SLOPE))
            self.changes |= {"slope": slope, "slope_heading": 2.0 * np.pi * draws[:, 2]}
        ants.vary(**self.changes)

    def push(self, frame: int) -> np.ndarray | None:
        """Forces on the torsos in a frame {worlds, 3} (N), world axes."""
        if "pushes" not in self.names:
            return None
        force = np.zeros((self.worlds, 3), np.float32)
        pushed = frame % EVERY == self.first
        angle = self.angles[pushed, frame // EVERY % MOST]
        force[pushed, :2] = IMPULSE * FPS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return force
