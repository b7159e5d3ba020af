"""`python -m dune_rl.report`: read the folders, compute, draw, and write the report."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from rich.console import Console

from dune_rl.commands import command_line
from dune_rl.core.errors import ConfigError
from dune_rl.core.paths import unused_folder
from dune_rl.reporting.drawing import DRAWN, plan_figures
from dune_rl.reporting.layout import collect_findings, describe_note, figures_of, lay_out, tables_of
from dune_rl.reporting.markdown_blocks import rewrite_file
from dune_rl.reporting.output import FIGURES, PAGE, TABLES, check_folder, write_aside, write_report
from dune_rl.reporting.page.render import FigureBlock, Section
from dune_rl.reporting.progress import ReportProgress, show_reading
from dune_rl.reporting.reading import read_inputs
from dune_rl.reporting.runs import Note, ReportInputs
from dune_rl.reporting.settings import ReportConf, parse_words

_NAMES = 3
# How long steps take, as the amounts of figures.
_STATISTICS, _WRITTEN = 6.0, 3.0


def run(words: Sequence[str]) -> None:
    """Make a report, or rewrite the tables of a Markdown file, as the command line says."""
    parsed = command_line.parse_arguments(words)
    folders, conf = parse_words(parsed.overrides)
    console = command_line.make_console()
    if conf.into is not None:
        with _say_when_cut_off(console, f"{conf.into} is as it was"):
            _rewrite(Path(conf.into), console)
    else:
        make_report(folders, conf, console)


def _rewrite(file: Path, console: Console) -> None:
    rewritten = rewrite_file(file)
    _print_notes("left out", rewritten.skipped)
    _print_notes("note", rewritten.notes)
    tables = "1 table" if rewritten.blocks == 1 else f"{rewritten.blocks} tables"
    console.print(f"{file}: {tables} written", highlight=False, markup=False, soft_wrap=True)


def make_report(folders: Sequence[Path], conf: ReportConf, console: Console) -> Path:
    """Write the report of `folders`; returns its folder. Raises ConfigError if nothing there can be used."""
    now = datetime.now()
    out = Path(conf.out) if conf.out else default_folder(folders, now)
    check_folder(out, overwrite=conf.overwrite)
    kept = "is as it was" if out.exists() else "was not written"
    with _say_when_cut_off(console, f"the report in {out} {kept}"):
        with show_reading(console) as show:
            inputs = read_inputs(folders, lambda path: show(path.name))
        _print_notes("left out", inputs.skipped)
        _print_notes("note", inputs.notes)
        if not inputs.usable:
            raise ConfigError(
                "there is nothing to report; give folders that dune_rl.train or dune_rl.evaluate wrote"
            )
        with write_aside(out, overwrite=conf.overwrite) as folder:
            sections = _write(folder, inputs, conf, now, console)
    console.print(
        f"Report: {out / PAGE}\n"
        f"{len(figures_of(sections))} figures: {out / FIGURES}\n"
        f"{len(tables_of(sections))} tables: {out / TABLES}",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )
    return out


def _write(
    folder: Path, inputs: ReportInputs, conf: ReportConf, now: datetime, console: Console
) -> list[Section]:
    findings = collect_findings(inputs)
    progress = ReportProgress(console)
    plans = plan_figures(findings, conf.failures, progress)
    statistics = _STATISTICS * len(findings.comparisons)
    progress.expect(statistics + sum(plan.amount + _WRITTEN for plan in plans))
    with progress:
        for comparison in findings.comparisons:
            progress.begin("statistics")
            # Computed once, and kept.
            _ = comparison.estimates, comparison.pairs
            progress.finish(_STATISTICS)
        figures: dict[str, list[FigureBlock]] = {}
        for number, plan in enumerate(plans, 1):
            progress.begin(f"drawing figure {number} of {len(plans)}")
            figures.setdefault(plan.section, []).append(plan.block())
            progress.finish(DRAWN)
        sections = lay_out(findings, figures)
        progress.begin("writing the report")
        write_report(
            folder,
            conf.title or default_title(inputs),
            describe_inputs(inputs),
            sections,
            f"{now:%Y-%m-%d %H:%M}",
            lambda: progress.finish(_WRITTEN),
        )
    return sections


def _print_notes(kind: str, notes: Sequence[Note]) -> None:
    for note in notes:
        command_line.print_error(f"{kind}: {describe_note(note)}")


@contextmanager
def _say_when_cut_off(console: Console, state: str) -> Iterator[None]:
    """Say in which `state` an interruption leaves the files."""
    try:
        yield
    except (KeyboardInterrupt, command_line.Terminated):
        console.print(f"Cut off: {state}", highlight=False, markup=False, soft_wrap=True)
        raise


def default_folder(folders: Sequence[Path], now: datetime) -> Path:
    """A folder that no other report has: reports/<date>_<names>."""
    names = [folder.resolve().name for folder in folders[:_NAMES]]
    if len(folders) > _NAMES:
        names.append(f"and_{len(folders) - _NAMES}_more")
    return unused_folder(Path("reports"), now, names)


def default_title(inputs: ReportInputs) -> str:
    by_kind = (inputs.sweeps, inputs.evaluations, inputs.training)
    names = list(dict.fromkeys(one.name for kind in by_kind for one in kind))
    if len(names) > _NAMES:
        return f"{', '.join(names[: _NAMES - 1])} and {len(names) - _NAMES + 1} more"
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def describe_inputs(inputs: ReportInputs) -> list[str]:
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
