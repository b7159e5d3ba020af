"""Imitation as a learner of one agent group: regret of every command, by a teacher that sees the state."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs import EnvBase

from dune_rl.core.errors import ConfigError
from dune_rl.env.torchrl.episode_metrics import simulation_in
from dune_rl.learning.algorithm import Algorithm, LearnerContext, MakeEnv, mean_values
from dune_rl.learning.drivers import BoundDriver
from dune_rl.learning.group_policy import agent_sequences
from dune_rl.learning.imitation.settings import ImitationConf
from dune_rl.learning.imitation.teacher import TEACHER_COSTS, TeacherLabels
from dune_rl.learning.networks.commands import check_prior, command_grid, make_command_network
from dune_rl.learning.networks.policy import Architecture
from dune_rl.learning.optimiser import FiniteAdam
from dune_rl.learning.policy_spec import PackedObservation
from dune_rl.learning.sac.replay import Replay, check_memory

_MAX_GRADIENT = 5.0
# Weight of the squared error of costs, over the largest cost, beside the cross-entropy.
_COST_WEIGHT = 3.0


class Imitation(Algorithm):
    """Learns a driver's costs of all commands, and acts by the least predicted cost.

    The policy drives in most episodes, and the driver labels the states that it meets: DAgger (Ross, Gordon
    and Bagnell, 2011) with costs of all actions (Ross and Bagnell, 2014). The driver may know what
    the policy does not observe. The loss is the squared error of the costs above the least one, and the
    cross-entropy to the softmax of their negatives. Raises ConfigError where the data do not fit into memory,
    and for an action that is no speed and heading.
    """

    def __init__(self, context: LearnerContext, conf: ImitationConf) -> None:
        self._conf = conf
        self.architecture = Architecture.of(conf)
        super().__init__(context)
        self._commands = command_grid(context.spec, conf.commands)
        self._network = self.policy.network
        self.optimiser: FiniteAdam = FiniteAdam(self._network.parameters(), lr=conf.learning_rate)
        self._floats, self._octets = context.spec.packed_sizes
        self._width = 2 * self._floats + self._octets + 2 * len(self._commands)
        check_memory(conf.replay, self._width, context.total_frames * context.num_agents)
        scratch = context.folder / f"replay-{context.group}"
        self._replay = Replay(conf.replay, self._width, scratch, context.device, torch.uint8)
        self._frames = 0
        self._updates_due = 0.0

    def network_settings(self) -> dict[str, Any]:
        return {**super().network_settings(), **self._conf.plain_commands()}

    @classmethod
    def make_network(
        cls, spec: Any, settings: Mapping[str, Any], device: Any = "cpu"
    ) -> TensorDictModuleBase:
        return make_command_network(spec, settings, device)

    def check_environment(self, env: EnvBase) -> None:
        """Raise ConfigError for a teacher that cannot drive, a privileged sensor, or a prior's other grid."""
        simulation = simulation_in(env)
        check_prior(self._conf, env, self.context.group)
        if hidden := simulation.group(self.context.group).privileged:
            raise ConfigError(
                f"learning=imitation has no critic that would read the privileged "
                f"{', '.join(sorted(hidden))}; leave `privileged` out, or take learning=sac, crossq or ppo"
            )
        try:
            BoundDriver(self._conf.teacher, simulation, simulation.group(self.context.group))
        except ConfigError as error:
            raise ConfigError(f"learning.teacher={self._conf.teacher}: {error}") from None

    def wrap_environment(self, make_env: MakeEnv, *, warms_up: bool) -> MakeEnv:
        conf = self._conf
        share = 1.0 if warms_up else conf.teacher_share
        commands = self._commands.double().numpy()
        labels = partial(
            TeacherLabels,
            self.context.group,
            conf.teacher,
            commands,
            conf.max_cost,
            conf.change_cost,
            conf.standing_cost,
            share,
            conf.noise_share,
        )
        return partial(_with_labels, make_env, labels)

    def has_new_critics(self, entry: Mapping[str, Any]) -> bool:
        """False: there are none."""
        return False

    @property
    def warmup_frames(self) -> int:
        return self._conf.learning_starts

    def warmup_policy(self) -> TensorDictModuleBase | None:
        """The learner's own policy: the teacher drives in its place."""
        return self.make_policy()

    def absorb(self, batch: TensorDictBase, frames: int) -> None:
        """Add what all agents that are not idle observed, and its labels, to the data."""
        self._frames = frames
        sequences = agent_sequences(batch)
        packed = self.context.spec.pack(sequences.get("observation"))
        costs = sequences.get(("next", TEACHER_COSTS))
        parts = [packed.floats.half().view(torch.uint8), packed.octets, costs.half().view(torch.uint8)]
        rows = torch.cat(parts, -1).reshape(-1, self._width)[~sequences.get("done").reshape(-1)]
        if len(rows):
            vectors = packed.floats[..., : self.context.spec.observation_size].flatten(0, 1)
            self._network[0].module.normaliser.observe(vectors.to(self.context.device))
            self._replay.extend(rows)
        if frames >= self._conf.learning_starts:
            scenes, steps, _ = batch.batch_size
            self._updates_due += self._conf.updates_per_frame * scenes * steps

    def update(self) -> dict[str, float]:
        """Do the updates that are due; mean losses, the mean cost of the chosen commands above the best ones
        [m], and the learning rate.
        """
        count = int(self._updates_due)
        if not count or not len(self._replay):
            return {}
        rate = self._conf.learning_rate_at(min(1.0, self._frames / self.context.total_frames))
        self.optimiser.param_groups[0]["lr"] = rate
        means = mean_values(map(self._step, self._replay.minibatches(count, self._conf.batch_size)))
        self._updates_due -= count
        self.updates += count
        return {**means, "imitation/learning_rate": rate}

    def _step(self, rows: Tensor) -> dict[str, Tensor]:
        """One gradient step on `rows` (b, width)."""
        conf = self._conf
        observed, octets, labels = rows.split([2 * self._floats, self._octets, 2 * len(self._commands)], -1)
        floats, costs = (part.contiguous().view(torch.float16).float() for part in (observed, labels))
        encoder, head = (part.module for part in self._network)
        features = encoder.encode(PackedObservation(floats, octets))
        logits, predicted = head.predict(features)
        wanted = (-costs / conf.temperature).softmax(-1)
        entropy = -(wanted * logits.log_softmax(-1)).sum(-1).mean()
        error = (predicted - costs).square().mean()
        loss = entropy + _COST_WEIGHT / conf.max_cost * error
        self.optimiser.zero_grad()
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self._network.parameters(), _MAX_GRADIENT)
        self.optimiser.step(norm=norm)
        with torch.no_grad():
            regret = costs.gather(-1, head.choose(predicted, features)[:, None]).mean()
        return {
            "loss/cross_entropy": entropy.detach(),
            "loss/cost": error.detach(),
            "imitation/regret_m": regret,
        }

    def state_dict(self) -> dict[str, Any]:
        """Weights, statistics, the optimiser's state, and the count of updates that are due."""
        state = {"optimiser": self.optimiser.state_dict(), "updates_due": self._updates_due}
        return {**super().state_dict(), **state}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        super().load_state_dict(state)
        self.optimiser.load_state_dict(state["optimiser"])
        self._updates_due = state["updates_due"]

    def save_experience(self, path: Path) -> dict[str, Any] | None:
        """Write the data to `path`.npy; raises CheckpointError where that fails."""
        return self._replay.save_beside(path)

    def load_experience(self, folder: Path, saved: Mapping[str, Any]) -> None:
        """Read the data; raises CheckpointError if the file is missing or does not fit."""
        self._replay.load_from(folder, saved)

    def close(self) -> None:
        self._replay.close()


def _with_labels(
    make_env: MakeEnv, labels: partial[TeacherLabels], scenes: int, seed: int, **options: Any
) -> EnvBase:
    return make_env(scenes, seed, **options).append_transform(labels())
