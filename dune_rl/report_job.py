"""What `python -m dune_rl.report` does: read the folders, compute, draw, and write the report."""

import os
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from rich.console import Console

from dune_rl import command
from dune_rl.errors import ConfigError
from dune_rl.learning.run.progress import show_episodes
from dune_rl.reporting.drawing import FigurePlan, plan_figures
from dune_rl.reporting.layout import (
    Findings,
    collect_findings,
    compute_steps,
    describe_note,
    figures_of,
    file_stem,
    lay_out,
    tables_of,
)
from dune_rl.reporting.markdown_blocks import rewrite_file
from dune_rl.reporting.output import FIGURES, PAGE, TABLES, check_folder, write_report
from dune_rl.reporting.page.blocks import FigureBlock, Section
from dune_rl.reporting.reading import read_inputs
from dune_rl.reporting.runs import ReportInputs
from dune_rl.reporting.settings import ReportConf, parse_words

_NAMES = 3


def run(parsed: Namespace) -> None:
    """Make a report, or rewrite the tables of a Markdown file, as the command line says."""
    folders, conf = parse_words(parsed.overrides)
    console = command.make_console()
    if conf.into is not None:
        _rewrite(Path(conf.into), console)
    else:
        make_report(folders, conf, console)


def _rewrite(file: Path, console: Console) -> None:
    written = rewrite_file(file)
    console.print(
        f"{file}: {written} {'table' if written == 1 else 'tables'} written", highlight=False, soft_wrap=True
    )


def make_report(folders: Sequence[Path], conf: ReportConf, console: Console) -> Path:
    """Write the report of `folders`; returns its folder. Raises ConfigError if nothing there can be used."""
    now = datetime.now()
    out = Path(conf.out) if conf.out else default_folder(folders, now)
    check_folder(out, overwrite=conf.overwrite)
    with console.status("reading") if _shows(console) else _nothing() as status:
        inputs = read_inputs(folders, lambda path: status.update(f"reading {path.name}") if status else None)
    for note in (*inputs.skipped, *inputs.notes):
        command.print_error(f"{'left out' if note in inputs.skipped else 'note'}: {describe_note(note)}")
    if not inputs.usable:
        raise ConfigError(
            "there is nothing to report; give folders that dune_rl.train or dune_rl.evaluate wrote"
        )
    findings = collect_findings(inputs)
    title = conf.title or default_title(inputs)
    date = f"{now:%Y-%m-%d %H:%M}"
    sections = _compute(findings, plan_figures(findings, conf.failures), out, title, date, console)
    console.print(
        f"Report: {out / PAGE}\n"
        f"{len(figures_of(sections))} figures: {out / FIGURES}\n"
        f"{len(tables_of(sections))} tables: {out / TABLES}",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )
    return out


def _compute(
    findings: Findings, plans: Sequence[FigurePlan], out: Path, title: str, date: str, console: Console
) -> list[Section]:
    statistics = compute_steps(findings)
    # Each figure is drawn, and then written twice.
    total = len(statistics) + 2 * len(plans)
    done = 0
    with _progress(console, total) as show:

        def step() -> None:
            nonlocal done
            done += 1
            show(done)

        for compute in statistics:
            compute()
            step()
        figures: dict[str, list[FigureBlock]] = {}
        for plan in plans:
            figures.setdefault(plan.section, []).append(plan.block())
            step()
        sections = lay_out(findings, figures)
        write_report(out, title, describe_inputs(findings.inputs), sections, date, step)
    return sections


def default_folder(folders: Sequence[Path], now: datetime) -> Path:
    """A folder that no other report has: reports/<date>_<names>."""
    names = [file_stem(folder.resolve().name) for folder in folders[:_NAMES]]
    if len(folders) > _NAMES:
        names.append(f"and_{len(folders) - _NAMES}_more")
    stem = f"{now:%Y-%m-%d_%H-%M-%S}_{'_'.join(names)}"[:120]
    folder, number = Path("reports") / stem, 1
    while folder.exists():
        number += 1
        folder = Path("reports") / f"{stem}_{number}"
    return folder


def default_title(inputs: ReportInputs) -> str:
    """The names of what is reported."""
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


def _shows(console: Console) -> bool:
    return console.is_terminal and not os.environ.get("CI")


@contextmanager
def _progress(console: Console, total: int) -> Iterator[Callable[[int], None]]:
    """A bar on a terminal, and nothing elsewhere."""
    if not _shows(console):
        yield lambda done: None
        return
    with show_episodes(console, "report", total) as show:
        yield show


@contextmanager
def _nothing() -> Iterator[None]:
    yield None
