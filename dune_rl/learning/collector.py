"""Collection of transitions: in this process, in worker processes, or on a Ray cluster."""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector, MultiAsyncCollector, MultiSyncCollector
from torchrl.envs import EnvBase

from dune_rl.core.errors import DuneWarning
from dune_rl.core.machine import available_cores
from dune_rl.core.seeding import stream
from dune_rl.learning.algorithm import MakeEnv
from dune_rl.learning.episode_begins import EpisodeBegins
from dune_rl.learning.group_policy import GroupPolicy, JointPolicy
from dune_rl.learning.population import OpponentDraws, Population, PopulationPolicy
from dune_rl.learning.process import WorkerMonitor, blocked_signals
from dune_rl.learning.ray_workers import RayWorkers
from dune_rl.learning.settings import CollectorConf


def learner_threads(conf: CollectorConf) -> int:
    """Threads for the learners beside the collector's workers.

    One in the mode `serial`, whose results then do not depend on the machine's cores. At most four otherwise:
    networks of a few hundred units gain nothing from more, and idle threads that spin slow the workers down.
    """
    if conf.mode == "serial":
        return 1
    return min(4, max(1, available_cores() - conf.processes_here))


def environment_seed(seed: int, worker: int, frames: int) -> int:
    """The seed of a worker's environments, apart from all small numbers, which evaluations use.

    Workers that start anew after `frames` (a resumed run's) get other episodes than before.
    """
    return int(stream(seed, "collector", worker, frames).integers(2**30, 2**31))


def _worker_env(make_env: MakeEnv, scenes: int, seed: int) -> EnvBase:
    # The learner's process has built the same world, and shown its warnings.
    warnings.simplefilter("ignore", DuneWarning)
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    return make_env(scenes, seed)


def _env_with_begins(make_env: MakeEnv, groups: Sequence[str], scenes: int, seed: int) -> EnvBase:
    return make_env(scenes, seed).append_transform(EpisodeBegins(groups))


def _env_with_draws(make_env: MakeEnv, num_groups: int, scenes: int, seed: int) -> EnvBase:
    return make_env(scenes, seed).append_transform(OpponentDraws(num_groups))


class TransitionCollector:
    """Collects batches (scenes, steps) with policies of all groups, whose weights are sent now and then.

    `policies` (by group) must be on the CPU; they are this object's own copies. In the mode `serial`, `state`
    restores the scenes in the middle of their episodes, bit for bit; in the other modes a resumed run begins
    new episodes. Each `stage` of a serial run has episodes of its own. With a `population` the policies are
    joined by its snapshots, which act in a share of the episodes.
    """

    def __init__(
        self,
        conf: CollectorConf,
        make_env: MakeEnv,
        policies: Mapping[str, TensorDictModuleBase],
        seed: int,
        *,
        frames: int = 0,
        state: Mapping[str, Any] | None = None,
        threads: int = 1,
        stage: int = 0,
        population: Population | None = None,
        note: Callable[[str], None] = lambda line: None,
        is_stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        """`threads` are the learners', which TorchRL's collectors set again; `note` gets lines to show.

        Once `is_stopped`, no more is waited for a batch that a cluster has no CPU for.
        """
        self._population = population
        if population is not None:
            policies = population.join(policies)
            make_env = partial(_env_with_draws, make_env, population.num_groups)
        self._policies = dict(policies)
        if self._recurrent:
            groups = [policy.group for policy in self._recurrent]
            make_env = partial(_env_with_begins, make_env, groups)
        self.fill_places()
        self._policy = JointPolicy(self._policies.values())
        most = conf.episodes_per_worker
        self._episodes_left = float("inf") if most is None else most * conf.processes
        self._env: EnvBase | None = None
        self._collector: Any
        common: dict[str, Any] = {
            "policy": self._policy,
            "frames_per_batch": conf.frames_per_batch,
            "total_frames": -1,
            "auto_register_policy_transforms": False,
        }
        if conf.mode == "serial":
            self._env = make_env(conf.scenes, environment_seed(seed, stage, 0))
            self._collector = Collector(self._env, track_traj_ids=False, **common)
            if state is not None:
                self._env.resume(state["scenes"])
                self._collector.reset()
                for policy in self._with_past:
                    if policy.group in state["opponents"]:
                        policy.resume_episodes(state["opponents"][policy.group])
                for recurrent in self._recurrent:
                    recurrent.memory = state["memories"][recurrent.group]
            self._monitor = WorkerMonitor(())
            return

        def make_env_of(worker: int) -> Callable[[], EnvBase]:
            return partial(_worker_env, make_env, conf.scenes, environment_seed(seed, worker, frames))

        if conf.mode == "ray":
            self._collector = RayWorkers(
                conf.workers, make_env_of, self._policy, conf.frames_per_batch, note, is_stopped
            )
            self._monitor = WorkerMonitor(())
            return
        factories = [make_env_of(worker) for worker in range(conf.workers)]
        kind = MultiAsyncCollector if conf.mode == "async" else MultiSyncCollector
        if conf.mode == "sync":
            # The scenes of all workers side by side.
            common["cat_results"] = 0
        with blocked_signals():
            self._collector = kind(factories, num_threads=threads, num_sub_threads=1, **common)
        self._monitor = WorkerMonitor(self._collector.procs)

    def __iter__(self) -> Iterator[TensorDictBase]:
        """The batches, until `is_stopped` and none comes; raises `TrainingError` when a worker has ended."""
        batches = iter(self._collector)
        while True:
            batch = self._monitor.wait(partial(next, batches, None))
            if batch is None:
                return
            self._episodes_left -= int(batch["next", "done"].sum())
            yield batch

    @property
    def is_worn(self) -> bool:
        """Whether the worker processes have had their `episodes_per_worker` and are to be started anew.

        What an engine does not free of the worlds that a process has left is then returned to the system, as
        by `maxtasksperchild` of `multiprocessing.Pool`.
        """
        return self._env is None and self._episodes_left <= 0

    @torch.no_grad()
    def send(self, policies: Mapping[str, TensorDictModuleBase]) -> None:
        """Act by the weights and statistics of `policies`, on whatever device, from the next batch on."""
        for group, policy in policies.items():
            ours, theirs = self._policies[group].state_dict(keep_vars=True), policy.state_dict()
            for key, value in theirs.items():
                if isinstance(value, torch.Tensor):
                    ours[key].data.copy_(value)
        if self._env is None and policies:
            # The workers confirm what they got.
            self._monitor.wait(partial(self._collector.update_policy_weights_, self._policy))

    def fill_places(self) -> None:
        """Act by the snapshots that the population has now, from the next `send` on."""
        for policy in self._with_past:
            assert self._population is not None
            policy.fill(self._population.snapshots[policy.group])

    def state(self) -> dict[str, Any] | None:
        """Where the scenes are in their episodes, and who acts in them, as plain data; None where that is
        not kept, and once the collector is closed.
        """
        if self._env is None:
            return None
        opponents = {policy.group: policy.episodes() for policy in self._with_past}
        memories = {policy.group: policy.memory for policy in self._recurrent}
        return {"scenes": self._env.state(), "opponents": opponents, "memories": memories}

    @property
    def _recurrent(self) -> list[GroupPolicy]:
        policies = self._policies.values()
        return [policy for policy in policies if isinstance(policy, GroupPolicy) and policy.is_recurrent]

    @property
    def _with_past(self) -> list[PopulationPolicy]:
        return [policy for policy in self._policies.values() if isinstance(policy, PopulationPolicy)]

    def close(self) -> None:
        threads = torch.get_num_threads()
        self._monitor.close()
        self._collector.shutdown()
        self._env = None
        torch.set_num_threads(threads)
