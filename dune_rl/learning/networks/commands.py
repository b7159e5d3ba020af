"""Networks that choose one of a grid of commands, by the predicted cost of each."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, exploration_type

from dune_rl.core.errors import ConfigError
from dune_rl.learning.networks.policy import FEATURES, Architecture, Features, perceptron
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


class CommandHead(nn.Module):
    """Logits and costs (..., C) of the commands, and the action (..., 2): the command of the least cost.

    With a `prior_weight`, the features end with a first guess of the costs. The costs are those of the
    network and the guess, and so many times the guess once more where they decide. The logits are those of
    the network, less the deciding guess over the `temperature`. Where the head `draws`, the action is a
    command drawn by the logits, or the likeliest one where TorchRL's exploration type is deterministic.
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
        self._draws, self._prior_weight = draws, prior_weight
        # Where the guess ends in the features, behind which there may be others.
        self._end = features
        self.body = perceptron(features, hidden, 2 * len(commands))
        self.register_buffer("commands", commands)
        if prior_weight is not None:
            self.register_buffer("temperature", torch.ones(()))
            # It begins with the guess.
            last = self.body[-1]
            assert isinstance(last, nn.Linear)
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """In float32 also under autocast."""
        logits, costs = self.body(features).float().chunk(2, -1)
        decisive = costs
        if self._prior_weight is not None:
            logits = logits - self.decisive_guess(features) / self.temperature
            costs = costs + self._guess(features)
            decisive = costs + self._prior_weight * self._guess(features)
        if not self._draws:
            chosen = decisive.argmin(-1)
        elif exploration_type() == ExplorationType.RANDOM:
            chosen = torch.distributions.Categorical(logits=logits).sample()
        else:
            chosen = logits.argmax(-1)
        return logits, costs, self.commands[chosen]

    def _guess(self, features: Tensor) -> Tensor:
        return features[..., self._end - len(self.commands) : self._end].float()

    def decisive_guess(self, features: Tensor) -> Tensor:
        """What the prior adds to the costs (..., C) that decide; zeros without one."""
        if self._prior_weight is None:
            return features.new_zeros(len(self.commands))
        return (1.0 + self._prior_weight) * self._guess(features)


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
