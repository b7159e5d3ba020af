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


class BackgroundBuilder:
    """Runs `dune_rl.worlds.cache.build_ahead` on the cache in `folder`, from the first request on.

    It is not a `concurrent.futures.ProcessPoolExecutor`: daemonic workers such as TorchRL's may not have
    children of `multiprocessing`, and a script without `if __name__ == "__main__"` would run twice.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None

    def submit(self, lines: Iterable[str]) -> None:
        """Request worlds, one per line (`encode_request`), in this order. It neither blocks nor raises."""
        # Without a process, or if its pipe is full (`write` returns None), `WorldStore.get` builds the world.
        with suppress(OSError):
            if self.pid is None:
                self._start()
            assert self._process is not None and self._process.stdin is not None
            for data in (line.encode() + b"\n" for line in lines):
                if len(data) <= _LONGEST_LINE:
                    self._process.stdin.write(data)

    @property
    def pid(self) -> int | None:
        """Id of the process while it runs, else None; None in a fork, whose parent has the process."""
        return None if self._process is None or self._process.poll() is not None else self._process.pid

    def close(self) -> None:
        """Stop the process; an entry that it has not finished is dropped."""
        if self._process is not None:
            _stop(self._process)
        self._process = None

    def _start(self) -> None:
        self.close()
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        path = os.pathsep.join([str(package_folder().parent), *filter(None, [os.environ.get("PYTHONPATH")])])
        self._process = subprocess.Popen(
            # -P: do not import from the working folder.
            [sys.executable, "-P", "-m", "dune_rl.worlds.cache.build_ahead", str(os.getpid())],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **threads, "PYTHONPATH": path, "DUNE_RL_CACHE": str(self._folder)},
            # Ctrl-C must reach this process only; the other one exits at the end of its input.
            start_new_session=True,
        )
        assert self._process.stdin is not None
        os.set_blocking(self._process.stdin.fileno(), False)
        weakref.finalize(self, _stop, self._process)


def _stop(process: "subprocess.Popen[bytes]") -> None:
    assert process.stdin is not None
    process.stdin.close()
    # In a fork, both do nothing.
    process.terminate()
    process.wait()
