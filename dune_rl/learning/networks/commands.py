"""Networks that choose one of a grid of commands, by the predicted cost of each."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, exploration_type

from dune_rl.core.errors import ConfigError
from dune_rl.env.torchrl.episode_metrics import simulation_in
from dune_rl.learning.networks.policy import FEATURES, Architecture, Features, perceptron
from dune_rl.learning.networks.settings import CommandsConf
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.state.command_grid import CommandGridConf
from dune_rl.state.command_grid import command_grid as grid_of_commands

_SPEED_AND_HEADING = 2


def command_grid(spec: PolicySpec, conf: CommandGridConf) -> Tensor:
    """The commands (C, 2): speed [m/s] and relative heading [rad]; raises ConfigError for other actions."""
    if spec.action_size != _SPEED_AND_HEADING:
        raise ConfigError(
            f"a grid of commands needs an action of speed and heading, and this one has {spec.action_size} "
            "components; choose another robot.action, or another algorithm"
        )
    within = conf.model_copy(update={"max_heading_rad": min(conf.max_heading_rad, spec.high[1])})
    return torch.as_tensor(grid_of_commands(within, spec.low[0], spec.high[0]), dtype=torch.float32)


def check_prior(conf: CommandsConf, env: EnvBase, group: str) -> None:
    """Raise ConfigError where the sensor that is the prior has other commands than the learner of `group`."""
    if conf.prior is None:
        return
    try:
        suite = simulation_in(env).group(group).suite
    except TypeError:
        # An environment that is not of this package has no settings to compare.
        return
    sensor = None if suite is None else suite.settings.get(conf.prior)
    commands = getattr(sensor, "commands", conf.commands)
    if commands != conf.commands:
        raise ConfigError(
            f"learning.commands ({conf.commands}) and those of learning.prior, sensors.{conf.prior}.commands "
            f"({commands}), differ; give both the same"
        )


class CommandHead(nn.Module):
    """Logits and costs (..., C) of the commands, and the action (..., 2): the command of the least cost.

    With a `prior_weight` w, the features of the policy end with a guess of the costs, the prior. The costs
    are the network's plus the guess, and the action minimises costs + w * guess. The logits are the network's
    minus (1 + w) * guess / `temperature`; at the initial, infinite temperature they are the network's. Where
    the head `draws`, the action is a command drawn by the logits, or the likeliest one where TorchRL's
    exploration type is deterministic.
    """

    commands: Tensor
    temperature: Tensor

    def __init__(
        self,
        commands: Tensor,
        features: int,
        hidden: Sequence[int],
        *,
        draws: bool = False,
        prior_weight: float | None = None,
    ) -> None:
        super().__init__()
        self._draws = draws
        self._has_prior, self.prior_weight = prior_weight is not None, prior_weight or 0.0
        # Where the guess ends; critics have further features behind it.
        self._end = features
        self.body = perceptron(features, hidden, 2 * len(commands))
        self.register_buffer("commands", commands)
        if self._has_prior:
            self.register_buffer("temperature", torch.tensor(torch.inf))
            # It begins with the guess.
            last = self.body[-1]
            assert isinstance(last, nn.Linear)
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """In float32 also under autocast."""
        logits, costs = self.predict(features)
        if not self._draws:
            chosen = self.choose(costs, features)
        elif exploration_type() == ExplorationType.RANDOM:
            chosen = torch.distributions.Categorical(logits=logits).sample()
        else:
            chosen = logits.argmax(-1)
        return logits, costs, self.commands[chosen]

    def predict(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Logits and costs (..., C)."""
        logits, costs = self.body(features).float().chunk(2, -1)
        if self._has_prior:
            logits, costs = logits + self.prior_logits(features), costs + self.guess(features)
        return logits, costs

    def prior_logits(self, features: Tensor) -> Tensor:
        """Logits (..., C) of the prior alone."""
        return -(1.0 + self.prior_weight) * self.guess(features) / self.temperature

    def choose(self, costs: Tensor, features: Tensor) -> Tensor:
        """The number (...) of the command of the least cost, to which the guess is added by its weight."""
        if self._has_prior:
            costs = costs + self.prior_weight * self.guess(features)
        return costs.argmin(-1)

    def guess(self, features: Tensor) -> Tensor:
        """The costs (..., C) that the prior guesses; zeros without one."""
        if not self._has_prior:
            return features.new_zeros(len(self.commands))
        return features[..., self._end - len(self.commands) : self._end].float()


def make_command_network(
    spec: PolicySpec, settings: Mapping[str, Any], device: torch.device | str = "cpu", *, draws: bool = False
) -> TensorDictSequential:
    """From the observation's parts to "logits", "costs" and "action".

    `settings` are those of `Architecture.plain`, with the grid's under "commands" and the weight of the
    prior; `draws` is as in `CommandHead`.
    """
    settings = dict(settings)
    commands = command_grid(spec, CommandGridConf(**settings.pop("commands")))
    # Published policies may be older than the weight.
    weight = settings.pop("prior_weight", 0.0)
    architecture = Architecture.from_plain(settings)
    features = Features(spec, architecture)
    prior = architecture.prior
    if prior is not None and spec.sizes[prior] != len(commands):
        raise ConfigError(
            f"learning.prior={prior} has {spec.sizes[prior]} values, and there are {len(commands)} commands; "
            f"give sensors.{prior}.commands and learning.commands the same numbers"
        )
    head = CommandHead(
        commands,
        features.size,
        architecture.hidden,
        draws=draws,
        prior_weight=None if prior is None else weight,
    )
    return TensorDictSequential(
        TensorDictModule(features, in_keys=spec.keys, out_keys=[FEATURES]),
        TensorDictModule(head, in_keys=[FEATURES], out_keys=["logits", "costs", "action"]),
    ).to(device)
