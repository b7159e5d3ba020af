"""`python -m dune_rl.report`: its folder, its page and its tables, also of odd input."""

import csv
import html.parser
import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from report_runs import episode_rows, write_evaluation, write_sweep, write_training

from dune_rl import report
from dune_rl.commands.pages import PAGES, show_help
from dune_rl.metrics.catalogue import MINUS, NOTHING
from dune_rl.reporting.collect import collect_comparisons
from dune_rl.reporting.figures.style import draw_legend, method_styles, new_figure
from dune_rl.reporting.reading import read_inputs
from dune_rl.reporting.tables.methods import paired_table
from dune_rl.reporting.tables.table import escape_latex, to_markdown

ODD = 'a<b>&"c" | $x_1$ {d} 100% [e](http://f)'
Call = Callable[..., int]


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Call:
    """Runs the command in an empty folder; the exit code."""
    monkeypatch.chdir(tmp_path)

    def run(*words: str) -> int:
        monkeypatch.setattr(sys, "argv", ["report", *words])
        with pytest.raises(SystemExit) as ended:
            report.main()
        return int(ended.value.code or 0)

    return run


class _Page(html.parser.HTMLParser):
    """The tags of a page with their attributes, the text, and whether every tag is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.slow
def test_a_report_of_all_kinds_of_folders(
    call: Call, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [*episode_rows("mine", 8, share=1.0), *episode_rows("go_to_goal", 8)]
    write_evaluation(tmp_path / "evaluation", rows)
    for seed in (1, 2):
        write_training(tmp_path / "runs" / f"seed{seed}", seed)
    write_sweep(tmp_path / "sweep", ["0.9", "0.99", "0.999"])
    assert call("evaluation", "runs", "sweep", "missing", "out=r", "title=My report") == 0
    told = capsys.readouterr()
    assert "left out: missing: there is no such folder" in told.err
    assert f"Report: {Path('r') / 'index.html'}" in told.out
    assert "%" not in told.out, "no progress in a pipe"
    page = _Page((tmp_path / "r" / "index.html").read_text(encoding="utf-8"))
    assert page.open == []
    for words in ("My report", "missing: there is no such folder", "VORT above", "5°", "DUnE paper"):
        assert words in page.text
    # The sweep: its parameter, and which job was best.
    assert "learning.gamma" in page.text and "62.0 (best)" in page.text
    stems = {path.stem for path in (tmp_path / "r" / "figures").iterdir()}
    for stem in stems:
        assert (tmp_path / "r" / "figures" / f"{stem}.png").read_bytes().startswith(b"\x89PNG")
        assert (tmp_path / "r" / "figures" / f"{stem}.pdf").read_bytes().startswith(b"%PDF")
    assert {path.suffix for path in (tmp_path / "r" / "tables").iterdir()} == {".tex", ".md", ".csv"}


@pytest.mark.slow
def test_the_page_needs_no_network_and_no_script(call: Call, tmp_path: Path) -> None:
    write_evaluation(tmp_path / "a", episode_rows("x", 3))
    assert call("a", "out=r") == 0
    page = _Page((tmp_path / "r" / "index.html").read_text(encoding="utf-8"))
    names = {name for name, _ in page.tags}
    assert not names & {"script", "link", "iframe", "object", "base"}
    for name, attributes in page.tags:
        for key in ("src", "href", "srcset", "action"):
            value = attributes.get(key)
            assert value is None or value.startswith(("data:image/png;base64,", "#")), (name, value)
    pictures = [attributes for name, attributes in page.tags if name == "img"]
    assert pictures and all(attributes.get("alt") for attributes in pictures)
    assert not re.search(r"url\(|@import", (tmp_path / "r" / "index.html").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_names_of_users_are_text_everywhere(call: Call, tmp_path: Path) -> None:
    folder = "odd <i>& folder'é"
    rows = [*episode_rows(ODD, 4, share=1.0), *episode_rows("y", 4)]
    write_evaluation(tmp_path / folder, rows)
    assert call(folder, "out=r", f"title={ODD}") == 0
    page = _Page((tmp_path / "r" / "index.html").read_text(encoding="utf-8"))
    assert {"b", "i"}.isdisjoint(name for name, _ in page.tags)
    assert ODD in page.text and folder in page.text
    (file,) = (tmp_path / "r" / "tables").glob("*_main.tex")
    latex = file.read_text(encoding="utf-8")
    assert r"a\textless{}b\textgreater{}\&" in latex and r"\$x\_1\$ \{d\} 100\%" in latex
    markdown = file.with_suffix(".md").read_text(encoding="utf-8")
    row = next(line for line in markdown.splitlines() if "100%" in line)
    assert row.startswith(r'| a\<b>&"c" \| $x_1$ {d} 100% [e]\(http://f) | ')
    with file.with_suffix(".csv").open(newline="", encoding="utf-8") as opened:
        assert ODD in {line["method"] for line in csv.DictReader(opened)}


@pytest.mark.slow
def test_names_that_look_like_formulae_are_drawn_as_they_read(call: Call, tmp_path: Path) -> None:
    rows = [*episode_rows(r"$\bad$", 4, share=1.0), *episode_rows("_y", 4)]
    write_evaluation(tmp_path / "a", rows)
    assert call("a", "out=r", r"title=$\frac$") == 0
    assert len(list((tmp_path / "r" / "figures").glob("*.pdf"))) > 4


def test_a_name_with_an_underscore_is_in_legends() -> None:
    figure = new_figure(3.0, 1.0)
    draw_legend(figure, method_styles(["_y", "x"]))
    assert [text.get_text().strip() for text in figure.legends[0].get_texts()] == ["_y", "x"]


@pytest.mark.parametrize(
    ("text", "latex"),
    [
        (r"<b>x&_%$\\", r"\textless{}b\textgreater{}x\&\_\%\$\textbackslash{}\textbackslash{}"),
        ("a--b 'c'' `` ?`", "a-{}-b 'c'{}' `{}` ?{}`"),
        (f"5° {MINUS} 3 {NOTHING} {{x}}", r"5$^\circ$ $-$ 3 -- \{x\}"),
    ],
)
def test_latex_shows_text_letter_by_letter(text: str, latex: str) -> None:
    assert escape_latex(text) == latex


def test_a_p_value_that_is_not_defined_is_a_dash_with_its_reason(tmp_path: Path) -> None:
    rows = [*episode_rows("x", 4, share=1.0), *episode_rows("y", 4, share=0.0)]
    # Each arrives where the other does not.
    for row in rows:
        row["time_to_goal"] = 3.0 if (row["policy"] == "x") == (row["episode"] < 2) else "nan"
    write_evaluation(tmp_path / "a", rows)
    (comparison,) = collect_comparisons(read_inputs([tmp_path / "a"]).evaluations)
    table = paired_table("t", comparison, comparison.pairs)
    row = next(cells for cells in table.rows if cells[0].text.startswith("MTT"))
    assert [cell.plain for cell in row[2:6]] == [NOTHING, "0", f"{NOTHING} (no pairs)", NOTHING]
    assert "no episode has a value of both" in table.caption
    assert "nan" not in to_markdown(table)


@pytest.mark.slow
def test_equal_input_gives_equal_bytes(call: Call, tmp_path: Path) -> None:
    write_evaluation(tmp_path / "a", [*episode_rows("x", 6), *episode_rows("y", 6, share=0.2)])
    write_training(tmp_path / "run", 1)
    for out in ("first", "second"):
        assert call("a", "run", f"out={out}", "title=T") == 0
    files = sorted(path.relative_to(tmp_path / "first") for path in (tmp_path / "first").rglob("*.*"))
    assert len(files) > 12
    for file in files:
        one, other = ((tmp_path / out / file).read_bytes() for out in ("first", "second"))
        if file.name == "index.html":
            one, other = (re.sub(rb"report, \d{4}-\d\d-\d\d \d\d:\d\d", b"", each) for each in (one, other))
        assert one == other, file


def test_tables_have_the_figures_of_the_episodes(call: Call, tmp_path: Path) -> None:
    rows = [*episode_rows("x", 10, share=0.7), *episode_rows("y", 10, share=0.2)]
    write_evaluation(tmp_path / "a", rows)
    assert call("a", "out=r") == 0
    (main,) = (tmp_path / "r" / "tables").glob("*_main.csv")
    with main.open(newline="") as opened:
        found = {(line["method"], line["measure"]): line for line in csv.DictReader(opened)}
    assert float(found["x", "SR"]["value"]) == pytest.approx(0.7)
    # Wilson's interval of 7 of 10.
    assert float(found["x", "SR"]["low"]) == pytest.approx(0.3968, abs=1e-4)
    assert float(found["x", "SR"]["high"]) == pytest.approx(0.8922, abs=1e-4)
    assert found["y", "MTT"]["count"] == "2"
    (pairs,) = (tmp_path / "r" / "tables").glob("*_pairs.csv")
    with pairs.open(newline="") as opened:
        success = next(line for line in csv.DictReader(opened) if line["measure"] == "SR")
    # x alone succeeds in 5 episodes and y alone in none: p = 2 / 2^5.
    assert float(success["difference"]) == pytest.approx(0.5)
    assert float(success["p"]) == pytest.approx(0.0625)
    assert float(success["effect"]) == pytest.approx(1.0)


@pytest.mark.slow
def test_one_episode_alone_has_no_intervals(call: Call, tmp_path: Path) -> None:
    write_evaluation(tmp_path / "a", [*episode_rows("x", 1), *episode_rows("y", 1, share=0.0)])
    assert call("a", "out=r") == 0
    text = (tmp_path / "r" / "index.html").read_text(encoding="utf-8")
    assert "x has one episode" in text and not re.search(r"\bnan\b", _Page(text).text)


def test_nothing_usable_is_an_error(call: Call, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    assert call("empty", "none", "out=r") == 2
    told = capsys.readouterr().err
    assert "empty: holds no run" in told and "there is nothing to report" in told
    assert not (tmp_path / "r").exists()


@pytest.mark.slow
def test_nothing_is_overwritten_unasked(
    call: Call, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_evaluation(tmp_path / "a", episode_rows("x", 3))
    assert call("a", "out=r") == 0
    page = tmp_path / "r" / "index.html"
    page.write_text("mine")
    assert call("a", "out=r") == 2
    assert "overwrite=true" in capsys.readouterr().err and page.read_text() == "mine"
    (tmp_path / "r" / "tables" / "old.csv").write_text("old")
    assert call("a", "out=r", "overwrite=true") == 0
    assert not (tmp_path / "r" / "tables" / "old.csv").exists()
    # A folder with anything else is not ours.
    for place in ("notes.txt", "figures/mine.svg"):
        (tmp_path / "r" / place).write_text("mine")
        assert call("a", "out=r", "overwrite=true") == 2
        assert (tmp_path / "r" / place).read_text() == "mine"
        (tmp_path / "r" / place).unlink()
    # The evaluation itself least of all.
    assert call("a", "out=a", "overwrite=true") == 2
    assert (tmp_path / "a" / "episodes.csv").exists()


@pytest.mark.slow
def test_without_out_each_report_has_a_folder(call: Call, tmp_path: Path) -> None:
    write_evaluation(tmp_path / "a=b", episode_rows("x", 3))
    assert call("a=b") == 0 == call("a=b")
    found = sorted((tmp_path / "reports").iterdir())
    assert len(found) == 2
    assert re.fullmatch(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d_a_b(_2)?", found[0].name)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "name the folders"),
        (["a", "ouy=r"], "ouy is not a setting; did you mean out?"),
        (["a", "overwrite=maybe"], "overwrite"),
        (["a", "into=README.md"], "leave a out"),
        (["into=none.md"], "into=none.md: there is no such file"),
        (["--fast"], "no flag --fast"),
    ],
)
def test_wrong_words_are_named(
    words: list[str], message: str, call: Call, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(*words) == 2
    assert message in capsys.readouterr().err


def test_help_lists_what_can_be_set(capsys: pytest.CaptureFixture[str]) -> None:
    show_help(PAGES["report"])
    text = capsys.readouterr().out
    assert "overwrite=true" in text and "+world=NAME" not in text
