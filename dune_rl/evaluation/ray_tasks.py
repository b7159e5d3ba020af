"""Runs blocks of episodes as tasks of a Ray cluster."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from queue import SimpleQueue
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
# There, all blocks run in one thread, as libraries keep settings for each.
_thread = ThreadPoolExecutor(1)


def run_on_ray(
    plan: EvaluationPlan,
    find_blocks: Callable[[int], Sequence[EpisodeBlock]],
    emit: Callable[[FinishedEpisode], None],
) -> None:
    """Run the blocks for so many processes as there are CPUs, and `emit` the episodes of all as they end.

    Ray runs a block anew that it lost with a node, and leaves out the episodes that it gave before: they end
    in the same order each time. Raises RemoteError for an error that a user can mend, and
    TrainingError where nothing of the cluster is left.
    """
    cluster = RayCluster("processes=ray", available_cores())
    try:
        import ray

        task, shared = ray.remote(num_cpus=1, num_returns="streaming")(_stream_block), ray.put(plan)
        pending = [
            task.remote(os.getcwd(), shared.hex(), shared, block) for block in find_blocks(cluster.cpus())
        ]
        while pending:
            with _telling_loss():
                ready, pending = ray.wait(pending, timeout=_LOOK_S)
            if not ready:
                cluster.check()
            for stream in ready:
                with _telling_loss():
                    episode = _next_episode(ray, stream)
                if episode is not None:
                    emit(episode)
                    pending.append(stream)
    finally:
        cluster.close()


@contextmanager
def _telling_loss() -> Iterator[None]:
    """Raises TrainingError where the connection ends, as where the node that it leads to has died."""
    try:
        yield
    except OSError as error:
        raise TrainingError(f"the connection to the Ray cluster is lost ({error})") from error


def _next_episode(ray: Any, stream: Any) -> FinishedEpisode | None:
    """The next episode of a block; None at its end."""
    try:
        reference = next(stream, None)
        return None if reference is None else ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, DuneError):
            raise RemoteError(str(error.cause)) from error
        raise RuntimeError(f"a Ray task of the evaluation failed:\n{error}") from error
    except ray.exceptions.RayError as error:
        raise TrainingError(f"a Ray task of the evaluation was lost again and again: {error}") from error


def _stream_block(
    folder: str, name: str, plan: EvaluationPlan, block: EpisodeBlock
) -> Iterator[FinishedEpisode]:
    """The episodes of a block as they end, so that no more than those under way go with the driver."""
    ended: SimpleQueue[FinishedEpisode | None] = SimpleQueue()
    run = _thread.submit(_run_block, folder, name, plan, block, ended.put)
    run.add_done_callback(lambda _: ended.put(None))
    # Ray sends values to the generator, which `yield from` would pass on.
    while (episode := ended.get()) is not None:
        yield episode
    run.result()


def _run_block(
    folder: str,
    name: str,
    plan: EvaluationPlan,
    block: EpisodeBlock,
    emit: Callable[[FinishedEpisode], None],
) -> None:
    """Run a block; the environment is kept for further blocks of the evaluation."""
    if name not in _runners:
        # Paths in settings are relative to where the evaluation was started.
        with suppress(OSError):
            os.chdir(folder)
        for old in _runners.values():
            old.close()
        _runners.clear()
        _runners[name] = BlockRunner(plan)
    _runners[name].run(block, emit)
