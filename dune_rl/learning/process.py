"""The processes of a training run: stop signals, random states, memory, and the end of a worker process."""

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import connection, resource_tracker
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any, TypeVar

import numpy as np
import torch

from dune_rl.core.errors import TrainingError

# Ctrl-C, the end that a system asks for, and what batch systems send some time before they end a job.
STOP_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGUSR1", "SIGUSR2") if hasattr(signal, name)
)


class StopRequest:
    def __init__(self) -> None:
        self.signal: int | None = None

    def __call__(self) -> bool:
        return self.signal is not None


@contextmanager
def stop_on_signals(announce: Callable[[str], None] = lambda line: None) -> Iterator[StopRequest]:
    """Note `STOP_SIGNALS` instead of dying of them; a second Ctrl-C interrupts at once, as usual.

    `announce` gets a line for the user. Outside the main thread, which alone receives signals, nothing is
    changed.
    """
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    before = {number: signal.getsignal(number) for number in STOP_SIGNALS}

    def note(number: int, _frame: FrameType | None) -> None:
        request.signal = number
        # The signal may have come in the middle of other output.
        with suppress(RuntimeError):
            announce("Stopping: the run is saved after this batch; Ctrl-C again ends it at once, unsaved")
        signal.signal(signal.SIGINT, signal.default_int_handler)

    try:
        for number in before:
            signal.signal(number, note)
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def closing_all(closes: Sequence[Callable[[], object]]) -> Iterator[None]:
    """Call all of `closes` at the end; an error of one does not keep the others from closing.

    Nor does it hide an error of the body, which matters more.
    """
    failed: list[BaseException] = []
    has_ended = False
    try:
        yield
        has_ended = True
    finally:
        for close in closes:
            try:
                close()
            except BaseException as error:
                failed.append(error)
        # An interruption is no fault of what closes.
        stops = [error for error in failed if not isinstance(error, Exception)]
        if stops or (has_ended and failed):
            raise (stops or failed)[0]


@contextmanager
def blocked_signals() -> Iterator[None]:
    """Block `STOP_SIGNALS`, for processes that are started meanwhile: these inherit the mask for life.

    Ctrl-C, or what a batch system sends to all processes of a job, then reaches the learner alone, which ends
    them in order. The learner itself gets what arrived as soon as the block ends.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start_resource_tracker() -> None:
    """Start Python's process that cleans up after others; started by Python, it would die of SIGUSR1."""
    if hasattr(signal, "pthread_sigmask"):
        with blocked_signals():
            resource_tracker.ensure_running()


def random_state() -> dict[str, Any]:
    """States of torch's and NumPy's global generators, as `torch.load(weights_only=True)` reads them."""
    name, keys, position, has_gauss, gauss = np.random.get_state(legacy=True)
    mersenne = torch.from_numpy(np.asarray(keys).astype(np.int64))
    return {
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
        "numpy": [str(name), mersenne, int(position), int(has_gauss), float(gauss)],
    }


def set_random_state(state: dict[str, Any]) -> None:
    """The inverse of `random_state`; CUDA states are restored if the number of devices is the same."""
    torch.set_rng_state(state["torch"])
    if state["cuda"] and len(state["cuda"]) == torch.cuda.device_count():
        torch.cuda.set_rng_state_all(state["cuda"])
    name, keys, position, has_gauss, gauss = state["numpy"]
    np.random.set_state((name, keys.numpy().astype(np.uint32), position, has_gauss, gauss))


@contextmanager
def preserve_random_state() -> Iterator[None]:
    state = random_state()
    try:
        yield
    finally:
        set_random_state(state)


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_KEPT_BYTES = 1 << 30


def keep_freed_memory() -> None:
    """Stop glibc from handing activations back to the kernel after every update; elsewhere, do nothing.

    An update allocates and frees the same half-megabyte blocks again and
    again; with glibc's defaults each costs fresh pages.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        mallopt(_M_MMAP_THRESHOLD, _KEPT_BYTES)


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
