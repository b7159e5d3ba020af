"""Reads damaged files in a process of its own, and tells what each of them did there."""

import logging
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np

from dune_rl.commands.command_line import describe_user_error
from dune_rl.core.errors import DuneError
from dune_rl.core.paths import assets_folder, conf_folder, package_folder
from strangers.attacks import attacks
from strangers.damage import mutated

CPU_S, WALL_S = 20.0, 120.0
# Of the largest height maps that are accepted, of 64 million samples.
MOST_GROWTH = 5 * 2**29
_ADDRESS_SPACE = 6 * 2**30
_MOST_LINES, _MOST_LETTERS = 12, 4_000

ACCEPTED, REFUSED, DEFECT = "accepted", "refused", "defect"

# Events that no file may cause.
_FORBIDDEN = (
    "subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "pickle.find_class",
    "socket.connect",
    "socket.getaddrinfo", "socket.gethostbyname", "urllib.Request", "webbrowser.open", "os.kill",
    "ctypes.dlopen",
)  # fmt: skip
# Events whose arguments are paths that are changed.
_CHANGING = (
    "os.remove",
    "os.rename",
    "os.mkdir",
    "os.rmdir",
    "shutil.rmtree",
    "os.link",
    "os.symlink",
    "os.chmod",
)
_LISTING = ("os.listdir", "os.scandir")


class Sample(NamedTuple):
    """Files with their forms, which `read` reads as the commands do. All of them are in one folder."""

    files: dict[Path, str]
    read: Callable[[], object]


class Outcome(NamedTuple):
    """What a damaged file did: it was accepted, refused in words, or a defect, in `detail`."""

    number: int
    result: str
    detail: str = ""
    seconds: float = 0.0
    grown_mb: float = 0.0


class Watch:
    """An audit hook that notes what a reader does outside of `folder`, or may never do.

    Python keeps audit hooks until its process ends: only for a process of its own.
    """

    def __init__(self, folder: Path) -> None:
        self.faults: list[str] = []
        self.is_on = False
        self._own = str(folder.resolve())
        libraries = [path for path in sys.path if path]
        roots = (sys.prefix, sys.base_prefix, *libraries, package_folder(), conf_folder(), assets_folder())
        self._readable = (self._own, *(str(Path(root).resolve()) for root in roots))
        self._readable += ("/proc/self", "/proc/cpuinfo", "/dev/null", "/dev/urandom", "/dev/shm")
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.is_on:
            return
        # What the watch itself does is not watched.
        self.is_on = False
        try:
            fault = self._fault(event, arguments)
            if fault is not None and fault not in self.faults:
                self.faults.append(fault)
        finally:
            self.is_on = True

    def _fault(self, event: str, arguments: tuple[Any, ...]) -> str | None:
        if event == "pickle.find_class" and _is_numba_loading():
            return None
        if event in _FORBIDDEN:
            return f"{event} {arguments[:1]!r}"[:200]
        if event == "exec":
            file = getattr(arguments[0], "co_filename", "")
            is_file = not file.startswith("<")
            return f"code of {file} is run" if is_file and self._is_in(file, (self._own,)) else None
        if event == "open":
            path, _, flags = arguments
            writes = bool(int(flags or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
            if writes and self._is_compiled(path):
                return None
            roots = (self._own, "/dev/null", "/dev/shm") if writes else self._readable
            return None if self._is_in(path, roots) else f"{'writes' if writes else 'reads'} {path!r}"
        if event in _LISTING:
            return None if self._is_in(arguments[0] or ".", self._readable) else f"lists {arguments[0]!r}"
        if event in _CHANGING and self._is_compiled(arguments[0]):
            return None
        if event in _CHANGING:
            return None if self._is_in(arguments[0], (self._own,)) else f"{event} {arguments[0]!r}"
        return None

    def _is_compiled(self, path: Any) -> bool:
        """Whether numba keeps the code there that it compiled."""
        folders = str(path).split(os.sep)
        return "__pycache__" in folders and self._is_in(path, (str(package_folder().resolve()),))

    def _is_in(self, path: Any, roots: Sequence[str]) -> bool:
        if isinstance(path, int):
            return True
        try:
            real = os.path.realpath(os.fsdecode(path))
        except (TypeError, ValueError):
            # Such as a name with a null byte, which opens nothing.
            return True
        return any(real == root or real.startswith(root + os.sep) for root in roots)


def _is_numba_loading() -> bool:
    """Whether numba is reading the code that it compiled before, which it keeps as pickles in its cache."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_globals.get("__name__") == "numba.core.caching":
            return True
        frame = frame.f_back
    return False


def run_damaged(make: Callable[[Path], Sample], numbers: Sequence[int], folder: Path) -> Iterator[Outcome]:
    """Read each damaged file, by its number, one after the other; a process that dies is a defect of one."""
    context = multiprocessing.get_context("fork")
    left, start = list(numbers), 0
    while left:
        mine, theirs = context.Pipe(duplex=False)
        start += 1
        own = folder / str(start)
        own.mkdir(parents=True)
        process = context.Process(target=_work, args=(make, list(left), own, theirs), daemon=True)
        with warnings.catch_warnings():
            # Python 3.12 warns of forks beside threads, of which the child uses none.
            warnings.simplefilter("ignore", DeprecationWarning)
            process.start()
        theirs.close()
        try:
            # The first message says that the sample was read.
            mine.recv()
            while left:
                outcome: Outcome = mine.recv()
                left.remove(outcome.number)
                yield outcome
        except EOFError:
            process.join()
            if start > 1 + len(numbers):
                raise RuntimeError("the undamaged sample ends the process") from None
            code = process.exitcode or 0
            named = {
                -signal.SIGPROF: f"hang: {CPU_S:g} s of processor",
                -signal.SIGALRM: f"hang: {WALL_S:g} s",
            }
            yield Outcome(left.pop(0), DEFECT, named.get(code, f"crash: exit code {code}"))
        finally:
            mine.close()
            if process.is_alive():
                process.kill()
            process.join()


def _work(make: Callable[[Path], Sample], numbers: Sequence[int], folder: Path, pipe: Connection) -> None:
    tempfile.tempdir = str(folder / "tmp")
    os.mkdir(tempfile.tempdir)
    os.chdir(folder)
    null = os.open(os.devnull, os.O_WRONLY)
    for handle in (1, 2):
        os.dup2(null, handle)
    os.environ["DUNE_RL_CACHE"] = "off"
    warnings.simplefilter("ignore")
    # Handlers of whatever ran before have streams that may be closed.
    logging.disable(logging.CRITICAL)
    # Compiled modules are none of a file's doing.
    sys.dont_write_bytecode = True
    sample = make(folder)
    whole = {path: path.read_bytes() for path in sample.files}
    watch = Watch(folder)
    sample.read()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + _ADDRESS_SPACE, size + _ADDRESS_SPACE))
    files = list(sample.files)
    built = [
        partial(_nth_attack, whole[path], form, nth, path)
        for path, form in sample.files.items()
        for nth in range(len(_attacks_of(whole[path], form)))
    ]
    pipe.send("ready")
    for number in numbers:
        rng = np.random.default_rng([number, 77])
        if number < len(built):
            path, data = built[number]()
        else:
            path = files[int(rng.integers(len(files)))]
            data = mutated(whole[path], sample.files[path], rng)
        for other, content in whole.items():
            if other != path:
                other.write_bytes(content)
        path.write_bytes(data)
        pipe.send(_outcome(number, sample.read, watch))


# Bombs take seconds to make: a process has those that its parent has made.
_known: dict[tuple[bytes, str], list[bytes]] = {}


def _attacks_of(data: bytes, form: str) -> list[bytes]:
    if (data, form) not in _known:
        _known[data, form] = attacks(data, form)
    return _known[data, form]


def _nth_attack(data: bytes, form: str, nth: int, path: Path) -> tuple[Path, bytes]:
    return path, _attacks_of(data, form)[nth]


def count_attacks(make: Callable[[Path], Sample], folder: Path) -> int:
    """How many of the first numbers are files that were built to do harm."""
    sample = make(folder)
    return sum(len(_attacks_of(path.read_bytes(), form)) for path, form in sample.files.items())


def _memory(name: str) -> int:
    line = next(each for each in Path("/proc/self/status").read_text().splitlines() if each.startswith(name))
    return int(line.split()[1]) * 1024


def _outcome(number: int, read: Callable[[], object], watch: Watch) -> Outcome:
    Path("/proc/self/clear_refs").write_text("5")
    before = _memory("VmRSS")
    watch.faults = []
    signal.setitimer(signal.ITIMER_PROF, CPU_S)
    signal.setitimer(signal.ITIMER_REAL, WALL_S)
    begun = time.perf_counter()
    result, detail = ACCEPTED, ""
    watch.is_on = True
    try:
        read()
    except BaseException as error:
        watch.is_on = False
        result, detail = _judge(error)
    watch.is_on = False
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    seconds, grown = time.perf_counter() - begun, _memory("VmHWM") - before
    if watch.faults:
        result, detail = DEFECT, "; ".join(watch.faults[:3])
    elif grown > MOST_GROWTH and result != DEFECT:
        result, detail = DEFECT, f"memory: {grown / 2**20:.0f} MiB"
    return Outcome(number, result, detail, seconds, grown / 2**20)


def _judge(error: BaseException) -> tuple[str, str]:
    """What a user sees of an error: words, or a traceback, which is a defect."""
    message = describe_user_error(error) if isinstance(error, DuneError | OSError) else None
    chain: BaseException | None = error
    while chain is not None:
        if isinstance(chain, MemoryError):
            return DEFECT, f"memory: MemoryError at {_place(chain)}"
        chain = chain.__cause__ or chain.__context__
    if message is None:
        text = (str(error).splitlines() or [""])[0][:160]
        return DEFECT, f"{type(error).__name__} at {_place(error)}: {text}"
    if len(message.splitlines()) > _MOST_LINES or len(message) > _MOST_LETTERS:
        return (
            DEFECT,
            f"message of {len(message.splitlines())} lines, {len(message)} letters: {message[:200]!r}",
        )
    return REFUSED, message


def _place(error: BaseException) -> str:
    """Where in the package an error was raised, or passed last."""
    frames = [each for each in traceback.extract_tb(error.__traceback__) if "dune_rl" in each.filename]
    if not frames:
        return "?"
    return f"{frames[-1].filename.rpartition('dune_rl/')[2]}:{frames[-1].lineno}"
