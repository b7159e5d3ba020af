"""Runs blocks of episodes in one environment."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self

import torch
from tensordict import TensorDictBase

from dune_rl.config.build import make_learning_env
from dune_rl.config.commands import EvaluateConf
from dune_rl.core.errors import ConfigError
from dune_rl.evaluation.blocks import EpisodeBlock, FinishedEpisode
from dune_rl.evaluation.datasets.transitions import TransitionRecorder
from dune_rl.evaluation.episode_sets.apply import plan_of_set
from dune_rl.evaluation.episode_sets.files import EpisodeSet, read_episode_set
from dune_rl.evaluation.policies import PolicySource, UserPolicy, policy_sources
from dune_rl.evaluation.protocols.attempts import AttemptRecorder
from dune_rl.evaluation.protocols.run_observer import RunObserver
from dune_rl.evaluation.protocols.settings import EPISODES_PER_RUN
from dune_rl.evaluation.recorder import EpisodeRecorder
from dune_rl.evaluation.tables import plain_number
from dune_rl.learning.evaluation import EpisodeObserver, evaluate
from dune_rl.learning.group_policy import Policy
from dune_rl.learning.process import preserve_random_state
from dune_rl.ros.bag import policy_folders
from dune_rl.ros.recorder import BagRecorder
from dune_rl.statistics.measures import WORLD_SEED, MetricsRow


@dataclass(frozen=True)
class EvaluationPlan:
    """What is evaluated: the settings, the policies, and the set (None: sampled episodes).

    `transitions` is the folder to which those of each episode are written; None: nowhere.
    """

    conf: EvaluateConf
    sources: tuple[PolicySource, ...]
    episode_set: EpisodeSet | None
    transitions: Path | None = None

    @classmethod
    def of_settings(cls, conf: EvaluateConf) -> Self:
        """The plan of settings, whose set and policies are read; raises DuneError where they cannot be."""
        episode_set = None if conf.set is None else read_episode_set(conf.set)
        return cls(conf, policy_sources(conf), episode_set)

    @property
    def episodes(self) -> int:
        """Number of episodes of each policy; of runs, where there is a protocol."""
        if self.conf.protocol is not None:
            assert self.conf.runs is not None, "the number of runs is resolved before a plan is made"
            return self.conf.runs
        assert self.conf.episodes is not None, "the number of episodes is resolved before a plan is made"
        return self.conf.episodes

    @property
    def scenes(self) -> int:
        if self.conf.protocol is not None:
            return self.conf.scenes
        return min(self.conf.scenes, self.episodes)

    def part_of(self, conf: EvaluateConf) -> range:
        """The episodes (or runs) of `conf.part`, all of them without one; it begins where a batch does."""
        if conf.part is None:
            return range(self.episodes)
        number, parts = map(int, conf.part.split("/"))
        unit = 1 if conf.protocol is not None else self.scenes
        batches = -(-self.episodes // unit)
        first, last = ((part * batches // parts) * unit for part in (number - 1, number))
        return range(min(first, self.episodes), min(last, self.episodes))


class BlockRunner:
    """Runs blocks of a plan, all in one environment.

    Raises DuneError if the environment cannot be made, or a policy does not fit it.
    """

    def __init__(self, plan: EvaluationPlan) -> None:
        # Sums over several threads would depend on their number.
        torch.set_num_threads(1)
        self.plan = plan
        planned = None if plan.episode_set is None else plan_of_set(plan.conf, plan.episode_set)
        self.env = make_learning_env(plan.conf, plan.scenes, plan.conf.seed, planned)
        self.agents: dict[str, list[str]] = self.env.group_map
        self._policies: list[Policy] = [source.load(self.env) for source in plan.sources]

    def try_policies(self) -> None:
        """Let users' own policies act once; raises ConfigError for one that cannot."""
        for policy in self._policies:
            if isinstance(policy, UserPolicy):
                with preserve_random_state():
                    self.env.set_seed(self.plan.conf.seed)
                    policy(self.env.reset())

    def run(self, block: EpisodeBlock, emit: Callable[[FinishedEpisode], None]) -> None:
        """Run a block and `emit` its episodes, in the order in which they end; of runs, in their order."""
        if self.plan.conf.protocol is not None:
            self._run_steps(block, emit)
        elif self.plan.conf.bag is not None:
            self._run_recorded(block, emit)
        else:
            self.watch(block, _Emitter(self, block.policy, emit))

    def _run_recorded(self, block: EpisodeBlock, emit: Callable[[FinishedEpisode], None]) -> None:
        """Run a block of episodes, and write a bag of each."""
        conf, name = self.plan.conf, self.plan.sources[block.policy].name
        folders = policy_folders(Path(conf.bag or ""), [source.name for source in self.plan.sources])
        episode_set = self.plan.episode_set
        recorder = BagRecorder(
            self.env.base_env.simulation,
            folders[block.policy],
            range(block.first, block.first + block.count),
            {
                "policy": name,
                "seed": conf.seed,
                "world": conf.world.name,
                "set": None if episode_set is None else episode_set.name,
                "decision_s": conf.physics.control_step_s * conf.physics.action_repeat,
            },
        )
        try:
            # The bag first: an episode that counts as finished has one.
            self.watch(block, _InTurn((recorder, _Emitter(self, block.policy, emit))))
        finally:
            recorder.close()

    def watch(self, block: EpisodeBlock, observer: EpisodeObserver) -> None:
        """Run a block of episodes; `observer` is called at their steps and ends."""
        try:
            evaluate(
                self._policies[block.policy],
                self.env,
                block.count,
                self.plan.conf.seed,
                first=block.first,
                observer=observer,
            )
        except ValueError as error:
            if self.plan.episode_set is None:
                raise
            raise ConfigError(f"set={self.plan.episode_set.name}: {error}") from error

    def _run_steps(self, block: EpisodeBlock, emit: Callable[[FinishedEpisode], None]) -> None:
        """Run the runs of a block, whose numbers it has in place of episodes."""
        conf = self.plan.conf
        assert conf.run_steps is not None, "the length of runs is resolved before a plan is made"
        simulation = self.env.base_env.simulation
        (group,) = self.agents
        for run in range(block.first, block.first + block.count):
            attempts = AttemptRecorder(simulation, group) if conf.protocol == "dune_code" else None
            record = partial(self.record, block.policy)
            observer = RunObserver(simulation, group, run, conf.run_steps, record, attempts)
            observer.inner = _Emitter(self, block.policy, observer.add)
            evaluate(
                self._policies[block.policy],
                self.env,
                EPISODES_PER_RUN,
                conf.seed,
                first=observer.first,
                observer=observer,
                stop=observer.is_full,
            )
            for episode in observer.episodes():
                emit(episode)

    def record(self, policy: int, group: str, row: MetricsRow) -> dict[str, Any]:
        """A row of the tables."""
        plan = self.plan
        values = {key: plain_number(value) for key, value in row.items()}
        agent = self.agents[group][int(values.pop("agent"))]
        world_seed = values.pop(WORLD_SEED, getattr(plan.conf.world, "seed", None))
        files = () if plan.episode_set is None else plan.episode_set.header.files
        file = {"world_file": files[int(world_seed or 0)].path} if files else {}
        return {
            "policy": plan.sources[policy].name,
            "world": plan.conf.world.name,
            **file,
            "seed": plan.conf.seed,
            "agent": agent,
            **values,
            "set": "" if plan.episode_set is None else plan.episode_set.name,
            "engine": plan.conf.physics.backend,
            "world_seed": world_seed,
        }

    def close(self) -> None:
        self.env.close()


class _InTurn:
    """Calls several observers one after another."""

    def __init__(self, observers: Sequence[EpisodeObserver]) -> None:
        self._observers = observers

    def begin(self) -> None:
        for observer in self._observers:
            observer.begin()

    def step(self, after: TensorDictBase) -> None:
        for observer in self._observers:
            observer.step(after)

    def finish(self, rows: Mapping[str, list[MetricsRow]]) -> None:
        for observer in self._observers:
            observer.finish(rows)


class _Emitter(EpisodeRecorder):
    """Emits the episodes of a block as they end."""

    def __init__(self, runner: BlockRunner, policy: int, emit: Callable[[FinishedEpisode], None]) -> None:
        conf = runner.plan.conf
        super().__init__(runner.env.base_env.simulation, steps=conf.steps, actors=conf.actor_steps)
        self._runner, self._policy, self._emit = runner, policy, emit
        folder = runner.plan.transitions
        self._transitions = None if folder is None else TransitionRecorder(runner.env, folder)

    def begin(self) -> None:
        super().begin()
        if self._transitions is not None:
            self._transitions.begin()

    def step(self, after: TensorDictBase) -> None:
        super().step(after)
        if self._transitions is not None:
            self._transitions.step(after)

    def finish(self, rows: Mapping[str, list[MetricsRow]]) -> None:
        super().finish(rows)
        episode = int(next(iter(rows.values()))[0]["episode"])
        by_group = {
            group: [self._runner.record(self._policy, group, row) for row in agents]
            for group, agents in rows.items()
        }
        if self._transitions is not None:
            # Before the episode counts as finished.
            self._transitions.finish(episode)
        name = self._runner.plan.sources[self._policy].name
        steps = [{"policy": name, **step} for step in self.take_steps()]
        self._emit(FinishedEpisode(self._policy, episode, by_group, steps))
