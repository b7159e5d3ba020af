"""Soft actor-critic as a learner of one agent group."""

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from dune_rl.learning.algorithm import Algorithm, LearnerContext, MakeEnv, mean_values
from dune_rl.learning.group_policy import agent_sequences
from dune_rl.learning.networks.critic import CriticFeatures, split_encoders
from dune_rl.learning.networks.policy import Architecture
from dune_rl.learning.policies import WarmupPolicy
from dune_rl.learning.process import preserve_random_state
from dune_rl.learning.sac.demonstrations import (
    DEMONSTRATIONS,
    Demonstrations,
    Demonstrator,
)
from dune_rl.learning.sac.gradient_step import GradientStep
from dune_rl.learning.sac.replay import Replay, TransitionCodec, check_memory
from dune_rl.learning.sac.settings import MaximumEntropyConf, SacConf

# Transitions whose action values are logged at each evaluation.
_SAMPLE = 2048


class MaximumEntropyLearner(Algorithm):
    """Base of soft actor-critic and its variants: one policy and one replay buffer for all agents of a group.

    The policy's normaliser is updated only by `absorb`, from newly collected observations, before they are
    learned from. Raises ConfigError where the replay buffer does not fit into memory.
    """

    step_class = GradientStep

    def __init__(self, context: LearnerContext, conf: MaximumEntropyConf) -> None:
        self._conf = conf
        spec, whole = context.spec, context.whole_spec
        self.architecture, privileged = split_encoders(Architecture.of(conf), spec, whole)
        super().__init__(context)
        features = self.policy.network[0].module
        self._critic_features = CriticFeatures(features, spec, whole, privileged).to(context.device)
        self._step = self.step_class(conf, spec, self.policy.network, self._critic_features, context.device)
        self.optimiser = self._step.optimiser
        self._codec = TransitionCodec(whole, conf.n_steps, conf.gamma)
        row = self._codec.width * self._codec.dtype.itemsize
        check_memory(conf.replay, row, context.total_frames * context.num_agents)
        scratch = context.folder / f"replay-{context.group}"
        self._replay = Replay(conf.replay, self._codec.width, scratch, context.device, self._codec.dtype)
        self._demonstrations: Demonstrations | None = None
        if conf.demonstrations is not None:
            rows = conf.demonstrations.frames * context.num_agents
            check_memory(conf.replay, row, rows)
            kept = conf.replay.model_copy(update={"capacity": rows})
            folder = context.folder / f"replay-{context.group}-{DEMONSTRATIONS}"
            replay = Replay(kept, self._codec.width, folder, context.device, self._codec.dtype)
            self._demonstrations = Demonstrations(conf.demonstrations, context, replay)
        self._frames = 0
        self._updates_due = 0.0

    def absorb(self, batch: TensorDictBase, frames: int) -> None:
        """Add the transitions of all agents that are not idle to a replay buffer and the statistics."""
        is_warm_up, self._frames = self._frames < self.warmup_frames, frames
        rows = self._codec.encode(agent_sequences(batch))
        if len(rows):
            self._critic_features.observe(self._codec.observations(rows.to(self.context.device)))
            if self._demonstrations is not None and is_warm_up:
                self._demonstrations.replay.extend(rows)
            else:
                self._replay.extend(rows)
        if frames >= (self.warmup_frames or self._conf.learning_starts):
            scenes, steps, _ = batch.batch_size
            self._updates_due += self._conf.updates_per_frame * scenes * steps

    def update(self) -> dict[str, float]:
        """Do the updates that are due; mean losses, entropy coefficient, entropy and the learning rate."""
        count = int(self._updates_due)
        minibatches = self._minibatches(count)
        if not count or minibatches is None:
            return {}
        rate = self._step.schedule(min(1.0, self._frames / self.context.total_frames))
        losses = self._learn(minibatches)
        self._updates_due -= count
        self.updates += count
        return {**losses, "sac/learning_rate": rate}

    def _minibatches(self, count: int) -> Iterator[Tensor] | None:
        """`count` minibatches, of demonstrations and the learner's own data; None where there are no data."""
        size, demonstrations = self._conf.batch_size, self._demonstrations
        if demonstrations is not None and len(demonstrations.replay):
            return demonstrations.minibatches(self._replay, count, size)
        return self._replay.minibatches(count, size) if len(self._replay) else None

    def _learn(self, minibatches: Iterable[Tensor]) -> dict[str, float]:
        """One update for each of `minibatches` (b, width); the means of what they return."""
        scale = self._conf.reward_scale
        return mean_values(
            self._step(partial(self._codec.decode, rows, reward_scale=scale)) for rows in minibatches
        )

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
        if self._demonstrations is not None:
            return self._demonstrations.frames
        return 0 if self._conf.warm_up == "policy" else self._conf.learning_starts

    def warmup_policy(self) -> TensorDictModuleBase | None:
        """A driver, a noisy `go_to_goal`, or None for random actions; raises ConfigError if it cannot act."""
        if self._demonstrations is not None:
            return self._demonstrations.demonstrator
        if self._conf.warm_up == "random":
            return None
        return WarmupPolicy(self.context.group, self.context.spec)

    def check_environment(self, env: EnvBase) -> None:
        """Raise ConfigError where the driver that is to demonstrate cannot drive the group."""
        if self._demonstrations is not None:
            self._demonstrations.demonstrator.bind(env)

    def wrap_environment(self, make_env: MakeEnv, *, warms_up: bool) -> MakeEnv:
        if self._demonstrations is None or not warms_up:
            return make_env
        return partial(_bound, make_env, self._demonstrations.demonstrator)

    def state_dict(self) -> dict[str, Any]:
        """Weights, statistics, targets, the optimiser's state, and the counts of frames and updates."""
        counts = {"updates_due": self._updates_due, "frames": self._frames}
        return {**super().state_dict(), **self._step.state_dict(), **counts}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        super().load_state_dict(state)
        self._step.load_state_dict(state)
        self._updates_due = state["updates_due"]
        # Runs from before there were demonstrations do not say.
        self._frames = state.get("frames", 0)

    def start_from(self, saved: Mapping[str, Any]) -> None:
        """Begin with the policy, and if it is there with the critics and the entropy coefficient."""
        super().start_from(saved)
        if "loss" in saved:
            self._step.load_weights(saved)

    def save_experience(self, path: Path) -> dict[str, Any] | None:
        """Write the replay buffers to `path`.npy and beside it; raises CheckpointError where that fails."""
        saved = self._replay.save_beside(path)
        if self._demonstrations is not None:
            beside = path.with_name(f"{path.name}-{DEMONSTRATIONS}")
            saved[DEMONSTRATIONS] = self._demonstrations.replay.save_beside(beside)
        return saved

    def load_experience(self, folder: Path, saved: Mapping[str, Any]) -> None:
        """Read the replay buffers; raises CheckpointError if a file is missing or does not fit."""
        self._replay.load_from(folder, saved)
        if self._demonstrations is not None:
            self._demonstrations.replay.load_from(folder, saved[DEMONSTRATIONS])

    def close(self) -> None:
        self._replay.close()
        if self._demonstrations is not None:
            self._demonstrations.replay.close()


class Sac(MaximumEntropyLearner):
    """Soft actor-critic (Haarnoja et al. 2018) with multi-step returns."""

    def __init__(self, context: LearnerContext, conf: SacConf) -> None:
        super().__init__(context, conf)


def _bound(make_env: MakeEnv, demonstrator: Demonstrator, scenes: int, seed: int, **options: Any) -> EnvBase:
    env = make_env(scenes, seed, **options)
    demonstrator.bind(env)
    return env
