"""The tables of the pages on reliability and scaling are those of their CSV files."""

import importlib.util
from pathlib import Path

import pytest

STUDIES = Path(__file__).parents[2] / "experiments"


@pytest.mark.parametrize(
    ("page", "table"),
    [
        ("reliability/determinism", "determinism"),
        ("reliability/evaluations", "evaluations"),
        ("reliability/soak", "soak"),
        ("reliability/soak", "rounds"),
        ("reliability/faults", "kills"),
        ("reliability/faults", "faults"),
        ("reliability/strangers", "strangers"),
        ("scaling/README", "scaling"),
        ("datasets/README", "datasets"),
    ],
)
def test_the_page_has_the_table_of_its_rows(page: str, table: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = (STUDIES / page).parent
    monkeypatch.syspath_prepend(folder)
    spec = importlib.util.spec_from_file_location(f"tables_of_{folder.name}", folder / "tables.py")
    assert spec is not None and spec.loader is not None
    tables = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tables)
    text = getattr(tables, f"{table}_table")(folder)
    assert len(text.splitlines()) > 2 and text in (STUDIES / f"{page}.md").read_text()
