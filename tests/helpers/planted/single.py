"""Gymnasium environments: a sound one, and one for each fault."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec


class Sound(gymnasium.Env):
    """A point moved by its action, in a space that is neither symmetric nor normalised."""

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self) -> None:
        self.spec = EnvSpec("planted/Point-v0", entry_point=type(self), disable_env_checker=True)
        self.observation_space = gymnasium.spaces.Box(-50.0, 50.0, (2,), np.float32)
        self.action_space = gymnasium.spaces.Box(
            np.array([0.0, -2.0], np.float32), np.array([3.0, 2.0], np.float32)
        )
        self._place = np.zeros(2, np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict]:
        super().reset(seed=seed)
        self._place = self.np_random.uniform(-1.0, 1.0, 2).astype(np.float32)
        return self._observation(), {}

    def _observation(self) -> Any:
        return self._place.copy()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict]:
        self._place = np.clip(self._place + action, -50.0, 50.0)
        return self._observation(), float(self._place[0]), False, False, {}


class GivesFloat64(Sound):
    def _observation(self) -> Any:
        return self._place.astype(np.float64)


class Nondeterministic(Sound):
    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict]:
        return super().step(action + np.random.default_rng().uniform(0.0, 1e-3))


class ReusesItsArray(Sound):
    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict]:
        self._place += action
        return self._observation(), 0.0, False, False, {}

    def _observation(self) -> Any:
        return self._place


class Unbounded(Sound):
    """Gymnasium only warns of this."""

    def __init__(self) -> None:
        super().__init__()
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32)
