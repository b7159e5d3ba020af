"""A process beside this one that builds worlds ahead."""

import os
import subprocess
import sys
import weakref
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from dune_rl.paths import package_folder

# A pipe takes a line of this length whole or not at all: PIPE_BUF, as Linux has it.
_LONGEST_LINE = 4096
_GRACE_S = 5.0
# Requests that are not repeated.
_REMEMBERED = 1024


class Preparation:
    """Has worlds built into the cache in `folder`; the other process begins with the first that is asked for.

    It is no child of `multiprocessing`, which daemonic workers such as TorchRL's may not have. It ends when
    this process does, however that ends, and by itself when it has had nothing to do for a while.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._child: subprocess.Popen[bytes] | None = None
        self._end: weakref.finalize | None = None
        self._owner = -1
        self._asked: set[str] = set()

    def ask(self, lines: Iterable[str]) -> None:
        """Have the worlds of these settings (JSON) built in this order; never waits, and never fails."""
        if not self._running() and not self._start():
            return
        for line in lines:
            data = line.encode() + b"\n"
            if line in self._asked or len(data) > _LONGEST_LINE:
                continue
            if not self._write(data):
                return
            if len(self._asked) >= _REMEMBERED:
                self._asked.clear()
            self._asked.add(line)

    @property
    def pid(self) -> int | None:
        """The other process's number while it runs."""
        return self._child.pid if self._running() and self._child is not None else None

    def close(self) -> None:
        """End the other process, if this one has it; entries that it was writing are dropped."""
        if self._end is not None and self._owner == os.getpid():
            self._end()
        self._child = self._end = None
        self._asked.clear()

    def _running(self) -> bool:
        # After a fork, the other process is still the parent's.
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
                # -P: the working folder is no place to import from.
                [sys.executable, "-P", "-m", "dune_rl.worlds.cache.background_process", str(os.getpid())],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **threads, "PYTHONPATH": path, "DUNE_RL_CACHE": str(self._folder)},
                # Ctrl-C is for this process; the other learns of it by the end of its input.
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
        # It is busy with as much as the pipe holds, or has just ended: `get` builds what it does not.
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
