"""Runs blocks of episodes as tasks of a Ray cluster."""

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from dune_rl.core.errors import DuneError, TrainingError
from dune_rl.core.machine import available_cores
from dune_rl.core.ray_cluster import RayCluster
from dune_rl.evaluation.blocks import EpisodeBlock, FinishedEpisode
from dune_rl.evaluation.processes import RemoteError
from dune_rl.evaluation.running import BlockRunner, EvaluationPlan

# Seconds between two looks at whether the cluster is there.
_LOOK_S = 5.0
# In a process of the cluster: the environment of the evaluation that it works for, by the evaluation's name.
_runners: dict[str, BlockRunner] = {}


def run_on_ray(
    plan: EvaluationPlan,
    find_blocks: Callable[[int], Sequence[EpisodeBlock]],
    emit: Callable[[FinishedEpisode], None],
) -> None:
    """Run the blocks for so many processes as there are CPUs, and `emit` the episodes of each as it ends.

    Ray runs a block anew that it lost with a node. Raises RemoteError for an error that a user can mend, and
    TrainingError where nothing of the cluster is left.
    """
    cluster = RayCluster("processes=ray", available_cores())
    try:
        import ray

        task, shared = ray.remote(num_cpus=1)(_run_block), ray.put(plan)
        pending = [
            task.remote(os.getcwd(), shared.hex(), shared, block) for block in find_blocks(cluster.cpus())
        ]
        while pending:
            try:
                ready, pending = ray.wait(pending, timeout=_LOOK_S)
            except OSError as error:
                # As where the node that this process is connected to has died.
                raise TrainingError(f"the connection to the Ray cluster is lost ({error})") from error
            if not ready:
                cluster.check()
            for episode in _result(ray, ready):
                emit(episode)
    finally:
        cluster.close()


def _result(ray: Any, ready: Sequence[Any]) -> list[FinishedEpisode]:
    try:
        return [episode for episodes in ray.get(list(ready)) for episode in episodes]
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, DuneError):
            raise RemoteError(str(error.cause)) from error
        raise RuntimeError(f"a Ray task of the evaluation failed:\n{error}") from error
    except ray.exceptions.RayError as error:
        raise TrainingError(f"a Ray task of the evaluation was lost again and again: {error}") from error


def _run_block(folder: str, name: str, plan: EvaluationPlan, block: EpisodeBlock) -> list[FinishedEpisode]:
    """The episodes of a block; the environment is kept for further blocks of the evaluation."""
    if name not in _runners:
        # Paths in settings are relative to where the evaluation was started.
        with suppress(OSError):
            os.chdir(folder)
        for old in _runners.values():
            old.close()
        _runners.clear()
        _runners[name] = BlockRunner(plan)
    found: list[FinishedEpisode] = []
    _runners[name].run(block, found.append)
    return found
