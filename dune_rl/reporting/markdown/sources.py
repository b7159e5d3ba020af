"""The methods that a block of a Markdown file names, and its table as Markdown."""

from collections.abc import Sequence
from pathlib import Path

from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.core.untrusted_files import printable
from dune_rl.metrics.catalogue import measure_of
from dune_rl.reporting.collect import collect_comparisons
from dune_rl.reporting.comparison import EvaluatedPolicy
from dune_rl.reporting.inputs import Note, ReportInputs
from dune_rl.reporting.reading import read_inputs
from dune_rl.reporting.tables.table import Cell, Table, to_markdown


class SourceConf(Settings):
    """A method's episodes: of a folder, and of one of its policies where it has several."""

    folder: str
    policy: str | None = None


class BlockSources:
    """The folders that a Markdown file names, relative to its folder `beside`; each is read once.

    `skipped` and `notes` are what a reader must know of those that were read.
    """

    def __init__(self, beside: Path) -> None:
        self.beside = beside
        self.skipped: list[Note] = []
        self.notes: list[Note] = []
        self._read: dict[Path, ReportInputs] = {}

    def find_method(self, source: str | SourceConf) -> EvaluatedPolicy:
        """The episodes of a source; raises ConfigError unless there is exactly one method."""
        conf = SourceConf(folder=source) if isinstance(source, str) else source
        inputs = self._inputs(self.beside / conf.folder)
        methods = [
            method
            for comparison in collect_comparisons(inputs.evaluations)
            for method in comparison.methods
            if conf.policy in (None, method.policy)
        ]
        if len(methods) == 1:
            return methods[0]
        if not methods:
            reason = f": {inputs.skipped[0].text}" if inputs.skipped else ""
            raise ConfigError(f"{conf.folder} has no episodes of {conf.policy or 'a policy'}{reason}")
        policies = ", ".join(dict.fromkeys(method.policy for method in methods))
        raise ConfigError(f"{conf.folder} has several methods ({policies}); name one folder and policy")

    def _inputs(self, folder: Path) -> ReportInputs:
        if folder not in self._read:
            # A page may come from somebody else.
            roots = self.beside.resolve(), Path.cwd()
            if not any(folder.resolve().is_relative_to(root) for root in roots):
                raise ConfigError(
                    f"{printable(str(folder))} is neither below the page's folder nor below this; run the "
                    "command in a folder above both"
                )
            self._read[folder] = found = read_inputs([folder])
            # Folders may lie in each other.
            self.skipped += [note for note in found.skipped if note not in self.skipped]
            self.notes += [note for note in found.notes if note not in self.notes]
        return self._read[folder]


def markdown_table(lines: Sequence[Sequence[str]]) -> str:
    """A table from its lines, whose texts are Markdown of the file's author."""
    header, *rows = lines
    return to_markdown(Table("", "", "", header, [list(map(Cell, row)) for row in rows], []), escape=False)


def percent_of(name: str) -> str:
    return " %" if measure_of(name).unit == "%" else ""
