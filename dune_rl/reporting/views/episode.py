"""An episode of one scene under a policy, rendered from behind one of its agents."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torchrl.envs import EnvBase

from dune_rl.config.build import make_torchrl_env
from dune_rl.config.commands import ViewConf
from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import advise
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.pictures import Pictures
from dune_rl.env.simulation import VectorSimulation
from dune_rl.learning.group_policy import Policy
from dune_rl.learning.policies import built_in_policy
from dune_rl.learning.saved_policies import load_policy
from dune_rl.reporting.views.tracks import EndingRecorder
from dune_rl.sensors.settings import SensorSettings

Picture = NDArray[np.uint8]


def find_agent(simulation: VectorSimulation, name: str | None) -> tuple[AgentGroup, int]:
    """The group of an agent and its index in it; by default the first external agent.

    Raises ConfigError if there is no agent of that name.
    """
    if name is None:
        return simulation.group(), 0
    names = [agent for group in simulation.groups for agent in group.names]
    if name not in names:
        remedy = advise(name, names)
        raise ConfigError(f"agent: there is no agent {name!r}; {remedy}")
    group = next(group for group in simulation.groups if name in group.names)
    return group, group.names.index(name)


class EpisodeView:
    """An episode of `conf`, with pictures from behind one agent and that agent's readings."""

    def __init__(self, conf: ViewConf) -> None:
        self.conf = conf
        self._env = make_torchrl_env(conf, 1, conf.seed)
        self.simulation = self._env.simulation
        try:
            self.group, self._row = find_agent(self.simulation, conf.agent)
            self._make_policy = policy_factory(conf, self._env)
        except BaseException:
            self._env.close()
            raise
        self.agent = self.group.names[self._row]
        self._pictures = Pictures(self.simulation)
        self._endings = EndingRecorder(self.simulation)

    def run(self) -> Iterator[bool]:
        """Run one episode; yields whether it has ended, at its start and after each step."""
        self.simulation.reseed(self.conf.seed)
        policy = self._make_policy()
        observation = self._env.reset()
        self._endings.reset(0)
        yield False
        while True:
            observation = self._env.step(policy(observation))["next"]
            self._endings.update()
            done = bool(observation["done"])
            yield done
            if done:
                return

    @property
    def sensors(self) -> Mapping[str, SensorSettings]:
        """Settings of the agent's sensors by name."""
        return {} if self.group.suite is None else self.group.suite.settings

    def readings(self) -> dict[str, NDArray[Any]]:
        """The agent's readings by name, without the axes of scenes and agents."""
        return {name: value[0, self._row] for name, value in self.simulation.observe(self.group.name).items()}

    def render_from_behind(self, width: int, height: int, *, turns_for_agents: bool = False) -> Picture:
        """RGB (height, width, 3) of the agent from behind; see `Pictures.from_behind`."""
        return self._pictures.from_behind(
            0, width, height, self.conf.samples, agent=self.agent, turns_for_agents=turns_for_agents
        )

    def render_world(self) -> Picture:
        """RGB (height, width, 3) of the whole world at the start of the episode."""
        next(self.run())
        return self._pictures.of_the_place(0, self.conf.width, self.conf.height, max(2, self.conf.samples))

    def status(self, steps: int) -> list[str]:
        """The agent's state after `steps` control steps, in a few lines."""
        state, row = self.simulation.state.groups[self.group.name], self._row
        lines = [] if len(self.simulation.agents) == 1 else [self.agent]
        lines += [
            f"{steps / self.conf.physics.control_hz:5.1f} s",
            f"speed {state.motion.velocity_b[row, 0]:5.2f} m/s",
        ]
        if self.group.task is not None:
            lines.append(f"goal {state.goal.distance[row]:6.2f} m")
        return [
            *lines,
            f"slope {np.rad2deg(state.motion.tilt[row]):4.0f}°",
            f"collisions {state.contacts.total[row]:.0f}",
        ]

    def ending(self) -> str:
        """How the agent's episode ended; empty while it goes on."""
        return self._endings.ending(self.group.name, self._row) or ""

    def close(self) -> None:
        """Release the physics engine."""
        self._env.close()


# What built-in policies read, where it is not `goal` alone.
SENSORS_OF_POLICIES = {"mppi": ("lidar", "goal", "velocity"), "planner": ()}


def policy_factory(conf: ViewConf, env: EnvBase) -> Callable[[], Policy]:
    """Makes the policy of `conf` for all external groups of `env`: a new one for each episode.

    A random policy thus does not depend on the episodes before.
    """
    if conf.checkpoint is not None:
        trained, _ = load_policy(Path(conf.checkpoint), env, allow_more=True)
        return lambda: trained
    return lambda: built_in_policy(conf.policy or "go_to_goal", env, conf.seed)
