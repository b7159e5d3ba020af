"""PettingZoo environments: a sound one, and one for each fault."""

from typing import Any

import gymnasium
import numpy as np
from pettingzoo import ParallelEnv

Step = tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, float]]]

LIMIT = 6


class Sound(ParallelEnv):
    """Two points on a line, moved by their actions; time ends an episode, and so does reaching 0.9."""

    metadata = {"name": "sound_v0", "render_modes": []}  # noqa: RUF012
    render_mode = None

    def __init__(self) -> None:
        self.possible_agents = ["point_0", "point_1"]
        self.agents: list[str] = []
        self._observation_spaces = {
            agent: gymnasium.spaces.Dict({"place": gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)})
            for agent in self.possible_agents
        }
        self._action_spaces = {
            agent: gymnasium.spaces.Box(-0.2, 0.2, (1,), np.float32) for agent in self.possible_agents
        }
        self._rng = np.random.default_rng(0)
        self._places = np.zeros((2, 1), np.float32)
        self._steps = 0

    def observation_space(self, agent: str) -> gymnasium.Space:
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.Space:
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, float]]]:
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        self._places = self._rng.uniform(-0.5, 0.5, (2, 1)).astype(np.float32)
        self._steps = 0
        self.agents = self.possible_agents[:]
        return self._observations(), {agent: {} for agent in self.agents}

    def _observations(self) -> dict[str, Any]:
        return {
            agent: {"place": place.copy()}
            for agent, place in zip(self.possible_agents, self._places, strict=True)
        }

    def step(self, actions: dict[str, Any]) -> Step:
        if not self.agents:
            return {}, {}, {}, {}, {}
        self._steps += 1
        moves = np.array([actions[agent] for agent in self.possible_agents], np.float32)
        self._places = np.clip(self._places + moves, -1.0, 1.0)
        arrived = bool((np.abs(self._places) > 0.9).any())
        late = not arrived and self._steps >= LIMIT
        rewards = {agent: float(place[0]) for agent, place in zip(self.agents, self._places, strict=True)}
        out = (
            self._observations(),
            rewards,
            dict.fromkeys(self.agents, arrived),
            dict.fromkeys(self.agents, late),
            {agent: {} for agent in self.agents},
        )
        if arrived or late:
            self.agents = []
        return out


class NondeterministicAtStepThree(Sound):
    def step(self, actions: dict[str, Any]) -> Step:
        out = super().step(actions)
        if self._steps == 3:
            self._places += np.random.default_rng().uniform(0.0, 1e-6, (2, 1)).astype(np.float32)
        return out


class NondeterministicInSecondEpisode(Sound):
    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        if seed is None:
            self._rng = np.random.default_rng()
        return super().reset(seed, options)


class DeafToSeeds(Sound):
    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return super().reset(0, options)


class LeaksOverReset(Sound):
    """The first step after a reset still feels the last one before it."""

    def __init__(self) -> None:
        super().__init__()
        self._last = np.zeros((2, 1), np.float32)

    def step(self, actions: dict[str, Any]) -> Step:
        if self._steps == 0:
            self._places = self._places + 1e-6 * self._last
        out = super().step(actions)
        if self._steps:
            self._last = self._places.copy()
        return out


class GivesFloat64(Sound):
    def _observations(self) -> dict[str, Any]:
        out = super()._observations()
        return {agent: {"place": value["place"].astype(np.float64)} for agent, value in out.items()}


class GivesNaN(Sound):
    def _observations(self) -> dict[str, Any]:
        out = super()._observations()
        if self._steps == 2:
            out["point_1"]["place"][0] = np.nan
        return out


class LeavesItsBounds(Sound):
    def _observations(self) -> dict[str, Any]:
        out = super()._observations()
        if self._steps == LIMIT:
            out["point_0"]["place"][0] = np.nextafter(np.float32(1.0), np.float32(2.0))
        return out


class EarnsNaN(Sound):
    def step(self, actions: dict[str, Any]) -> Step:
        observations, rewards, *rest = super().step(actions)
        if self._steps == 4:
            rewards["point_0"] = float("nan")
        return observations, rewards, *rest


class ReusesItsArrays(Sound):
    def __init__(self) -> None:
        super().__init__()
        self._shown = {agent: {"place": np.zeros(1, np.float32)} for agent in self.possible_agents}

    def _observations(self) -> dict[str, Any]:
        for agent, value in super()._observations().items():
            self._shown[agent]["place"][:] = value["place"]
        return {agent: dict(value) for agent, value in self._shown.items()}


class TimeOutTerminates(Sound):
    def step(self, actions: dict[str, Any]) -> Step:
        observations, rewards, terminated, truncated, infos = super().step(actions)
        ended = {agent: terminated[agent] or truncated[agent] for agent in terminated}
        return observations, rewards, ended, dict.fromkeys(ended, False), infos


class EndsOneStepLate(Sound):
    def step(self, actions: dict[str, Any]) -> Step:
        if self.agents and self._steps == 1:
            self._steps = 0
        return super().step(actions)


class MakesNewSpaces(Sound):
    def observation_space(self, agent: str) -> gymnasium.Space:
        return gymnasium.spaces.Dict({"place": gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)})


class ChangesSpacesWhenDone(Sound):
    def step(self, actions: dict[str, Any]) -> Step:
        out = super().step(actions)
        if not self.agents:
            for agent in self.possible_agents:
                self._action_spaces[agent] = gymnasium.spaces.Box(-0.1, 0.1, (1,), np.float32)
        return out


class MovesItsBounds(Sound):
    def step(self, actions: dict[str, Any]) -> Step:
        out = super().step(actions)
        self._observation_spaces["point_1"]["place"].high[:] = 1.0 + self._steps
        return out


class ForgetsAnInfo(Sound):
    """PettingZoo only warns of this."""

    def step(self, actions: dict[str, Any]) -> Step:
        *out, infos = super().step(actions)
        infos.pop("point_1", None)
        return *out, infos


class RevivesTheDead(Sound):
    def step(self, actions: dict[str, Any]) -> Step:
        out = super().step(actions)
        if not self.agents:
            self.agents = self.possible_agents[:1]
        return out
