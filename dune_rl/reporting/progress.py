"""Shows how far a report is, and how long it will take: a bar on a terminal, and nothing elsewhere."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn

# Speeds are those of the last minutes [s]: the steps of a report are few and long.
_PERIOD_S = 300.0
_TASK = TaskID(0)


class ReportProgress(Progress):
    """The present step of a report, the share that is done, and the time left.

    The amounts of steps are proportional to their time, 1 for about 0.3 s.
    """

    def __init__(self, console: Console) -> None:
        super().__init__(
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
        self.add_task("", total=None)

    def expect(self, total: float) -> None:
        """Set the amount of all steps together."""
        self.update(_TASK, total=total)

    def begin(self, activity: str) -> None:
        """Name the step that begins."""
        self.update(_TASK, description=activity, refresh=True)

    def finish(self, amount: float = 1.0) -> None:
        """Add the amount of a step that has ended."""
        self.advance(_TASK, amount)


def is_shown(console: Console) -> bool:
    """Whether progress is shown: on a terminal, unless it is that of a CI server."""
    return console.is_terminal and not os.environ.get("CI")


@contextmanager
def show_reading(console: Console) -> Iterator[Callable[[str], None]]:
    """Yields a function that shows the name of the folder that is read."""
    if not is_shown(console):
        yield lambda name: None
        return
    with console.status("reading") as status:
        yield lambda name: status.update(f"reading {name}")
