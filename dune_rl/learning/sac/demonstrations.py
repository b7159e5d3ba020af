"""Data of a driver, collected before learning, of which every batch has a share (RLPD: Ball et al. 2023)."""

from collections.abc import Iterator
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from dune_rl.behaviours.registry import BEHAVIOURS
from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import advise
from dune_rl.env.torchrl.episode_metrics import simulation_in
from dune_rl.learning.algorithm import LearnerContext
from dune_rl.learning.drivers import DRIVERS, BoundDriver
from dune_rl.learning.sac.replay import Replay
from dune_rl.learning.sac.settings import DemonstrationsConf

DEMONSTRATIONS = "demonstrations"


class Demonstrator(TensorDictModuleBase):
    """Lets the driver `name` act for all agents of `group` in the environment that it was last bound to."""

    def __init__(self, group: str, name: str, first_key: str) -> None:
        super().__init__()
        self.in_keys: list[Any] = [(group, "observation", first_key)]
        self.out_keys = [(group, "action")]
        self._group, self._name = group, name
        self._driver: BoundDriver | None = None

    def bind(self, env: EnvBase) -> None:
        """Drive in `env`, which runs in this process; raises ConfigError where the driver cannot."""
        setting = f"learning.demonstrations.driver={self._name}"
        if BEHAVIOURS.find(self._name) is None:
            known = advise(self._name, [*DRIVERS, "go_to_goal"])
            raise ConfigError(f"{setting}: there is no behaviour {self._name!r}; {known}")
        try:
            simulation = simulation_in(env)
            self._driver = BoundDriver(self._name, simulation, simulation.group(self._group))
        except (ConfigError, TypeError) as error:
            raise ConfigError(f"{setting}: {error}") from None

    @torch.no_grad()
    def forward(self, observation: TensorDictBase) -> TensorDictBase:
        """Writes (group, "action") (M, G, A)."""
        assert self._driver is not None
        shape = observation.get(self._group).batch_size
        action = torch.from_numpy(self._driver.act()).reshape(*shape, -1)
        return observation.set((self._group, "action"), action)


class Demonstrations:
    """The demonstrator of a group, and the `replay` buffer of what it did."""

    def __init__(self, conf: DemonstrationsConf, context: LearnerContext, replay: Replay) -> None:
        self.frames, self._share, self.replay = conf.frames, conf.share, replay
        self.demonstrator = Demonstrator(context.group, conf.driver, context.spec.keys[0])

    def minibatches(self, own: Replay, count: int, size: int) -> Iterator[Tensor]:
        """`count` minibatches (size, width), of which a share is demonstrated, and the rest from `own`.

        All is demonstrated as long as `own` is empty.
        """
        demonstrated = min(size - 1, max(1, round(self._share * size)))
        if not len(own):
            yield from self.replay.minibatches(count, size)
            return
        both = (self.replay.minibatches(count, demonstrated), own.minibatches(count, size - demonstrated))
        for rows in zip(*both, strict=True):
            yield torch.cat(rows)
