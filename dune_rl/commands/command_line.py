"""What all command lines share: arguments, help, errors and exit codes."""

import _thread
import errno
import logging
import os
import re
import select
import shlex
import shutil
import signal
import sys
import threading
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

from dune_rl.commands.pages import PAGES, HelpPage, show_help
from dune_rl.core.errors import ConfigError, DuneError, DuneWarning
from dune_rl.core.paths import conf_folder
from dune_rl.core.plugins import entry_points_by_name
from dune_rl.core.suggestions import advise

# Everything else is imported in the functions that need it: `--help` shall be there at once.
if TYPE_CHECKING:
    from rich.console import Console

    from dune_rl.config.schema import EnvConf
    from dune_rl.core.settings import Settings

_SHOW_WARNING = warnings.showwarning

# Of a message: a name or a list in a file may have any length.
_LONGEST_LINE = 1_500
# Errors of the file system that a user can mend; others are faults of ours.
_FILE_ERRORS = {
    errno.EACCES: "no permission",
    errno.ENOENT: "it cannot be made there",
    errno.EPERM: "no permission",
    errno.EEXIST: "a file of that name is in the way",
    errno.ENOTDIR: "a part of the path is a file",
    errno.EISDIR: "it is a folder",
    errno.EROFS: "the file system is read-only",
    errno.ENOSPC: "the disk is full",
    errno.ENAMETOOLONG: "the name is too long",
}


# What a shell has for a program that SIGPIPE ended.
_UNREAD = 141
# A lost signal is repeated after this time, when what lost it is over or loses it again.
_AGAIN_S = 0.05


# Commands whose settings Hydra composes.
_COMPOSED = ("train", "evaluate", "forecast", "ros", "view", "export", "benchmark")


class ReportedError(DuneError):
    """An error whose message has been printed already."""


class Terminated(BaseException):
    """SIGTERM as an exception, so that every `finally` runs."""


_STOPS = ((KeyboardInterrupt, signal.SIGINT), (Terminated, signal.SIGTERM))


def command(name: str) -> Callable[[], NoReturn]:
    """The `main` of `python -m dune_rl.NAME`: it calls `run` of the module NAME of this folder.

    The module is not loaded for `--help`, nor for a world that does not exist.
    """

    def body(words: Sequence[str]) -> None:
        if name in _COMPOSED:
            check_world_name(words)
        import_module(f"dune_rl.commands.{name}").run(words)

    def main() -> NoReturn:
        run_command(PAGES[name], body)

    return main


def check_world_name(words: Sequence[str]) -> None:
    """Raise ConfigError if `world=NAME` names no world: loading the settings first would take a second.

    With further folders of options (`--config-dir`), only the loaded settings know all names.
    """
    if any(word.startswith(("--config", "-cd")) for word in words):
        return
    for word in words:
        key, _, name = word.partition("=")
        if key.lstrip("+") != "world" or name == "null" or not re.fullmatch(r"[A-Za-z]\w*", name):
            continue
        known = {file.stem for file in (conf_folder() / "world").glob("*.yaml")}
        known |= entry_points_by_name("dune_rl.worlds").keys()
        registry = sys.modules.get("dune_rl.worlds.registry")
        if registry is not None:
            known |= {*registry.WORLDS.names()}
        if name not in known:
            raise ConfigError(f"there is no world {name!r}; {advise(name, sorted(known))}")


def run_command(page: HelpPage, body: Callable[[Sequence[str]], None]) -> NoReturn:
    """Call `body` with the words of the command line and end the process.

    The exit code is 0, 2 for errors that a user can mend, 130 for Ctrl-C, 143 for SIGTERM, and 141 where
    nobody reads the output any more. `--help` prints the page.
    """
    signal.signal(signal.SIGTERM, _terminate)
    warnings.showwarning = _warn
    if sys.unraisablehook is sys.__unraisablehook__:
        sys.unraisablehook = _stop_later
    threading.excepthook = _tell_error_of_thread
    # TorchRL logs each buffer that it allocates.
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    try:
        words = sys.argv[1:]
        if {"-h", "--help"} & {*words}:
            show_help(page)
        else:
            body(words)
        sys.stdout.flush()
    except ReportedError:
        sys.exit(2)
    except (DuneError, OSError) as error:
        exit_if_unread(error)
        message = describe_user_error(error)
        if message is None:
            raise
        exit_with_error(message)
    except KeyboardInterrupt:
        print_error("Interrupted")
        sys.exit(128 + signal.SIGINT)
    except Terminated:
        sys.exit(128 + signal.SIGTERM)
    except ModuleNotFoundError as error:
        message = _describe_missing(error)
        if message is None:
            raise
        exit_with_error(message)
    except Exception as error:
        # Another thread may clear them.
        lost = [*_lost_signals, *_signals_behind(error)]
        if not lost:
            raise
        # The library whose callback lost the signal failed for want of what that was to do.
        if lost[0] == signal.SIGINT:
            print_error("Interrupted")
        sys.exit(128 + lost[0])
    sys.exit(0)


def exit_if_unread(error: Exception) -> None:
    """End the process quietly where `error` says that nobody reads its output any more."""
    if isinstance(error, BrokenPipeError) and _drop_unread_output():
        sys.exit(_UNREAD)


def _drop_unread_output() -> bool:
    """Whether nobody reads the output any more, as `head` does once it has enough; it goes nowhere then."""
    if not hasattr(select, "poll"):  # Windows
        return False
    output = sys.stdout.fileno()
    poll = select.poll()
    poll.register(output, 0)
    is_unread = any(event & select.POLLERR for _, event in poll.poll(0))
    if is_unread:
        os.dup2(os.open(os.devnull, os.O_WRONLY), output)
    return is_unread


# Signals whose exceptions were lost, until they are repeated.
_lost_signals: list[signal.Signals] = []


def _stop_later(unraisable: "sys.UnraisableHookArgs") -> None:
    """Repeat a signal whose exception was lost, as in the callbacks from C with which numba loads its code.

    Python would print the exception, and go on.
    """
    for stop, number in _STOPS:
        if issubclass(unraisable.exc_type, stop):
            _lost_signals.append(number)
            again = threading.Timer(_AGAIN_S, _signal_main_thread, [number])
            again.daemon = True
            again.start()
            return
    sys.__unraisablehook__(unraisable)


def _signals_behind(error: BaseException | None) -> Iterator[signal.Signals]:
    """The signals whose exceptions a library in C turned into an error of its own, as Ray's does."""
    while error is not None:
        for stop, number in _STOPS:
            if isinstance(error, stop):
                yield number
        error = error.__cause__ or error.__context__


def _signal_main_thread(number: signal.Signals) -> None:
    """Send a signal to the main thread, which ends its waiting, too, where the system can do so."""
    _lost_signals.clear()
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        _thread.interrupt_main(number)


def _warn(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
    if issubclass(category, DuneWarning):
        print_error(f"warning: {message}")
    else:
        _SHOW_WARNING(message, category, *place, **more)


def describe_user_error(error: DuneError | OSError) -> str | None:
    """The message of an error that a user can mend; None for a fault of ours. Very long lines are cut."""
    if isinstance(error, DuneError):
        return "\n".join(_cut_line(line) for line in str(error).split("\n"))
    reason = _FILE_ERRORS.get(error.errno or 0)
    # TensorBoard opens its files by names in bytes.
    name = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else error.filename
    return f"cannot write {name or 'a file'}: {reason}; choose another place" if reason else None


def _describe_missing(error: ModuleNotFoundError) -> str | None:
    """What to install where a package that this one needs is missing; None for other modules."""
    from dune_rl.core.machine import module_name, required_packages

    try:
        needed = {module_name(package.name): str(package) for package in required_packages()}
    except ModuleNotFoundError as first:
        # That of which the requirements are read.
        error, needed = first, {"packaging": "packaging"}
    name, _, part = (error.name or "").partition(".")
    package = needed.get(name)
    if package is None:
        return None
    what = f"is of a version without {error.name}" if part else "is not installed"
    return (
        f"dune_rl needs {package}, which {what}; pip install '{package}', "
        f"and {shell_command('dune_rl.doctor')} names all that is missing"
    )


def _tell_error_of_thread(failed: threading.ExceptHookArgs) -> None:
    """A line where a thread, such as TensorBoard's, meets what a user can mend, such as a full disk."""
    error = failed.exc_value
    message = describe_user_error(error) if isinstance(error, DuneError | OSError) else None
    if message is None:
        threading.__excepthook__(failed)
    else:
        print_error(message)


def _cut_line(line: str) -> str:
    half = _LONGEST_LINE // 2
    return line if len(line) <= _LONGEST_LINE else f"{line[:half]} ... {line[-half:]}"


def exit_with_error(message: str) -> NoReturn:
    """Print a message on standard error and end the process with exit code 2."""
    print_error(message)
    sys.exit(2)


def print_world_notes(console: "Console", conf: "EnvConf", *, fixes_starts: bool = False) -> None:
    """Print what an importer chose in the world of `conf`: a line for each choice; see `describe_world`."""
    from dune_rl.config.build import describe_world

    for line in describe_world(conf, fixes_starts=fixes_starts):
        print_line(console, line)


def print_line(console: "Console", line: str) -> None:
    """Print a line as it is: without colours, markup (names of files may look like it) or line breaks."""
    console.print(line, highlight=False, markup=False, soft_wrap=True)


def python_here() -> str:
    """How a user calls this Python: `python` where that is found first, else its path."""
    found = shutil.which("python")
    is_first = found is not None and os.path.abspath(found) == os.path.abspath(sys.executable)
    return "python" if is_first else shown_path(Path(sys.executable))


def shell_command(module: str, *words: str) -> str:
    """A command as a user types it, `python -m MODULE` of this Python, in quotes where a shell needs them."""
    return shlex.join([python_here(), "-m", module, *words])


def shown_path(path: Path) -> str:
    """A path as it is shown and typed: relative, where it is below the current folder."""
    below = Path(os.path.abspath(path))
    return str(below.relative_to(Path.cwd()) if below.is_relative_to(Path.cwd()) else path)


def print_error(message: str) -> None:
    print(message, file=sys.stderr, flush=True)


def parse_arguments(words: Sequence[str], *, sweeps: bool = False) -> Namespace:
    """Hydra's flags and the overrides among the words of a command line; `ConfigError` for unknown flags.

    Without `sweeps`, `-m` is refused.
    """
    from hydra._internal.utils import get_args_parser

    parsed, unknown = get_args_parser().parse_known_args(list(words))
    flags = [word for word in unknown if word.startswith("-")]
    if flags:
        raise ConfigError(f"there is no flag {flags[0]}; settings are written key=value (see --help)")
    if parsed.multirun and not sweeps:
        raise ConfigError("this command runs once; leave -m out")
    # argparse takes overrides after a flag for unknown words.
    parsed.overrides += unknown
    return parsed


def config_folders(parsed: Namespace) -> list[str]:
    return [parsed.config_dir] if parsed.config_dir else []


def print_settings(conf: "Settings") -> None:
    """Print settings as YAML, for `--cfg job`."""
    import yaml

    print(yaml.safe_dump(conf.model_dump(mode="json"), sort_keys=False), end="")


def make_console() -> "Console":
    """A console for results: as wide as the terminal, and wide enough for a table elsewhere."""
    from rich.console import Console

    class PipedConsole(Console):
        def on_broken_pipe(self) -> None:
            # Rich would end the process as if by a fault.
            raise BrokenPipeError

    is_wide = Console().is_terminal or "COLUMNS" in os.environ
    return PipedConsole() if is_wide else PipedConsole(width=120)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated
