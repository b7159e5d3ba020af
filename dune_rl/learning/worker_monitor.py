"""Notices the end of a worker process while this process waits for it."""

import os
import signal
import threading
from collections.abc import Callable, Sequence
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any, TypeVar

from dune_rl.core.errors import TrainingError

T = TypeVar("T")

# Ignored by default, and used for nothing else: a worker's end must not look like a user's signal.
_SIGNAL = getattr(signal, "SIGURG", None)


# How long a process that is ending may take.
_EXIT_S = 10.0
# Seconds between two interruptions.
_AGAIN_S = 0.5


class _WorkerEnded(BaseException):
    """Ends a wait; libraries catch an `Exception` and go on to wait."""


class WorkerMonitor:
    """Waits for what worker `processes` do, and raises `TrainingError` once one of them has ended.

    TorchRL's collectors wait for a dead worker for ever. Outside the main thread, which alone can be
    interrupted, and on systems without such signals, its end is noticed before the next wait only.
    """

    def __init__(self, processes: Sequence[BaseProcess]) -> None:
        self._processes = list(processes)
        self._waits = self._has_lost = False
        self._thread: threading.Thread | None = None
        is_main = threading.current_thread() is threading.main_thread()
        if self._processes and is_main and _SIGNAL is not None:
            self._reader, self._writer = os.pipe()
            self._before: Any = signal.signal(_SIGNAL, self._interrupt)
            self._thread = threading.Thread(target=self._watch, daemon=True)
            self._thread.start()

    def wait(self, action: Callable[[], T]) -> T:
        """The result of `action()`, which waits for the processes."""
        # Before an interruption may come: one in the middle of it would lose the exit code.
        self._check()
        try:
            try:
                self._waits = True
                return action()
            finally:
                self._waits = False
        except _WorkerEnded:
            # Also where the signal came in the `finally` above.
            self._waits = False
        self._check()
        raise TrainingError("a process that steps environments ended")

    def _check(self) -> None:
        ended = connection.wait([process.sentinel for process in self._processes], 0.0)
        for process in self._processes:
            if process.sentinel in ended:
                # Its end is told a moment before it has an exit code.
                process.join(_EXIT_S)
                raise TrainingError(_describe(process.exitcode)) from None

    def _interrupt(self, _number: int, _frame: FrameType | None) -> None:
        if self._waits and self._has_lost:
            raise _WorkerEnded

    def _watch(self) -> None:
        sentinels = [process.sentinel for process in self._processes]
        self._has_lost = self._reader not in connection.wait([self._reader, *sentinels])
        main = threading.main_thread().ident
        assert main is not None and _SIGNAL is not None
        # Again and again: where one comes between two waits, or a library drops it, the next one helps.
        while self._has_lost:
            signal.pthread_kill(main, _SIGNAL)
            if connection.wait([self._reader], _AGAIN_S):
                return

    def close(self) -> None:
        """Watch no longer; the processes may end now. A second call does nothing."""
        self._processes = []
        if self._thread is not None:
            assert _SIGNAL is not None
            os.write(self._writer, b"x")
            self._thread.join()
            self._thread = None
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
