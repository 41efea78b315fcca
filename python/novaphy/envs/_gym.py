"""AntEnv and AntVectorEnv: Gymnasium environments over AntWorlds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.vector import AutoresetMode, VectorEnv
except ImportError:
    raise ImportError(
        "novaphy.envs.AntEnv and AntVectorEnv need the package gymnasium: pip install gymnasium"
    ) from None

from .._deprecated import renamed_argument
from ._ant import ACTIONS, ACTIONS_LIMIT, OBSERVATIONS, VARIED, AntWorlds, Array, check_varied

Ranges = Mapping[str, tuple[float, float]]


class _Rules:
    """Rewards, terminations and randomization of Gymnasium's Ant-v3."""

    def __init__(
        self, ants: AntWorlds, episode: int, randomize: Ranges | None, forward_weight: float
    ) -> None:
        if episode < 1:
            raise ValueError(f"episode: expected a number of frames >= 1, got {episode}")
        for name, bounds in (randomize or {}).items():
            if name not in VARIED or np.shape(bounds) != (2,) or not bounds[0] <= bounds[1]:
                raise ValueError(
                    f"randomize: expected (low, high) of {', '.join(VARIED)}, got {name!r}: "
                    f"{bounds}"
                )
            check_varied(name, bounds)
        self.ants, self.episode = ants, episode
        self.randomize, self.forward_weight = dict(randomize or {}), forward_weight

    def draw(self, rng: np.random.Generator, worlds: np.ndarray) -> None:
        """Draw random parameters for the worlds (a mask {worlds}) that are reset."""
        values = {}
        for name, (low, high) in self.randomize.items():
            rows = self.ants.varied[name].copy()
            drawn = rng.uniform(low, high, self.ants.num_worlds)
            rows[worlds] = drawn[worlds] if rows.ndim == 1 else drawn[worlds, None]
            values[name] = rows
        if values:
            self.ants.vary(**values)

    def step(self, actions: Array) -> tuple[Array, np.ndarray, np.ndarray]:
        """Step all worlds; return rewards, terminated and truncated {worlds}."""
        ants = self.ants
        before = ants.q[:, 0]
        ants.step(actions)
        healthy = ants.healthy()
        speed = (ants.q[:, 0] - before) * 20.0
        a = np.clip(actions, -1.0, 1.0)
        rewards = healthy * 1.0 + self.forward_weight * speed - 0.5 * (a**2).sum(axis=1)
        rewards = np.nan_to_num(rewards, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
        return rewards, ~healthy, (ants.frame >= self.episode) & healthy


def _spaces() -> tuple[Any, Any]:
    observed = spaces.Box(-np.inf, np.inf, (OBSERVATIONS,), np.float32)
    return observed, spaces.Box(-ACTIONS_LIMIT, ACTIONS_LIMIT, (ACTIONS,), np.float32)


class AntEnv(gymnasium.Env[Array, Array]):
    """One Ant with the observations and rewards of Gymnasium's Ant-v3, at 20 Hz.

    The reward of a frame is 1 while the Ant is healthy, plus the speed along +x (m/s), minus half
    the sum of squared actions. An episode is terminated when the state is not finite, or the torso
    is too low or above 1 m. An episode is truncated after `episode` frames.
    """

    metadata: dict[str, Any] = {"render_modes": [], "render_fps": 20}  # noqa: RUF012

    @renamed_argument("randomise", "randomize")  # codespell:ignore randomise
    def __init__(
        self,
        *,
        ant: str = "dva",
        episode: int = 1000,
        noise: float = 0.1,
        randomize: Ranges | None = None,
        forward_weight: float = 1.0,
        substeps: int = 50,
    ) -> None:
        """Build the world.

        Args:
            ant: the parameter set of the robot, "dva" or "gym" (see AntWorlds).
            episode: number of frames until truncation.
            noise: initial noise (see AntWorlds).
            randomize: ranges (low, high) by parameter name of AntWorlds.vary. Every reset draws new
                values.
            forward_weight: weight of the speed in the reward.
            substeps: solver steps per frame.
        """
        self.ants = AntWorlds(1, ant=ant, noise=noise, substeps=substeps)
        self._rules = _Rules(self.ants, episode, randomize, forward_weight)
        self.observation_space, self.action_space = _spaces()
        self.render_mode = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode. Return the observation {111} and an empty dict.

        The same seed gives the same start.
        """
        super().reset(seed=seed)
        self.ants.reseed(int(self.np_random.integers(2**31)))
        self._rules.draw(self.np_random, np.ones(1, bool))
        return self.ants.reset()[0], {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Step one frame; return observation, reward, terminated, truncated and an info dict."""
        rewards, terminated, truncated = self._rules.step(np.asarray(action, np.float32)[None])
        info = {"x_position": float(self.ants.q[0, 0])}
        out = np.nan_to_num(self.ants.observations()[0])
        return out, float(rewards[0]), bool(terminated[0]), bool(truncated[0]), info


class AntVectorEnv(VectorEnv[Array, Array, Array]):
    """A batch of Ants with the rules of AntEnv.

    The autoreset mode is SAME_STEP. In the step that ends an episode, the returned observation is
    the first one of the next episode. The last observation of the ended episode is in
    infos["final_obs"], for the worlds of the mask infos["_final_obs"].
    """

    @renamed_argument("randomise", "randomize")  # codespell:ignore randomise
    def __init__(
        self,
        num_envs: int,
        *,
        ant: str = "dva",
        episode: int = 1000,
        noise: float = 0.1,
        randomize: Ranges | None = None,
        forward_weight: float = 1.0,
        substeps: int = 50,
    ) -> None:
        """Build `num_envs` worlds. The other arguments have the same meaning as in AntEnv."""
        self.ants = AntWorlds(num_envs, ant=ant, noise=noise, substeps=substeps)
        self._rules = _Rules(self.ants, episode, randomize, forward_weight)
        self.num_envs, self.render_mode = num_envs, None
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}
        self.single_observation_space, self.single_action_space = _spaces()
        self.observation_space = gymnasium.vector.utils.batch_space(
            self.single_observation_space, num_envs
        )
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start all episodes."""
        super().reset(seed=seed[0] if isinstance(seed, list) else seed)
        self.ants.reseed(int(self.np_random.integers(2**31)))
        self._rules.draw(self.np_random, np.ones(self.num_envs, bool))
        return self.ants.reset(), {}

    def step(self, actions: Array) -> tuple[Array, Array, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step all worlds by one frame, and restart worlds whose episode has ended."""
        rewards, terminated, truncated = self._rules.step(np.asarray(actions, np.float32))
        out, over = np.nan_to_num(self.ants.observations()), terminated | truncated
        info: dict[str, Any] = {}
        if over.any():
            info = {"final_obs": out, "_final_obs": over}
            self._rules.draw(self.np_random, over)
            out = self.ants.reset(over)
        return out, rewards, terminated, truncated, info
