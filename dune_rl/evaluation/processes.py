"""Runs blocks of episodes in several processes, which are started anew (spawned)."""

import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable, Sequence
from queue import Empty
from typing import Any

from dune_rl.core.errors import DuneError, TrainingError
from dune_rl.evaluation.blocks import EpisodeBlock, FinishedEpisode
from dune_rl.evaluation.running import BlockRunner, EvaluationPlan

_WAIT_S = 1.0
_JOIN_S = 5.0


class RemoteError(DuneError):
    """An error of another process, with its message."""


def run_in_processes(
    plan: EvaluationPlan,
    blocks: Sequence[EpisodeBlock],
    processes: int,
    emit: Callable[[FinishedEpisode], None],
) -> None:
    """Run `blocks` and `emit` their episodes as they end; no process outlives this function.

    Raises RemoteError for an error that a user can mend, and TrainingError if a process is lost.
    """
    context = multiprocessing.get_context("spawn")
    tasks, results = context.Queue(), context.Queue()
    count = min(processes, len(blocks))
    for block in [*blocks, *[None] * count]:
        tasks.put(block)
    workers = [context.Process(target=_work, args=(plan, tasks, results), daemon=True) for _ in range(count)]
    try:
        for worker in workers:
            worker.start()
        _collect(workers, results, emit)
    finally:
        for queue in (tasks, results):
            queue.cancel_join_thread()
        for worker in workers:
            if worker.pid is not None:
                worker.terminate()
        for worker in workers:
            if worker.pid is not None:
                worker.join(_JOIN_S)
                if worker.is_alive():
                    worker.kill()


def _collect(workers: Sequence[Any], results: Any, emit: Callable[[FinishedEpisode], None]) -> None:
    open_workers = len(workers)
    while open_workers:
        try:
            kind, content = results.get(timeout=_WAIT_S)
        except Empty:
            lost = [worker for worker in workers if worker.exitcode not in (None, 0)]
            if lost:
                raise TrainingError(
                    f"a process of the evaluation ended with code {lost[0].exitcode}; take fewer "
                    "processes or scenes if memory ran out, and go on with resume"
                ) from None
            continue
        if kind == "episode":
            emit(content)
        elif kind == "end":
            open_workers -= 1
        elif kind == "mend":
            raise RemoteError(content)
        else:
            raise RuntimeError(f"a process of the evaluation failed:\n{content}")


def _work(plan: EvaluationPlan, tasks: Any, results: Any) -> None:
    # Ctrl-C reaches all processes of a terminal; the parent ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        runner = BlockRunner(plan)
        while (block := tasks.get()) is not None:
            runner.run(block, lambda episode: results.put(("episode", episode)))
        runner.close()
        results.put(("end", ""))
    except DuneError as error:
        results.put(("mend", str(error)))
    except Exception:
        results.put(("fault", traceback.format_exc()))


def _end_with_parent() -> None:
    """End this process when its parent is gone, which may have been killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
