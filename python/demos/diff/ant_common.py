"""Functions that the demos of the Ant share: gait measures, actors, and tests of policies."""

from __future__ import annotations

import argparse
import subprocess
from pathlib import Path

import numpy as np

import novaphy
from novaphy import nova, viewer
from novaphy.envs import ACTIONS, OBSERVATIONS, AntWorlds, check_meta, feet, rotate

DATA = Path(__file__).resolve().parents[1] / "data" / "ant" / "rl_policies"
FPS = 20
HIDDEN = 256
LIFTED, TOUCHING = 0.010, 0.003  # m: a foot above LIFTED is lifted, a foot below TOUCHING touches
SAMPLE = 5  # substeps between two measurements of the feet


class GaitMeter:
    """Measures the feet of a batch of Ants after every fifth substep."""

    def __init__(self, ants: AntWorlds) -> None:
        """Start a measurement at the present state of the Ants."""
        self.ants, n = ants, ants.num_worlds
        self.dt = SAMPLE * ants.dt
        self.lifted = np.zeros((n, 4), bool)
        self.peak, self.slip = np.zeros((2, n, 4))
        self.touchdowns = np.zeros((n, 4), int)
        self.swings: list[tuple[int, int, float]] = []  # world, foot, greatest height (m)
        self.lowest = np.full(n, np.inf)
        self.excess = np.zeros(n)
        self.tilt = np.zeros(n)
        self.time = 0.0
        self.from_x = ants.q[:, 0].copy()
        limits = (ants.model.joint_limit_lower, ants.model.joint_limit_upper)
        self.lower, self.upper = (x.numpy().reshape(n, 14)[:, 6:] for x in limits)

    def __call__(self, substep: int, state: novaphy.SimState) -> None:
        """Measure the feet after a substep, if the substep is a multiple of SAMPLE."""
        if substep % SAMPLE != SAMPLE - 1:
            return
        _, height, speed = feet(state, self.ants.num_worlds)
        self.time += self.dt
        self.lowest = np.minimum(self.lowest, height.min(axis=1))
        self.slip += (
            np.where(height < TOUCHING, np.linalg.norm(speed[..., :2], axis=-1), 0) * self.dt
        )
        self.peak = np.where(self.lifted, np.maximum(self.peak, height), height)
        down = self.lifted & (height < TOUCHING)
        self.touchdowns += down
        self.swings += [(w, f, float(self.peak[w, f])) for w, f in np.argwhere(down)]
        self.lifted = (self.lifted | (height > LIFTED)) & ~down

    def end_frame(self) -> None:
        """Measure the joints and the tilt at the end of a frame."""
        q = self.ants.q
        out = np.maximum(self.lower - q[:, 7:], q[:, 7:] - self.upper).max(axis=1)
        self.excess = np.maximum(self.excess, out)
        self.tilt = np.maximum(self.tilt, tilt(q))

    def result(self) -> dict[str, np.ndarray]:
        """Return the measures of the gait as arrays with one row for each world.

        touchdown_rate: touchdowns of each foot per second {n, 4}.
        clearance: the median height of the swings of a foot, for the foot with the least (m).
        slip: the largest distance that a foot slips, relative to the Ant's distance (1).
        lowest: the smallest height of a foot (m).
        excess: the largest violation of a joint's range (rad).
        tilt: the largest tilt of the torso (degrees).
        """
        n = self.ants.num_worlds
        clearance = np.zeros((n, 4))
        for world in range(n):
            for foot in range(4):
                peaks = [p for w, f, p in self.swings if w == world and f == foot]
                clearance[world, foot] = np.median(peaks) if peaks else 0.0
        distance = np.maximum(np.abs(self.ants.q[:, 0] - self.from_x), 1e-6)
        return {
            "touchdown_rate": self.touchdowns / max(self.time, 1e-9),
            "clearance": clearance.min(axis=1),
            "slip": self.slip.max(axis=1) / distance,
            "lowest": self.lowest,
            "excess": self.excess,
            "tilt": np.degrees(self.tilt),
        }


def make_stage(args: argparse.Namespace, ants: AntWorlds) -> viewer.Stage:
    """Return the stage that shows an Ant, with a camera that follows the torso."""
    stage = viewer.Stage(args, ants.model, fps=FPS, look=((1.6, -2.8, 1.6), (0.0, 0.0, 0.35)))
    stage.follow(0)
    return stage


def tilt(q: np.ndarray) -> np.ndarray:
    """Return the angles (rad) of the torsos' axes from the vertical {n}."""
    up = rotate(q[:, 3:7], np.broadcast_to(np.float32([0.0, 0.0, 1.0]), (len(q), 3)))
    return np.arctan2(np.linalg.norm(up[:, :2], axis=1), up[:, 2])


def actor_shapes() -> dict[str, tuple[int, ...]]:
    """Return the names (of Stable-Baselines3) and shapes of the actor 111-256-256-8."""
    return {
        "latent_pi.0.weight": (HIDDEN, OBSERVATIONS),
        "latent_pi.0.bias": (HIDDEN,),
        "latent_pi.2.weight": (HIDDEN, HIDDEN),
        "latent_pi.2.bias": (HIDDEN,),
        "mu.weight": (ACTIONS, HIDDEN),
        "mu.bias": (ACTIONS,),
    }


def load_actor(path: str | Path, ant: str) -> tuple[dict[str, nova.Tensor], dict]:
    """Load an actor and its metadata from a file.

    Raises:
        ValueError: missing or other parameters, another shape, NaN, pickled objects, another Ant.
    """
    like = {name: nova.zeros(shape) for name, shape in actor_shapes().items()}
    actor, meta = nova.load_parameters(path, like)
    check_meta(str(path), meta, ant)
    return actor, meta


def hidden(actor: dict[str, nova.Tensor], x: nova.Tensor) -> nova.Tensor:
    """Return the second hidden layer {n, 256}. The mean before the tanh is linear in this layer."""
    h = nova.relu(nova.linear(x, actor["latent_pi.0.weight"], actor["latent_pi.0.bias"]))
    return nova.relu(nova.linear(h, actor["latent_pi.2.weight"], actor["latent_pi.2.bias"]))


def mean_action(actor: dict[str, nova.Tensor], x: nova.Tensor) -> nova.Tensor:
    """Return the mean {n, 8} before the tanh, for observations {n, 111}."""
    return nova.linear(hidden(actor, x), actor["mu.weight"], actor["mu.bias"])


def act(actor: dict[str, nova.Tensor], observations: np.ndarray) -> np.ndarray:
    """Return the deterministic actions tanh(mean) {n, 8} for observations {n, 111}."""
    return nova.tanh(mean_action(actor, nova.tensor(observations))).numpy()


def judge(
    actor: dict[str, nova.Tensor], ants: AntWorlds, frames: int, measure: bool = True
) -> dict[str, np.ndarray]:
    """Play an actor in all worlds for some frames, and return measures of its gait.

    The result has `survived`, `velocity` (m/s, until the Ant falls), `distance` (m) and `drift` (m,
    sideways). With `measure`, the result also has the measures of GaitMeter.
    """
    ants.reset()
    meter = GaitMeter(ants) if measure else None
    alive = np.ones(ants.num_worlds, bool)
    lived = np.zeros(ants.num_worlds)
    end = ants.q.copy()
    for _ in range(frames):
        ants.step(act(actor, ants.observations()), each=meter)
        if meter is not None:
            meter.end_frame()
        alive &= ants.healthy()
        lived += alive
        end[alive] = ants.q[alive]
    result = meter.result() if meter is not None else {}
    result["survived"] = alive
    result["distance"], result["drift"] = end[:, 0], np.abs(end[:, 1])
    result["velocity"] = end[:, 0] / np.maximum(lived / FPS, 1.0 / FPS)
    return result


def provenance() -> str:
    """Return the commit of the sources, or "unknown" outside of a repository."""
    try:
        done = subprocess.run(
            ["git", "rev-parse", "--short=12", "HEAD"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
