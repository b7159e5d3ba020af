"""Lays out a report: which tables and figures there are, in which section."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from dune_rl.core.paths import file_stem
from dune_rl.reporting.comparisons.collect import collect_comparisons
from dune_rl.reporting.comparisons.comparison import Comparison
from dune_rl.reporting.page.render import (
    Block,
    FigureBlock,
    HeadingBlock,
    Section,
    TableBlock,
    TextBlock,
    shown_path,
)
from dune_rl.reporting.runs import Note, ReportInputs
from dune_rl.reporting.tables.methods import (
    PAPER_MEASURES,
    all_measures_table,
    endings_table,
    main_table,
    overview_table,
    paired_table,
)
from dune_rl.reporting.tables.origin import cases_table, evaluations_table, training_origin_table
from dune_rl.reporting.tables.table import Table
from dune_rl.reporting.tables.training import sweep_table, training_table
from dune_rl.reporting.training_groups import TrainingGroup, group_runs


@dataclass
class Findings:
    """What the inputs give: comparisons of methods on the same cases, and groups of training runs."""

    inputs: ReportInputs
    comparisons: list[Comparison]
    groups: list[TrainingGroup]
    failures_left_out: list[str] = field(default_factory=list)

    def name(self, comparison: Comparison) -> str:
        """The stem of the files of a comparison."""
        number = self.comparisons.index(comparison) + 1
        return f"{number:02d}_{file_stem(comparison.cases.title)}"


def collect_findings(inputs: ReportInputs) -> Findings:
    """The comparisons and groups of the inputs."""
    return Findings(inputs, collect_comparisons(inputs.evaluations), group_runs(inputs.training))


def lay_out(findings: Findings, figures: dict[str, list[FigureBlock]]) -> list[Section]:
    """The sections of the page; `figures` are by the name of the section that they belong to."""
    sections = [
        Section("compared", "What was compared", _compared(findings)),
        Section("results", "Main comparison", _results(findings)),
        Section("pairs", "Methods in pairs", _pairs(findings)),
        Section("measures", "All measures", _measures(findings)),
        Section("training", "Training", _training(findings)),
        Section("distributions", "Distributions"),
        Section("difficulty", "Success against distance and slope"),
        Section("tracks", "Tracks"),
        Section("failures", "Failures", _failures(findings)),
        Section("aggregates", "Aggregates over sets"),
        Section("sweeps", "Sweeps", _sweeps(findings)),
    ]
    for section in sections:
        if section.name == "failures" and findings.failures_left_out:
            # Below the pictures of those that are shown.
            left = TextBlock("Not shown:", findings.failures_left_out)
            section.blocks += [*figures.pop("failures", []), left]
        section.blocks += figures.get(section.name, [])
    sections.append(Section("files", "Files", _files(sections)))
    return sections


def tables_of(sections: Iterable[Section]) -> list[Table]:
    """All tables of a page, in order."""
    return [block.table for section in sections for block in section.blocks if isinstance(block, TableBlock)]


def figures_of(sections: Iterable[Section]) -> list[FigureBlock]:
    """All figures of a page, in order."""
    return [block for section in sections for block in section.blocks if isinstance(block, FigureBlock)]


def _compared(findings: Findings) -> list[Block]:
    inputs, blocks = findings.inputs, list[Block]()
    for text, notes in (("Left out:", inputs.skipped), ("To be known:", inputs.notes)):
        if notes:
            blocks.append(TextBlock(text, [describe_note(note) for note in notes], warning=True))
    if findings.comparisons:
        blocks.append(TableBlock(cases_table(findings.comparisons)))
    if inputs.evaluations:
        blocks.append(TableBlock(evaluations_table(inputs.evaluations), folded=True))
    if findings.groups:
        blocks.append(TableBlock(training_origin_table(findings.groups)))
    return blocks


def describe_note(note: Note) -> str:
    """A note with the folder that it is about."""
    return f"{shown_path(note.path)}: {note.text}"


def _results(findings: Findings) -> list[Block]:
    blocks: list[Block] = []
    if len(findings.comparisons) > 1:
        for measure in ("SR", "TR"):
            if any(measure in found for each in findings.comparisons for found in each.estimates.values()):
                blocks.append(TableBlock(overview_table(findings.comparisons, measure)))
    for comparison in findings.comparisons:
        blocks.append(TableBlock(main_table(findings.name(comparison), comparison)))
        if comparison.notes:
            blocks.append(TextBlock("", comparison.notes, warning=True))
    return blocks


def _pairs(findings: Findings) -> list[Block]:
    blocks: list[Block] = []
    for comparison in findings.comparisons:
        shown = [one for one in comparison.pairs if one.measure.name in PAPER_MEASURES]
        others = [one for one in comparison.pairs if one.measure.name not in PAPER_MEASURES]
        name = findings.name(comparison)
        # Many pairs would push all else away.
        folded = len(findings.comparisons) > 1 or len(comparison.methods) > 2
        if shown:
            blocks.append(TableBlock(paired_table(name, comparison, shown), folded=folded))
        if others:
            table = paired_table(f"{name}_further", comparison, others, further=True)
            blocks.append(TableBlock(table, folded=True))
    return blocks


def _measures(findings: Findings) -> list[Block]:
    folded = len(findings.comparisons) > 1
    return [
        TableBlock(all_measures_table(findings.name(comparison), comparison), folded=folded)
        for comparison in findings.comparisons
    ]


def _failures(findings: Findings) -> list[Block]:
    if not findings.comparisons:
        return []
    blocks: list[Block] = [TableBlock(endings_table(findings.comparisons))]
    numbered = list(filter(None, dict.fromkeys(one.numbered for one in findings.comparisons)))
    if numbered:
        # Pictures have the numbers beside them, far from the main comparison.
        blocks.append(TextBlock("", numbered, warning=True))
    return blocks


def _training(findings: Findings) -> list[Block]:
    return [TableBlock(training_table(findings.groups))] if findings.groups else []


def _sweeps(findings: Findings) -> list[Block]:
    return [
        TableBlock(sweep_table(f"sweep_{number:02d}", sweep))
        for number, sweep in enumerate(findings.inputs.sweeps, 1)
    ]


def _files(sections: Sequence[Section]) -> list[Block]:
    """The names of the files in tables/ and figures/, beside the page, and what they show."""
    blocks: list[Block] = []
    tables, figures = tables_of(sections), figures_of(sections)
    if tables:
        blocks.append(HeadingBlock("Tables"))
        blocks.append(
            TextBlock(
                "Each in tables/ as .tex (booktabs), .md and .csv; the last has all digits.",
                [f"{table.name}: {table.title}" for table in tables],
            )
        )
    if figures:
        blocks.append(HeadingBlock("Figures"))
        blocks.append(
            TextBlock(
                "Each in figures/ as .png and .pdf.", [f"{figure.name}: {figure.title}" for figure in figures]
            )
        )
    return blocks
