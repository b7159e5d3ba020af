"""The text of a command's `--help`, which is shown without loading what the command itself needs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dune_rl.core import plugins
from dune_rl.core.paths import conf_folder

HelpRows = Sequence[tuple[str, str]]

# The groups of options (folders of conf/) to which installed packages add, and the entry points that do.
_ENTRY_POINTS: Mapping[str, str] = {
    "world": "dune_rl.worlds",
    "robot": "dune_rl.robots",
    "learning": "dune_rl.algorithms",
}
# Blanks on both sides of two columns.
_MARGINS = 8


@dataclass(frozen=True)
class HelpPage:
    """The text of `--help`: what the command does, how it is called, what can be set, and a closing note.

    With `options`, the groups of options of an environment are listed too.
    """

    title: str
    usage: HelpRows
    settings: HelpRows
    closing: str
    options: bool = True


def option_group_rows() -> list[tuple[str, str]]:
    """A row of help for each group of options, the world first; parts of installed packages among them."""
    rows = []
    for folder in sorted(path for path in conf_folder().iterdir() if path.is_dir()):
        if folder.name == "experiment":
            continue
        options = {path.stem for path in folder.glob("*.yaml")}
        if folder.name in _ENTRY_POINTS:
            options |= set(plugins.entry_points_by_name(_ENTRY_POINTS[folder.name]))
        name = "+world=NAME" if folder.name == "world" else f"{folder.name}=NAME"
        rows.append((name, ", ".join(sorted(options))))
    return sorted(rows, key=lambda row: not row[0].startswith("+"))


def show_help(page: HelpPage) -> None:
    """Print the page on standard output."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(highlight=False, soft_wrap=True)
    console.print(f"[bold]{page.title}[/bold]")
    for lines in (page.usage, [*(option_group_rows() if page.options else ()), *page.settings]):
        names, meanings = (max(map(len, column)) for column in zip(*lines, strict=True))
        if lines is page.usage and names + meanings + _MARGINS > console.width:
            # Beside commands, meanings would be columns of single words.
            console.print()
            for name, meaning in lines:
                console.print(f"  [cyan]{escape(name)}[/cyan]\n      {escape(meaning)}")
            continue
        table = Table(box=None, show_header=False, padding=(0, 2))
        table.add_column(style="cyan", no_wrap=True, min_width=names)
        table.add_column()
        for name, meaning in lines:
            table.add_row(escape(name), escape(meaning))
        console.print()
        console.print(table)
    console.print(f"\n{page.closing}", markup=False)
