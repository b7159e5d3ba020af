"""A background process that builds worlds into the disk cache before they are needed."""

import os
import subprocess
import sys
import weakref
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from dune_rl.core.paths import package_folder

# A pipe takes a line of this length whole or not at all: PIPE_BUF, as Linux has it.
_LONGEST_LINE = 4096
_GRACE_S = 5.0
# Number of requests that are remembered, so that they are not sent twice.
_REMEMBERED = 1024


class BackgroundBuilder:
    """Starts a process that builds worlds into the cache in `folder`, on the first request.

    The process is not a child of `multiprocessing`, because daemonic workers such as TorchRL's may not have
    children. It exits when this process exits or is killed, and after a minute without work.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._child: subprocess.Popen[bytes] | None = None
        self._end: weakref.finalize | None = None
        self._owner = -1
        self._submitted: set[str] = set()

    def submit(self, lines: Iterable[str]) -> None:
        """Request the worlds of these settings (JSON), in this order. It neither blocks nor raises."""
        if not self._running() and not self._start():
            return
        for line in lines:
            data = line.encode() + b"\n"
            if line in self._submitted or len(data) > _LONGEST_LINE:
                continue
            if not self._write(data):
                return
            if len(self._submitted) >= _REMEMBERED:
                self._submitted.clear()
            self._submitted.add(line)

    @property
    def pid(self) -> int | None:
        """Id of the process while it runs, else None."""
        return self._child.pid if self._running() and self._child is not None else None

    def close(self) -> None:
        """Stop the process if this one started it; entries that it has not finished are dropped."""
        if self._end is not None and self._owner == os.getpid():
            self._end()
        self._child = self._end = None
        self._submitted.clear()

    def _running(self) -> bool:
        # After a fork, the process still belongs to the parent.
        return self._child is not None and self._owner == os.getpid() and self._child.poll() is None

    def _start(self) -> bool:
        self.close()
        if not sys.executable:
            return False
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        package = str(package_folder().parent)
        path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
        try:
            child = subprocess.Popen(
                # -P: do not import from the working folder.
                [sys.executable, "-P", "-m", "dune_rl.worlds.cache.background_process", str(os.getpid())],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **threads, "PYTHONPATH": path, "DUNE_RL_CACHE": str(self._folder)},
                # Ctrl-C must reach this process only; the other one exits at the end of its input.
                start_new_session=True,
            )
        except OSError:
            return False
        assert child.stdin is not None
        os.set_blocking(child.stdin.fileno(), False)
        self._child, self._owner = child, os.getpid()
        self._end = weakref.finalize(self, _end, child, os.getpid())
        return True

    def _write(self, data: bytes) -> bool:
        assert self._child is not None and self._child.stdin is not None
        try:
            os.write(self._child.stdin.fileno(), data)
        # The pipe is full, or the process has just exited: `WorldStore.get` builds what it does not.
        except (BlockingIOError, BrokenPipeError):
            return False
        return True


def _end(child: subprocess.Popen[bytes], owner: int) -> None:
    assert child.stdin is not None
    with suppress(BrokenPipeError):
        child.stdin.close()
    if os.getpid() != owner:
        return
    try:
        child.wait(_GRACE_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
