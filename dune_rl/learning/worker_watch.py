"""Notices the end of a worker process while this process waits for it."""

import os
import signal
import threading
from collections.abc import Sequence
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any

from dune_rl.errors import TrainingError

# Ignored by default, and used for nothing else: a worker's end must not look like a user's signal.
_SIGNAL = getattr(signal, "SIGURG", None)


# How long a process that is ending may take.
_EXIT_S = 10.0


class _WorkerEnded(BaseException):
    """Ends a wait; libraries catch an `Exception` and go on to wait."""


class WorkerWatch:
    """Raises `TrainingError` in the main thread, while that waits, once one of `processes` has ended.

    TorchRL's collectors wait for a dead worker for ever. Outside the main thread, which alone can be
    interrupted, and on systems without such signals, it is noticed before the next wait only.
    """

    def __init__(self, processes: Sequence[BaseProcess]) -> None:
        self._processes = list(processes)
        self._waits = False
        self._reader, self._writer = os.pipe()
        self._before: Any = None
        self._can_interrupt = _SIGNAL is not None and threading.current_thread() is threading.main_thread()
        if self._can_interrupt:
            assert _SIGNAL is not None
            self._before = signal.signal(_SIGNAL, self._interrupt)
            self._thread = threading.Thread(target=self._watch, daemon=True)
            self._thread.start()

    def __enter__(self) -> None:
        self._waits = True
        self._check()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._waits = False
        if kind is None or kind is _WorkerEnded:
            self._check()

    def _check(self) -> None:
        ended = connection.wait([process.sentinel for process in self._processes], 0.0)
        for process in self._processes:
            if process.sentinel in ended:
                # Its end is told a moment before it has an exit code.
                process.join(_EXIT_S)
                raise TrainingError(_describe(process.exitcode)) from None

    def _interrupt(self, _number: int, _frame: FrameType | None) -> None:
        if self._waits:
            raise _WorkerEnded

    def _watch(self) -> None:
        sentinels = [process.sentinel for process in self._processes]
        ready = connection.wait([self._reader, *sentinels])
        if self._reader not in ready and hasattr(signal, "pthread_kill"):
            assert _SIGNAL is not None
            main = threading.main_thread().ident
            assert main is not None
            signal.pthread_kill(main, _SIGNAL)

    def close(self) -> None:
        """Watch no longer; the processes may end now."""
        if self._can_interrupt:
            os.write(self._writer, b"x")
            self._thread.join()
            assert _SIGNAL is not None
            signal.signal(_SIGNAL, self._before)
        os.close(self._reader)
        os.close(self._writer)


def _describe(code: int | None) -> str:
    if code is None or code >= 0:
        return f"a process that steps environments ended, with exit code {code}"
    name = signal.Signals(-code).name
    hint = (
        " (the system does so when memory is short: fewer learning.collector.scenes)"
        if name == "SIGKILL"
        else ""
    )
    return f"a process that steps environments was ended by {name}{hint}"
