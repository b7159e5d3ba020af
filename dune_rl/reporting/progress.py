"""Shows how far a report is, and how long it will take: a bar on a terminal, and nothing elsewhere."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

# Speeds are those of the last minutes [s]: the steps of a report are few and long.
_PERIOD_S = 300.0


class ReportProgress:
    """What a report is doing, how much of it is done, and the time left; a context manager.

    The amounts of its steps are as they take long, about 0.3 s each.
    """

    def __init__(self, console: Console) -> None:
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=None),
            TaskProgressColumn(),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=console,
            disable=not is_shown(console),
            transient=True,
            expand=True,
            speed_estimate_period=_PERIOD_S,
        )
        self._task = self._bar.add_task("", total=None)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def expect(self, total: float) -> None:
        """Set the amount of all steps together."""
        self._bar.update(self._task, total=total)

    def begin(self, activity: str) -> None:
        """Say what goes on."""
        self._bar.update(self._task, description=activity, refresh=True)

    def advance(self, amount: float = 1.0) -> None:
        """A step is done that has this amount."""
        self._bar.update(self._task, advance=amount)


def is_shown(console: Console) -> bool:
    """Whether progress is shown: on a terminal, unless it is that of a CI server."""
    return console.is_terminal and not os.environ.get("CI")


@contextmanager
def show_reading(console: Console) -> Iterator[Callable[[str], None]]:
    """Yields what is to be called with the name of each folder that is read."""
    if not is_shown(console):
        yield lambda name: None
        return
    with console.status("reading") as status:
        yield lambda name: status.update(f"reading {name}")
