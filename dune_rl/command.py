"""What the command lines share: their arguments, and how they end."""

import errno
import logging
import signal
import sys
import warnings
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, Protocol, TypeVar

import yaml
from hydra._internal.utils import get_args_parser
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dune_rl import plugins
from dune_rl.config.compose import given
from dune_rl.config.schema import EnvConf
from dune_rl.errors import ConfigError, DuneError, DuneWarning
from dune_rl.learning.checkpoint import BEST_POLICY_FILE, CHECKPOINT_FILE, find, read
from dune_rl.paths import conf_folder

_SHOW_WARNING = warnings.showwarning

Lines = Sequence[tuple[str, str]]
Settings = Mapping[str, Any]
ConfT = TypeVar("ConfT", bound=EnvConf, covariant=True)


class Compose(Protocol[ConfT]):
    """What composes a command's settings: from overrides, folders of options, and a run's settings."""

    def __call__(
        self, overrides: Sequence[str], config_dirs: Sequence[str], saved: Settings | None
    ) -> ConfT: ...


# What a user can mend about a folder or file; other operating system errors are faults of ours.
_MENDABLE = {
    errno.EACCES: "no permission",
    errno.EPERM: "no permission",
    errno.EEXIST: "a file of that name is in the way",
    errno.ENOTDIR: "a part of the path is a file",
    errno.EISDIR: "it is a folder",
    errno.EROFS: "the file system is read-only",
    errno.ENOSPC: "the disk is full",
}


class ReportedError(DuneError):
    """A fault whose message has been shown already."""


class Terminated(BaseException):
    """SIGTERM, as an exception that runs every `finally` on its way out."""


@dataclass(frozen=True)
class Page:
    """A page of help: what the command does, how it is called, what can be set, and a last word."""

    title: str
    usage: Lines
    settings: Lines
    closing: str


def run(page: Page, body: Callable[[Namespace], None], *, sweeps: bool = False) -> NoReturn:
    """Call `body` with what the command line says and end the process.

    It ends with 0, with 2 for what the user can mend, 130 for Ctrl-C and 143
    for SIGTERM. `--help` shows the page; without `sweeps`, `-m` is refused.
    """
    signal.signal(signal.SIGTERM, _terminate)
    warnings.showwarning = _warn
    # TorchRL tells of each buffer that it allocates.
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    try:
        parsed = arguments(sys.argv[1:])
        if parsed.help:
            _show_help(page)
        elif parsed.multirun and not sweeps:
            raise ConfigError("this command runs once; leave -m out")
        else:
            body(parsed)
    except ReportedError:
        sys.exit(2)
    except (DuneError, OSError) as error:
        message = mendable(error)
        if message is None:
            raise
        fail(message)
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    except Terminated:
        sys.exit(128 + signal.SIGTERM)
    sys.exit(0)


def _warn(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
    if issubclass(category, DuneWarning):
        say(f"warning: {message}")
    else:
        _SHOW_WARNING(message, category, *place, **more)


def mendable(error: DuneError | OSError) -> str | None:
    """What to tell a user about an error that can be mended; None for a fault of ours."""
    if isinstance(error, DuneError):
        return str(error)
    reason = _MENDABLE.get(error.errno or 0)
    return f"cannot write {error.filename or 'a file'}: {reason}; choose another place" if reason else None


def fail(message: str) -> NoReturn:
    """Show a message on standard error and end with 2."""
    say(message)
    sys.exit(2)


def say(message: str) -> None:
    """Show a message on standard error."""
    print(message, file=sys.stderr, flush=True)


def arguments(words: Sequence[str]) -> Namespace:
    """Hydra's flags and the overrides among the words of a command line; `ConfigError` for unknown flags."""
    parsed, unknown = get_args_parser().parse_known_args(list(words))
    flags = [word for word in unknown if word.startswith("-")]
    if flags:
        raise ConfigError(f"there is no flag {flags[0]}; settings are written key=value (see --help)")
    # Overrides that stand behind a flag end up among the unknown.
    parsed.overrides += unknown
    return parsed


def config_dirs(parsed: Namespace) -> list[str]:
    """Further folders of options, from `--config-dir`."""
    return [parsed.config_dir] if parsed.config_dir else []


def settings_around_checkpoint(
    parsed: Namespace, compose: Compose[ConfT], adapt: Callable[[Settings], Settings] = lambda saved: saved
) -> ConfT | None:
    """The settings of a command that may take `checkpoint=PATH`, which brings those of its run.

    `adapt` changes the run's before the overrides change them. With `--cfg` the settings are shown, and
    None is given: there is no more to do.
    """
    checkpoint = given(parsed.overrides, "checkpoint")
    saved = None
    if checkpoint is not None:
        file = find(Path(str(checkpoint)), BEST_POLICY_FILE, CHECKPOINT_FILE)
        saved = adapt(read(file, "policy", "checkpoint")["config"])
    conf = compose(parsed.overrides, config_dirs(parsed), saved)
    if not parsed.cfg:
        return conf
    print(yaml.safe_dump(conf.model_dump(mode="json"), sort_keys=False), end="")
    return None


def console() -> Console:
    """Where results are printed: as wide as the terminal, and wide enough for a table elsewhere."""
    return Console() if Console().is_terminal else Console(width=120)


def group_settings() -> list[tuple[str, str]]:
    """A line of help for each group of options, with its options."""
    found = []
    brought = set(plugins.entry_points_by_name("dune_rl.worlds"))
    for folder in sorted(path for path in conf_folder().iterdir() if path.is_dir()):
        if folder.name != "experiment":
            options = {path.stem for path in folder.glob("*.yaml")}
            if folder.name == "world":
                found.append(("+world=NAME", ", ".join(sorted(options | brought))))
            else:
                found.append((f"{folder.name}=NAME", ", ".join(sorted(options))))
    return sorted(found, key=lambda item: not item[0].startswith("+"))


def _show_help(page: Page) -> None:
    console = Console(highlight=False, soft_wrap=True)
    console.print(f"[bold]{page.title}[/bold]")
    for lines in (page.usage, [*group_settings(), *page.settings]):
        table = Table(box=None, show_header=False, padding=(0, 2))
        table.add_column(style="cyan", no_wrap=True, min_width=max(len(name) for name, _ in lines))
        table.add_column()
        for name, meaning in lines:
            table.add_row(escape(name), escape(meaning))
        console.print()
        console.print(table)
    console.print(f"\n{page.closing}", markup=False)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated
