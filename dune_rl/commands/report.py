"""`python -m dune_rl.report`: read the folders, compute, draw, and write the report."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field, ValidationError

from dune_rl.commands import command_line
from dune_rl.core.errors import ConfigError
from dune_rl.core.paths import unused_folder
from dune_rl.core.settings import Settings
from dune_rl.core.suggestions import split_word
from dune_rl.reporting.folder import FIGURES, PAGE, TABLES, check_folder, replace_report, why_no_folder

# Everything else takes seconds to load: only when words and folders are right.
if TYPE_CHECKING:
    from rich.console import Console

    from dune_rl.reporting.inputs import Note, ReportInputs

_NAMES = 3
_NOTHING = "there is nothing to report; give folders that dune_rl.train or dune_rl.evaluate wrote"


class ReportConf(Settings):
    """Settings of a report."""

    out: str | None = Field(None, min_length=1)
    overwrite: bool = False
    title: str | None = Field(None, min_length=1)
    into: str | None = Field(None, min_length=1)
    failures: int = Field(12, ge=0, le=100)


def parse_words(words: Sequence[str]) -> tuple[list[Path], ReportConf]:
    """The folders and the settings among the words of a command line; `ConfigError` where they are not valid.

    A word with = is a setting, unless there is a folder of that name.
    """
    folders = [word for word in words if "=" not in word or Path(word).exists()]
    values = {key: text for key, _, text in (split_word(word) for word in words if word not in folders)}
    if "into" not in values and not folders:
        raise ConfigError("name the folders of runs or evaluations: python -m dune_rl.report runs/NAME")
    try:
        conf = ReportConf.model_validate(values)
    except ValidationError:
        # Only for its sentences: it takes a second to load.
        from dune_rl.config.checks import validate

        conf = validate(ReportConf, values)
    others = [*folders, *(key for key in values if key != "into")]
    if conf.into is not None and others:
        raise ConfigError(
            f"into={conf.into} writes the tables that the file itself asks for; leave {others[0]} out"
        )
    return [Path(word) for word in folders], conf


def run(words: Sequence[str]) -> None:
    """Make a report, or rewrite the tables of a Markdown file, as the command line says."""
    folders, conf = parse_words(command_line.parse_arguments(words).overrides)
    console = command_line.make_console()
    if conf.into is not None:
        if not Path(conf.into).exists():
            raise ConfigError(f"into={conf.into}: there is no such file")
        with _say_when_cut_off(console, f"{conf.into} is as it was"):
            _rewrite(Path(conf.into), console)
    else:
        make_report(folders, conf, console)


def _rewrite(file: Path, console: "Console") -> None:
    from dune_rl.reporting.markdown.file import rewrite_file

    rewritten = rewrite_file(file)
    _print_notes(rewritten.skipped, rewritten.notes)
    tables = "1 table" if rewritten.blocks == 1 else f"{rewritten.blocks} tables"
    command_line.print_line(console, f"{file}: {tables} written")


def make_report(folders: Sequence[Path], conf: ReportConf, console: "Console") -> Path:
    """Write the report of `folders`; returns its folder. Raises ConfigError if nothing there can be used."""
    now = datetime.now()
    out = Path(conf.out) if conf.out else default_folder(folders, now)
    check_folder(out, overwrite=conf.overwrite)
    reasons = [why_no_folder(folder) for folder in folders]
    if all(reasons):
        for folder, reason in zip(folders, reasons, strict=True):
            command_line.print_error(f"left out: {folder}: {reason}")
        raise ConfigError(_NOTHING)
    with _say_when_cut_off(
        console, f"the report in {out} {'is as it was' if out.exists() else 'was not written'}"
    ):
        from dune_rl.reporting.output import ReportProgress, write_report
        from dune_rl.reporting.page import figures_of, tables_of
        from dune_rl.reporting.reading import read_inputs
        from dune_rl.reporting.sections import collect_findings, lay_out

        with ReportProgress(console) as progress:
            inputs = read_inputs(folders, lambda path: progress.begin(f"reading {path.name}"))
        _print_notes(inputs.skipped, inputs.notes)
        if not inputs.usable:
            raise ConfigError(_NOTHING)
        title, date = conf.title or default_title(inputs), f"{now:%Y-%m-%d %H:%M}"
        with replace_report(out, overwrite=conf.overwrite) as folder, ReportProgress(console) as progress:
            progress.begin("statistics")
            sections = lay_out(collect_findings(inputs), conf.failures, progress)
            write_report(folder, title, describe_inputs(inputs), sections, date, progress)
    command_line.print_line(console, f"Report: {out / PAGE}")
    command_line.print_line(console, f"{len(figures_of(sections))} figures: {out / FIGURES}")
    command_line.print_line(console, f"{len(tables_of(sections))} tables: {out / TABLES}")
    return out


def _print_notes(skipped: Sequence["Note"], notes: Sequence["Note"]) -> None:
    from dune_rl.reporting.page import shown_path

    for kind, those in (("left out", skipped), ("note", notes)):
        for note in those:
            command_line.print_error(f"{kind}: {shown_path(note.path)}: {note.text}")


@contextmanager
def _say_when_cut_off(console: "Console", state: str) -> Iterator[None]:
    """Say in which `state` an interruption leaves the files."""
    try:
        yield
    except (KeyboardInterrupt, command_line.Terminated):
        command_line.print_line(console, f"Cut off: {state}")
        raise


def default_folder(folders: Sequence[Path], now: datetime) -> Path:
    """A folder that no other report has: reports/<date>_<names>."""
    names = [folder.resolve().name for folder in folders[:_NAMES]]
    if len(folders) > _NAMES:
        names.append(f"and_{len(folders) - _NAMES}_more")
    return unused_folder(Path("reports"), now, names)


def default_title(inputs: "ReportInputs") -> str:
    """The names of what is reported."""
    by_kind = (inputs.sweeps, inputs.evaluations, inputs.training)
    names = list(dict.fromkeys(one.name for kind in by_kind for one in kind))
    if len(names) > _NAMES:
        return f"{', '.join(names[: _NAMES - 1])} and {len(names) - _NAMES + 1} more"
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def describe_inputs(inputs: "ReportInputs") -> list[str]:
    """How much there is of what, in a sentence."""
    counts = (
        (len(inputs.evaluations), "evaluation"),
        (len(inputs.training), "training run"),
        (len(inputs.sweeps), "sweep"),
    )
    told = [f"{number} {name}{'' if number == 1 else 's'}" for number, name in counts if number]
    line = f"Of {', '.join(told)}."
    if inputs.skipped:
        line += f" {len(inputs.skipped)} of the inputs could not be used; see below."
    return [line]
