"""Collectors of transitions: in this process, or in worker processes."""

import os
import signal
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any, Literal

import torch
from pydantic import Field
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector, MultiAsyncCollector, MultiSyncCollector
from torchrl.envs import EnvBase

from dune_rl.errors import DuneWarning
from dune_rl.seeding import stream
from dune_rl.settings import Settings

MakeEnv = Callable[[int, int], EnvBase]


class CollectorConf(Settings):
    """Who steps the environments: `serial` is deterministic, `async` is fastest."""

    mode: Literal["serial", "sync", "async"] = "async"
    workers: int = Field(1, ge=1, description="processes, in the modes sync and async")
    scenes: int = Field(16, ge=1, description="scenes stepped as one batch, in each process")
    steps: int = Field(32, ge=1, description="steps of every scene between two hand-overs to the learner")

    @property
    def processes(self) -> int:
        """Worker processes beside the learner's own."""
        return 0 if self.mode == "serial" else self.workers

    @property
    def frames_per_batch(self) -> int:
        """Transitions in each batch that the learner is handed."""
        return self.scenes * self.steps * (self.workers if self.mode == "sync" else 1)


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def learner_threads(conf: CollectorConf) -> int:
    """Threads for the learner beside the collector's workers.

    One in the mode `serial`, whose results then do not depend on the machine's
    cores. At most four otherwise: networks of a few hundred units gain nothing
    from more, and idle threads that spin slow the workers down.
    """
    if conf.mode == "serial":
        return 1
    return min(4, max(1, available_cores() - conf.workers))


def environment_seed(seed: int, worker: int, frames: int) -> int:
    """The seed of a worker's environments, apart from all small numbers, which evaluations use.

    Workers that start anew after `frames` (a resumed run's) get other episodes than before.
    """
    return int(stream(seed, "collector", worker, frames).integers(2**30, 2**31))


def _worker_env(make_env: MakeEnv, scenes: int, seed: int) -> EnvBase:
    # The learner has built the same world and told of it.
    warnings.simplefilter("ignore", DuneWarning)
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    return make_env(scenes, seed)


@contextmanager
def _signals_held() -> Iterator[None]:
    # Processes started meanwhile inherit the mask for life: Ctrl-C then reaches the learner alone, which
    # ends them in order. The learner itself gets what arrived as soon as the block ends.
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Collection:
    """Batches of transitions (scenes, steps) from a policy that is sent now and then.

    Until `random_frames` more frames are in, actions are drawn uniformly. In
    the mode `serial`, `state` restores the scenes in the middle of their
    episodes, bit for bit; in the other modes a resumed run begins new episodes.

    `policy` must be on the CPU; it is this object's own copy. Each `stage` of a
    serial run has episodes of its own.
    """

    def __init__(
        self,
        conf: CollectorConf,
        make_env: MakeEnv,
        policy: TensorDictModuleBase,
        seed: int,
        *,
        frames: int = 0,
        random_frames: int = 0,
        state: Mapping[str, Any] | None = None,
        learner_threads: int = 1,
        stage: int = 0,
    ) -> None:
        self._policy = policy
        self._env: EnvBase | None = None
        # A whole number of batches; otherwise TorchRL rounds up too, with a warning.
        wanted = -(-max(0, random_frames) // conf.frames_per_batch) * conf.frames_per_batch
        common: dict[str, Any] = {
            "policy": policy,
            "frames_per_batch": conf.frames_per_batch,
            "total_frames": -1,
            "init_random_frames": wanted,
            "auto_register_policy_transforms": False,
        }
        if conf.mode == "serial":
            self._env = make_env(conf.scenes, environment_seed(seed, stage, 0))
            self._collector = Collector(self._env, track_traj_ids=False, **common)
            if state is not None:
                self._env.resume(state)
                self._collector.reset()
            return
        factories = [
            partial(_worker_env, make_env, conf.scenes, environment_seed(seed, worker, frames))
            for worker in range(conf.workers)
        ]
        kind = MultiAsyncCollector if conf.mode == "async" else MultiSyncCollector
        with _signals_held():
            self._collector = kind(factories, num_threads=learner_threads, num_sub_threads=1, **common)

    def __iter__(self) -> Iterator[TensorDictBase]:
        yield from self._collector

    @torch.no_grad()
    def send(self, policy: TensorDictModuleBase) -> None:
        """Act by the weights and statistics of `policy`, on whatever device it is, from the next batch on."""
        ours, theirs = self._policy.state_dict(keep_vars=True), policy.state_dict()
        for key, value in theirs.items():
            if isinstance(value, torch.Tensor):
                ours[key].data.copy_(value)
        if self._env is None:
            self._collector.update_policy_weights_(self._policy)

    def state(self) -> dict[str, Any] | None:
        """Where the scenes are in their episodes, as plain data; None where that is not kept."""
        return None if self._env is None else self._env.state()

    def close(self) -> None:
        """End the workers and close the environments."""
        threads = torch.get_num_threads()
        self._collector.shutdown()
        torch.set_num_threads(threads)
