"""The folder of a report: what may stand in its place."""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from dune_rl.core.replaced_folder import check_replaceable, replace_folder

PAGE, FIGURES, TABLES = "index.html", "figures", "tables"
# By folder, the endings of the files that a report has there.
SUFFIXES = {FIGURES: (".png", ".pdf"), TABLES: (".tex", ".md", ".csv")}


def why_no_folder(path: Path) -> str | None:
    """Why nothing can be read from `path`; None for a folder."""
    if not path.exists():
        return "there is no such folder"
    return None if path.is_dir() else "is a file; give the folder of a run or of an evaluation"


def check_folder(out: Path, *, overwrite: bool) -> None:
    """Raise ConfigError if `out` holds something that must stay; reports alone may be overwritten."""
    check_replaceable(out, "a report", _find_others, overwrite=overwrite)


def _find_others(out: Path) -> Iterator[Path]:
    yield from (each for each in out.iterdir() if each.name not in (FIGURES, TABLES, PAGE))
    for name, suffixes in SUFFIXES.items():
        if (out / name).is_dir():
            yield from (each for each in (out / name).iterdir() if each.suffix not in suffixes)


def replace_report(out: Path, *, overwrite: bool) -> AbstractContextManager[Path]:
    """An empty folder that takes the place of the report in `out`; see `replace_folder`."""
    return replace_folder(out, lambda: check_folder(out, overwrite=overwrite), last=PAGE)
