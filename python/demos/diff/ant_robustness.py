"""Disturbances that a policy of the Ant should withstand: different worlds, and pushes.

For each world, a seed determines the friction, the mass, the direction of a slope, and pushes of
the torso. A push is a horizontal force during one frame. The direction of a push is random, and
pushes come at regular intervals.
"""

from __future__ import annotations

import numpy as np

from novaphy.envs import AntWorlds

FRICTION, MASS = (0.5, 1.2), (0.9, 1.1)
SLOPE = 3.0  # degrees
IMPULSE = 20.0  # N s, impulse of a push; it changes the speed of 182 kg by 0.11 m/s
EVERY, MOST, FPS = 60, 64, 20  # frames between pushes; number of pushes; frames per second
NAMES = ("pushes", "friction", "mass", "slope")


class Disturbances:
    """The disturbances of each world, drawn from the seed of the world."""

    def __init__(self, ants: AntWorlds, seeds: np.ndarray, names: tuple[str, ...] = NAMES) -> None:
        """Change each world by the draws of its seed, for the disturbances in `names`."""
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
        """Return the forces on the torsos in a frame {worlds, 3} (N, world axes), or None."""
        if "pushes" not in self.names:
            return None
        force = np.zeros((self.worlds, 3), np.float32)
        pushed = frame % EVERY == self.first
        angle = self.angles[pushed, frame // EVERY % MOST]
        force[pushed, :2] = IMPULSE * FPS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return force
