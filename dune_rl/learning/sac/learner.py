"""Soft actor-critic as a learner of one agent group."""

from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from dune_rl.learning.algorithm import Algorithm, LearnerContext
from dune_rl.learning.group_policy import agent_sequences
from dune_rl.learning.networks.policy import Architecture
from dune_rl.learning.policies import WarmupPolicy
from dune_rl.learning.process import preserve_random_state
from dune_rl.learning.sac.gradient_step import GradientStep
from dune_rl.learning.sac.replay import Replay, TransitionCodec, check_memory
from dune_rl.learning.sac.settings import SacConf

# Transitions whose action values are logged at each evaluation.
_SAMPLE = 2048


class Sac(Algorithm):
    """Soft actor-critic with one policy, and one replay buffer, for all agents of a group.

    The policy's normaliser is updated only by `absorb`, from newly collected observations, before they are
    learned from. Raises ConfigError where the replay buffer does not fit into memory.
    """

    def __init__(self, context: LearnerContext, conf: SacConf) -> None:
        self._conf = conf
        self.architecture = Architecture.of(conf)
        super().__init__(context)
        self._step = GradientStep(conf, context.spec, self.policy.network, context.device)
        self._codec = TransitionCodec(context.spec, conf.n_steps, conf.gamma)
        row = self._codec.width * self._codec.dtype.itemsize
        check_memory(conf.replay, row, context.total_frames * context.num_agents)
        scratch = context.folder / f"replay-{context.group}"
        self._replay = Replay(conf.replay, self._codec.width, scratch, context.device, self._codec.dtype)
        self._frames = 0
        self._updates_due = 0.0

    def absorb(self, batch: TensorDictBase, frames: int) -> None:
        """Add the transitions of all agents that are not idle to the replay buffer and the statistics."""
        self._frames = frames
        rows = self._codec.encode(agent_sequences(batch))
        if len(rows):
            vectors = self._codec.vectors(rows).to(self.context.device)
            self.policy.network[0].module.normaliser.observe(vectors)
            self._replay.extend(rows)
        if frames >= self._conf.learning_starts:
            scenes, steps, _ = batch.batch_size
            self._updates_due += self._conf.updates_per_frame * scenes * steps

    def update(self) -> dict[str, float]:
        """Do the updates that are due; mean losses, entropy coefficient, entropy and the learning rate."""
        count = int(self._updates_due)
        if not count or not len(self._replay):
            return {}
        rate = self._step.schedule(min(1.0, self._frames / self.context.total_frames))
        losses = self._learn(self._replay.minibatches(count, self._conf.batch_size))
        self._updates_due -= count
        self.updates += count
        return {**losses, "sac/learning_rate": rate}

    def _learn(self, minibatches: Iterable[Tensor]) -> dict[str, float]:
        """One update for each of `minibatches` (b, width); the means of what they return."""
        totals: dict[str, Tensor] = {}
        count = 0
        for rows in minibatches:
            losses = self._step(partial(self._codec.decode, rows, reward_scale=self._conf.reward_scale))
            for key, value in losses.items():
                totals[key] = totals[key] + value if key in totals else value
            count += 1
        return {key: float(value) / count for key, value in totals.items()}

    def distributions(self) -> dict[str, Tensor]:
        """The action values of a sample of the replay buffer."""
        if not len(self._replay):
            return {}
        with preserve_random_state():
            (rows,) = self._replay.minibatches(1, _SAMPLE)
        make_batch = partial(self._codec.decode, rows, reward_scale=self._conf.reward_scale)
        return {"sac/action_value": self._step.action_values(make_batch)}

    @property
    def warmup_frames(self) -> int:
        """Frames before the first update in which another than the policy acts."""
        return 0 if self._conf.warm_up == "policy" else self._conf.learning_starts

    def warmup_policy(self) -> TensorDictModuleBase | None:
        """A noisy `go_to_goal`, or None for random actions; raises ConfigError where it cannot act."""
        if self._conf.warm_up == "random":
            return None
        return WarmupPolicy(self.context.group, self.context.spec)

    def state_dict(self) -> dict[str, Any]:
        """Weights, statistics, targets, the optimiser's state, and the counts of updates."""
        return {**super().state_dict(), **self._step.state_dict(), "updates_due": self._updates_due}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        super().load_state_dict(state)
        self._step.load_state_dict(state)
        self._updates_due = state["updates_due"]

    def start_from(self, saved: Mapping[str, Any]) -> None:
        """Begin with the policy, and if it is there with the critics and the entropy coefficient."""
        super().start_from(saved)
        if "loss" in saved:
            self._step.load_weights(saved["loss"])

    def save_experience(self, path: Path) -> dict[str, Any] | None:
        """Write the replay buffer to `path`.npy; raises CheckpointError where that fails."""
        return self._replay.save_beside(path)

    def load_experience(self, folder: Path, saved: Mapping[str, Any]) -> None:
        """Read the replay buffer; raises CheckpointError if the file is missing or does not fit."""
        self._replay.load(folder / saved["file"], saved)

    def close(self) -> None:
        self._replay.close()
