"""An episode of one scene under a policy, its contact sheet, and a picture of the world."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from torchrl.envs import EnvBase

from dune_rl.config.build import make_torchrl_env
from dune_rl.config.commands import ViewConf
from dune_rl.core.errors import ConfigError
from dune_rl.core.files import write_atomically
from dune_rl.core.suggestions import advise
from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.live.numbers import describe_agent
from dune_rl.env.pictures import Pictures
from dune_rl.env.requests import EpisodePlan
from dune_rl.evaluation.policies import PolicySource
from dune_rl.learning.group_policy import Policy
from dune_rl.learning.saved_policies import load_policy
from dune_rl.reporting.views.tracks import TrackRecorder
from dune_rl.sensors.settings import SensorSettings
from dune_rl.visualization.contact_sheet import contact_sheet

Picture = NDArray[np.uint8]


def find_agent(groups: Sequence[AgentGroup], name: str | None) -> tuple[AgentGroup, int]:
    """The group of an agent and its index in it; by default the first external agent, or the first of all.

    Raises ConfigError if there is no agent of that name.
    """
    if name is None:
        return next((group for group in groups if group.is_external), groups[0]), 0
    names = [agent for group in groups for agent in group.names]
    if name not in names:
        raise ConfigError(f"agent: there is no agent {name!r}; {advise(name, names)}")
    group = next(group for group in groups if name in group.names)
    return group, group.names.index(name)


class EpisodeView:
    """An episode of `conf`, or of a `plan`, with pictures from behind one agent and that agent's readings."""

    def __init__(self, conf: ViewConf, plan: EpisodePlan | None = None) -> None:
        self.conf = conf
        self._env = make_torchrl_env(conf, 1, conf.seed, plan=plan)
        self.simulation = self._env.simulation
        try:
            self.group, self.row = find_agent(self.simulation.groups, conf.agent)
            self.make_policy = policy_factory(conf, self._env)
        except BaseException:
            self._env.close()
            raise
        self.agent = self.group.names[self.row]
        self.pictures = Pictures(self.simulation)
        self._recorder = TrackRecorder(self.simulation)

    def load_policy(self, name: str) -> Policy:
        """A built-in policy for all external groups; raises ConfigError where it cannot act."""
        return PolicySource(name, "built-in", name).load(self._env)

    def run(
        self, seed: int | None = None, episode: int | None = None, policy: Policy | None = None
    ) -> Iterator[bool]:
        """Run one episode; yields whether it has ended, at its start and after each step.

        Seed, number and policy are those of the settings, unless others are given.
        """
        conf = self.conf
        self.simulation.reseed(
            conf.seed if seed is None else seed, conf.episode if episode is None else episode
        )
        policy = policy or self.make_policy()
        observation = self._env.reset()
        self._recorder.reset(0)
        yield False
        while True:
            observation = self._env.step(policy(observation))["next"]
            self._recorder.update()
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
        return {name: value[0, self.row] for name, value in self.simulation.observe(self.group.name).items()}

    def render_from_behind(self, width: int, height: int, *, turns_for_agents: bool = False) -> Picture:
        """RGB (height, width, 3) of the agent from behind; see `Pictures.from_behind`."""
        return self.pictures.from_behind(
            0, width, height, self.conf.samples, agent=self.agent, turns_for_agents=turns_for_agents
        )

    def render_world(self) -> Picture:
        """RGB (height, width, 3) of the whole world at the start of the episode."""
        next(self.run())
        return self.pictures.of_the_place(0, self.conf.width, self.conf.height, max(2, self.conf.samples))

    def status(self, steps: int) -> list[tuple[str, str]]:
        """Names and values of the agent's state after `steps` control steps of the episode."""
        names = [] if len(self.simulation.agents) == 1 else [("agent", self.agent)]
        time_s = steps / self.conf.physics.control_hz
        return [*names, *describe_agent(self.simulation, self.group, self.row, time_s)]

    def ending(self) -> str:
        """How the agent's episode ended; empty while it goes on."""
        return self._recorder.ending(self.group.name, self.row) or ""

    def close(self) -> None:
        """Release the physics engine."""
        self._env.close()


# Sensors that built-in policies read, where these are not `goal` alone; None: keep all that are configured.
SENSORS_OF_POLICIES: dict[str, tuple[str, ...] | None] = {
    "dwa": None,
    "dwa_oracle": None,
    "mppi": ("lidar", "goal", "velocity"),
    "oracle": (),
    "planner": (),
}


def policy_factory(conf: ViewConf, env: EnvBase) -> Callable[[], Policy]:
    """Makes the policy of `conf` for all external groups of `env`: a new one for each episode.

    Built-in policies act as in an evaluation.
    """
    if conf.checkpoint is not None:
        trained, _ = load_policy(Path(conf.checkpoint), env, allow_more=True)
        return lambda: trained
    name = conf.policy or "go_to_goal"
    return lambda: PolicySource(name, "built-in", name).load(env)


def write_orbit(view: EpisodeView, path: Path) -> Path:
    """A picture of the whole world (PNG)."""
    picture = view.render_world()
    with write_atomically(path) as temporary:
        Image.fromarray(picture).save(temporary, format="png")
    return path


def write_sheet(view: EpisodeView, path: Path) -> Path:
    """The readings of all sensors at one instant of an episode (PNG)."""
    conf = view.conf
    last = round(conf.after_s * conf.physics.decision_hz)
    steps = 0
    for steps, _ in enumerate(view.run()):
        if steps >= last:
            break
    title = f"{conf.world.name}, {_shown(conf)}, {steps / conf.physics.decision_hz:.1f} s into the episode"
    if len(view.simulation.agents) > 1:
        title += f", {view.agent}"
    picture = view.render_from_behind(1280, 960, turns_for_agents=True)
    figure = contact_sheet(view.readings(), view.sensors, picture, title)
    with write_atomically(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, facecolor=figure.get_facecolor())
    return path


def _shown(conf: ViewConf) -> str:
    """The seed or the set, and the episode if it is not the first of a seed."""
    if conf.set is not None:
        return f"episode {conf.episode} of {Path(conf.set).stem}"
    return f"seed {conf.seed}" + (f", episode {conf.episode}" if conf.episode else "")
