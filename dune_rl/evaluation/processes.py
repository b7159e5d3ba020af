"""Runs blocks of episodes in several processes, which are started anew (spawned)."""

import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import cast

from dune_rl.core.errors import DuneError, TrainingError
from dune_rl.evaluation.blocks import EpisodeBlock, FinishedEpisode
from dune_rl.evaluation.running import BlockRunner, EvaluationPlan

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
    workers: dict[Connection, BaseProcess] = {}
    try:
        for _ in range(min(processes, len(blocks))):
            # One for each, and no lock that they share: one that is killed leaves the others alone.
            ours, theirs = context.Pipe()
            workers[ours] = context.Process(target=_work, args=(plan, theirs), daemon=True)
            workers[ours].start()
            # The worker alone holds its end, so that its death ends what is read here, amid a message too.
            theirs.close()
        _collect(workers, blocks, emit)
    finally:
        started = [worker for worker in workers.values() if worker.pid is not None]
        for worker in started:
            worker.terminate()
        for worker in started:
            worker.join(_JOIN_S)
            if worker.is_alive():
                worker.kill()
        for connection in workers:
            connection.close()


def _collect(
    workers: Mapping[Connection, BaseProcess],
    blocks: Sequence[EpisodeBlock],
    emit: Callable[[FinishedEpisode], None],
) -> None:
    """Give each worker the next of `blocks` when it asks, and `emit` the episodes of all."""
    working, left = dict(workers), iter(blocks)
    while working:
        for connection in wait(list(working)):
            connection = cast(Connection, connection)
            with _telling_loss(working[connection]):
                kind, content = connection.recv()
                if kind == "ask":
                    connection.send(next(left, None))
            if kind == "episode":
                emit(content)
            elif kind == "end":
                del working[connection]
            elif kind == "mend":
                raise RemoteError(content)
            elif kind == "fault":
                raise RuntimeError(f"a process of the evaluation failed:\n{content}")


@contextmanager
def _telling_loss(worker: BaseProcess) -> Iterator[None]:
    """Raises TrainingError where a connection ends, and with it the process at its other end."""
    try:
        yield
    except (EOFError, OSError):
        worker.join(_JOIN_S)
        raise TrainingError(
            f"a process of the evaluation ended with code {worker.exitcode}; take fewer processes or scenes "
            "if memory ran out, and go on with resume"
        ) from None


def _work(plan: EvaluationPlan, connection: Connection) -> None:
    # Ctrl-C reaches all processes of a terminal; the parent ends the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        runner = BlockRunner(plan)
        connection.send(("ask", ""))
        while (block := connection.recv()) is not None:
            runner.run(block, lambda episode: connection.send(("episode", episode)))
            connection.send(("ask", ""))
        runner.close()
        last = "end", ""
    except DuneError as error:
        last = "mend", str(error)
    except Exception:
        last = "fault", traceback.format_exc()
    # Where the parent is gone, nobody is left to be told.
    with suppress(OSError):
        connection.send(last)


def _end_with_parent() -> None:
    """End this process when its parent is gone, which may have been killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
