"""Collection of transitions by actors of a Ray cluster."""

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs import EnvBase

from dune_rl.core.errors import DuneError, TrainingError
from dune_rl.core.ray_cluster import RayCluster
from dune_rl.core.untrusted_files import first_line

# Seconds between two looks at the cluster; in which all losses by the end of one node are known; and after
# which the user is told that no batch comes.
_LOOK_S, _GATHER_S, _PATIENCE_S = 5.0, 3.0, 60.0


class _Worker:
    """A TorchRL collector in a process of the cluster, which acts by the weights it is given."""

    def __init__(
        self,
        folder: str,
        make_env: Callable[[], EnvBase],
        policy: TensorDictModuleBase,
        frames_per_batch: int,
    ) -> None:
        # Paths in settings are relative to where the training was started.
        with suppress(OSError):
            os.chdir(folder)
        self._policy = policy
        self._collector = partial(
            Collector,
            make_env,
            policy,
            frames_per_batch=frames_per_batch,
            total_frames=-1,
            track_traj_ids=False,
            auto_register_policy_transforms=False,
        )
        self._batches: Iterator[TensorDictBase] | None = None

    def collect(self, weights: Mapping[str, Tensor]) -> TensorDictBase:
        if self._batches is None:
            self._batches = iter(self._collector())
        self._policy.load_state_dict(weights)
        return next(self._batches)


class RayWorkers:
    """`workers` actors of one CPU each; iterating gives their batches (scenes, steps) as they come.

    A worker goes on with its next batch while the learners have the last one, by the weights that were sent
    last. One that is lost, alone or with its node, costs the frames that it had under way: another one, with
    episodes of its own (`make_env_of` a number that no other worker has), begins where and when a CPU is
    free, and `note` gets a line. Iterating ends where no batch is there once `is_stopped`. It raises
    `TrainingError` where nothing of the cluster is left, and where workers are lost again and again before
    any of them gives a batch.
    """

    def __init__(
        self,
        workers: int,
        make_env_of: Callable[[int], Callable[[], EnvBase]],
        policy: TensorDictModuleBase,
        frames_per_batch: int,
        note: Callable[[str], None],
        is_stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self._cluster = RayCluster("learning.collector.mode=ray", workers)
        import ray

        self._ray = ray
        self._class = ray.remote(num_cpus=1)(_Worker)
        self._workers, self._make_env_of = workers, make_env_of
        self._note, self._is_stopped = note, is_stopped
        self._policy, self._frames_per_batch = ray.put(policy), frames_per_batch
        self._weights = ray.put(policy.state_dict())
        # The workers, by what each of them is to return.
        self._pending: dict[Any, Any] = {}
        self._started = 0
        # Losses since the last batch, and those that were not told yet, with the time of the first of them.
        self._lost_in_a_row = self._untold = 0
        self._lost_at = self._looked_at = time.monotonic()

    def update_policy_weights_(self, policy: TensorDictModuleBase) -> None:
        """Act by the present weights of `policy` in all batches that are begun from now on."""
        with self._connection():
            self._weights = self._ray.put(policy.state_dict())

    def __iter__(self) -> Iterator[TensorDictBase]:
        with self._connection():
            for _ in range(self._workers - len(self._pending)):
                self._start_worker()
        while True:
            batch = self._next_batch()
            if batch is None:
                return
            yield batch

    def shutdown(self) -> None:
        """End the workers, whatever they do."""
        self._pending.clear()
        self._cluster.close()

    @contextmanager
    def _connection(self) -> Iterator[None]:
        try:
            yield
        except (OSError, self._ray.exceptions.RayError) as error:
            raise TrainingError(self._describe(error)) from error

    def _describe(self, error: Exception) -> str:
        """Why Ray cannot go on: what the system or Ray says of this machine, or a connection that is lost."""
        full = (self._ray.exceptions.OutOfDiskError, self._ray.exceptions.ObjectStoreFullError)
        # Ray's own errors have no number; they come where the node of this process has died.
        is_systems = isinstance(error, OSError) and error.errno is not None
        if isinstance(error, full) or (is_systems and not isinstance(error, ConnectionError)):
            return f"Ray cannot go on: {first_line(error)}"
        return f"the connection to the Ray cluster is lost ({error})"

    def _start_worker(self) -> None:
        make_env = self._make_env_of(self._started)
        self._started += 1
        self._begin_batch(self._class.remote(os.getcwd(), make_env, self._policy, self._frames_per_batch))

    def _begin_batch(self, worker: Any) -> None:
        self._pending[worker.collect.remote(self._weights)] = worker

    def _next_batch(self) -> TensorDictBase | None:
        """The batch of a worker; None where there is none and the run `is_stopped`."""
        begun, is_told = time.monotonic(), False
        while True:
            now = time.monotonic()
            if self._untold and now > self._lost_at + _GATHER_S:
                self._tell_losses()
            if now > begun + _PATIENCE_S and not is_told:
                is_told = True
                self._tell_waiting()
            with self._connection():
                batch = self._take_batch()
            # One may never come, as where others use all CPUs.
            if batch is not None or self._is_stopped():
                return batch

    def _take_batch(self) -> TensorDictBase | None:
        """The batch of a worker, if there is one within a second."""
        now = time.monotonic()
        if now > self._looked_at + _LOOK_S:
            self._looked_at = now
            self._cluster.check()
        ready, _ = self._ray.wait(list(self._pending), timeout=1.0)
        if not ready:
            return None
        worker = self._pending.pop(ready[0])
        try:
            batch: TensorDictBase = self._ray.get(ready[0])
        except self._ray.exceptions.RayTaskError as error:
            # The worker lives: what it ran has failed, and would again.
            fault = error.cause if isinstance(error.cause, DuneError) else error
            raise TrainingError(f"a Ray worker failed: {fault}") from error
        except self._ray.exceptions.RayError as error:
            self._replace(error)
            return None
        self._lost_in_a_row = 0
        self._begin_batch(worker)
        return batch

    def _replace(self, error: Exception) -> None:
        if getattr(error, "actor_init_failed", False):
            raise TrainingError(f"a Ray worker cannot begin: {error}") from error
        self._cluster.check()
        self._lost_in_a_row += 1
        if self._lost_in_a_row > self._workers:
            # Ray's own text has a line for each of what it knows.
            reason = first_line(error)
            raise TrainingError(f"Ray workers are lost before they give a batch: {reason}") from error
        if not self._untold:
            self._lost_at = time.monotonic()
        self._untold += 1
        self._start_worker()

    def _tell_waiting(self) -> None:
        with self._connection():
            self._cluster.check()
            cpus = self._cluster.cpus()
        self._note(
            f"note: no batch from Ray workers for {_PATIENCE_S:.0f} s; they wait for a CPU where "
            f"others use all {cpus} of the cluster"
        )

    def _tell_losses(self) -> None:
        # How many are left is not told: for seconds a cluster counts a node that has died.
        lost, others = ("a Ray worker was", "another one begins")
        if self._untold > 1:
            lost, others = (f"{self._untold} Ray workers were", "others begin")
        self._note(f"note: {lost} lost with the frames under way; {others} where a CPU is free")
        self._untold = 0
