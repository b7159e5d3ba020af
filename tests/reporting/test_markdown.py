"""Tables in Markdown files: those of this repository are what the command makes of its committed files."""

import math
import re
import sys
from pathlib import Path

import pytest
from documents import ROOT
from report_runs import episode_rows, write_evaluation

from dune_rl import report
from dune_rl.core.errors import ConfigError
from dune_rl.reporting.markdown.file import rewrite_file, rewrite_text

FILES = sorted(
    file
    for file in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "experiments").rglob("*.md"))
    if "\n<!-- report: " in file.read_text(encoding="utf-8")
)
TABLE = "<!-- report: table\nmethods:\n  ours: {folder: a, policy: x}\nmeasures: [SR, TC]\n-->\n"
END = "<!-- end report -->"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A Markdown file beside an evaluation of two policies: x succeeds in 3 of 4 episodes."""
    write_evaluation(tmp_path / "a", [*episode_rows("x", 4, share=0.75), *episode_rows("y", 4, share=0.25)])
    return tmp_path / "page.md"


@pytest.mark.slow
@pytest.mark.parametrize("committed", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_tables_of_the_repository_are_those_of_its_files(committed: Path) -> None:
    text = committed.read_text(encoding="utf-8")
    made = rewrite_text(text, committed)
    assert made.text == text, f"run: python -m dune_rl.report into={committed.relative_to(ROOT)}"
    assert made.blocks or "```" in text


def test_the_headline_and_the_studies_have_tables_that_are_made() -> None:
    names = {str(file.relative_to(ROOT)) for file in FILES}
    assert {"README.md", "experiments/flat/README.md", "experiments/inspection/README.md"} <= names


def test_a_block_is_rewritten_and_the_rest_stays(file: Path) -> None:
    file.write_text(f"before\n\n{TABLE}old\n{END}\nbetween\n\n{TABLE}{END} after\n")
    assert rewrite_file(file).blocks == 2
    # One collision: Garwood's interval of 0.0253 to 5.572, by four episodes.
    lines = ("|  | SR | TC |", "|---|---:|---:|", "| ours | 75.0 % (30.1 to 95.4) | 0.25 (0.01 to 1.39) |")
    made = TABLE + "".join(f"{line}\n" for line in lines) + END
    assert file.read_text() == f"before\n\n{made}\nbetween\n\n{made} after\n"
    written = file.stat().st_mtime_ns
    rewrite_file(file)
    # What is right already is left alone.
    assert file.stat().st_mtime_ns == written


def write_runs(folder: Path, protocol: str, measures: dict[str, tuple[float, float, float]]) -> None:
    """An evaluation by a protocol, as far as its summary is concerned."""
    folder.mkdir()
    (folder / "config.yaml").write_text(f"protocol: {protocol}\n")
    lines = [f"x,rover,{name},{value},{low},{high},10,10," for name, (value, low, high) in measures.items()]
    header = "policy,group,measure,value,low,high,count,units,note"
    (folder / "summary.csv").write_text("\n".join([header, *lines]) + "\n")


def test_protocols_stand_side_by_side_beside_table_3(file: Path) -> None:
    here = {"SR/run": (0.9, 0.8, 0.95), "TC/run": (7.0, 5.0, 9.0), "SR": (0.5, 0.4, 0.6)}
    write_runs(file.parent / "ours", "paper", here)
    write_runs(
        file.parent / "code", "dune_code", {"code SR": (1.0, math.nan, math.nan), "SR/run": here["SR"]}
    )
    begin = "<!-- report: protocols\nworld: inspection\nmeasures: [SR, TC]\n"
    block = f"{begin}columns: {{by the paper: ours, by its code: code}}\n-->\n"
    file.write_text(block + END)
    rewrite_file(file)
    lines = (
        "|  | by the paper | by its code | DUnE paper |",
        "|---|---:|---:|---:|",
        "| SR | 90.0 % (80.0 to 95.0) | 100.0 % | 75 % |",
        "| TC | 7.00 (5.00 to 9.00) |  | 52 |",
    )
    assert file.read_text() == block + "".join(f"{line}\n" for line in lines) + END


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ("columns: {X: a}\nmeasures: [SR]", "a was made with protocol=None, not with paper or dune_code"),
        ("columns: {X: none}\nmeasures: [SR]", "there is no folder none"),
        ("columns: {X: runs}\nmeasures: [OC]", "no folder has the measure OC; they have SR"),
        ("columns: {X: runs}\nmeasures: [SR]\nworld: rubicon", "has no rubicon; it has flat, inspection"),
        ("columns: {X: runs}\nmeasures: [SR]\ndecimals: {TC: 1}", "decimals: TC is none of the measures"),
        ("columns: {X: {folder: runs, policy: y}}\nmeasures: [SR]", "summary.csv has no rows of y"),
        ("columns: {X: empty}\nmeasures: [SR]", "empty has no summary.csv"),
        ("columns: {X: short}\nmeasures: [SR]", "short/summary.csv lacks the column low"),
        ("columns: {X: two}\nmeasures: [SR]", r"two has several policies \(x, other\); name one"),
    ],
)
def test_wrong_protocols_are_named(file: Path, settings: str, message: str) -> None:
    for name in ("runs", "empty", "short", "two"):
        write_runs(file.parent / name, "paper", {"SR/run": (0.9, 0.8, 0.95)})
    (file.parent / "empty" / "summary.csv").unlink()
    (file.parent / "short" / "summary.csv").write_text("policy,group,measure,value\nx,rover,SR/run,0.9\n")
    with (file.parent / "two" / "summary.csv").open("a") as summary:
        summary.write("other,rover,SR/run,0.2,0.1,0.3,10,10,\n")
    file.write_text(f"<!-- report: protocols\n{settings}\n-->\n{END}")
    with pytest.raises(ConfigError, match=message):
        rewrite_file(file)


def test_a_grid_has_a_row_for_each_set(file: Path) -> None:
    write_evaluation(file.parent / "b", episode_rows("x", 4, share=0.5))
    begin = "<!-- report: grid\nmeasure: SR\nrows: [a, b, c]\n"
    columns = "columns:\n  X: {folder: '{row}', policy: x}\n  Y: {folder: 'other_{row}', policy: y}\n-->\n"
    file.write_text(f"{begin}{columns}{END}\n")
    with_gaps = "| b | 50.0 % (15.0 to 85.0) | not run |"
    rewrite_file(file)
    lines = file.read_text().splitlines()
    assert lines[7:-1] == [
        "| set | X | Y |",
        "|---|---:|---:|",
        "| a | 75.0 % (30.1 to 95.4) | not run |",
        with_gaps,
        "| c | not run | not run |",
    ]


def test_a_grid_has_columns_of_differences(file: Path) -> None:
    write_evaluation(file.parent / "b", [*episode_rows("x", 4, share=0.5), *episode_rows("y", 4, share=0.5)])
    begin = "<!-- report: grid\nmeasure: SR\nrows: [a, b, c]\ndecimals: 1\n"
    columns = "columns:\n  X: {folder: '{row}', policy: x}\n  Y: {folder: '{row}', policy: y}\n"
    file.write_text(f"{begin}{columns}differences: {{X - Y: [X, Y]}}\n-->\n{END}\n")
    rewrite_file(file)
    lines = file.read_text().splitlines()
    assert lines[9:11] == ["| set | X | Y | X - Y |", "|---|---:|---:|---:|"]
    # x alone succeeds in two of the four: p = 2 / 2^2, times two for the two sets.
    assert lines[11].startswith("| a | 75.0 % (30.1 to 95.4) | 25.0 % (4.6 to 69.9) | +50.0 (")
    assert lines[11].endswith("), p = 1 |")
    assert "| 0.0 (" in lines[12] and lines[13] == "| c | not run | not run | not run |"
    for pair, words in (("[X, Z]", "there is no column Z"), ("[X, Z, Y]", "differences")):
        with pytest.raises(ConfigError, match=words):
            rewrite_text(f"{begin}{columns}differences: {{d: {pair}}}\n-->\n{END}\n", file)


def test_a_grid_has_the_mean_over_seeds(file: Path) -> None:
    """That of seed 1 succeeds in the first three of four episodes, of seed 2 in the first, and z in all."""
    write_evaluation(file.parent / "a_1", episode_rows("x_1", 4, share=0.75))
    write_evaluation(file.parent / "a_2", episode_rows("x_2", 4, share=0.25))
    write_evaluation(file.parent / "b", episode_rows("z", 4, share=1.0))
    columns = "columns:\n  seeds: {folder: '{row}_{seed}', policy: 'x_{seed}'}\n"
    begin = "<!-- report: grid\nmeasure: SR\nrows: [a]\ndecimals: 1\nseeds: [1, 2]\n"
    other = "  Z: {folder: b, policy: z}\ndifferences: {seeds - Z: [seeds, Z]}\n-->\n"
    file.write_text(f"{begin}{columns}{other}{END}\n")
    rewrite_file(file)
    row = file.read_text().splitlines()[-2]
    # Wilson's interval of 2 in 4, and exchanges of three episodes that differ: 2 of 8.
    assert row.startswith("| a | 50.0 % (15.0 to 85.0); 75.0, 25.0 | 100.0 % (51.0 to 100.0) | ")
    # As of single runs that differ so, the interval of differences reaches beyond 0.
    assert "\N{MINUS SIGN}50.0 (" in row and "to +" in row and row.endswith("), p = 0.25 |")
    write_evaluation(file.parent / "a_3", episode_rows("x_3", 3, share=1.0))
    for seeds, words in (
        ("[1, 3]", "the seeds of seeds, a: they ran different episodes"),
        ("[1, 4]", "a_4 is not there, though that of another seed is"),
        ("[1, 1]", "needs different seeds"),
        ("[]", "needs different seeds"),
    ):
        with pytest.raises(ConfigError, match=words):
            rewrite_text(f"{begin.replace('[1, 2]', seeds)}{columns}-->\n{END}\n", file)
    with pytest.raises(ConfigError, match="no column has"):
        rewrite_text(f"{begin}{columns.replace('_{seed}', '_1')}-->\n{END}\n", file)


def test_a_grid_has_a_row_for_each_policy(file: Path) -> None:
    write_evaluation(file.parent / "b", [*episode_rows("x", 4, share=0.5), *episode_rows("y", 4, share=0.25)])
    file.write_text(
        "<!-- report: grid\nmeasure: SR\ncorner: robot\nrows: [x, y]\ndecimals: 1\n"
        "columns:\n  A: {folder: a, policy: '{row}'}\n  B: {folder: b, policy: '{row}'}\n"
        f"differences: {{B - A: [B, A]}}\n-->\n{END}\n"
    )
    rewrite_file(file)
    header, _, first, second = file.read_text().splitlines()[10:-1]
    assert header == "| robot | A | B | B - A |"
    assert first.startswith("| x | 75.0 % (30.1 to 95.4) | 50.0 % (15.0 to 85.0) | \N{MINUS SIGN}25.0 (")
    assert second.startswith("| y | 25.0 % (4.6 to 69.9) | 25.0 % (4.6 to 69.9) | 0.0 (")


def test_a_measure_without_a_value_is_a_dash(file: Path) -> None:
    rows = [*episode_rows("x", 4, share=1.0, time_to_goal=3.0), *episode_rows("y", 4, share=0.0)]
    write_evaluation(file.parent / "d", rows)
    table = "<!-- report: table\nmethods:\n  X: {folder: d, policy: x}\n  Y: {folder: d, policy: y}\n"
    file.write_text(f"{table}measures: [MTT]\nintervals: false\n-->\n{END}\n")
    rewrite_file(file)
    assert file.read_text().splitlines()[-3:-1] == ["| X | 3.00 |", "| Y | \N{EN DASH} |"]
    with pytest.raises(ConfigError, match=r"has no measure MTTT; did you mean MTT\?"):
        rewrite_text(f"{table}measures: [MTTT]\n-->\n{END}\n", file)


@pytest.mark.parametrize(
    ("measure", "folder", "policy", "words"),
    [("SR", "nowhere", "x", "no folder"), ("SR", "{row}", "z", "z"), ("SRR", "{row}", "x", "SRR")],
)
def test_a_grid_that_cannot_be_made_says_why(
    file: Path, measure: str, folder: str, policy: str, words: str
) -> None:
    columns = f"columns:\n  X: {{folder: '{folder}', policy: {policy}}}\n"
    text = f"<!-- report: grid\nmeasure: {measure}\nrows: [a]\n{columns}-->\n{END}\n"
    with pytest.raises(ConfigError, match=words):
        rewrite_text(text, file)


def test_rows_labels_digits_several_sources_and_the_paper(file: Path) -> None:
    file.write_text(
        "<!-- report: table\n"
        "methods:\n  both: [{folder: a, policy: x}, {folder: a, policy: y}]\n"
        "  '`y`': {folder: a, policy: y}\n"
        "measures: [SR, TC, episodes]\nlabels: {TC: collisions}\ndecimals: {SR: 2}\nrows: measures\n"
        f"paper: inspection\nintervals: false\n-->\n{END}\n"
    )
    rewrite_file(file)
    assert file.read_text().splitlines()[11:-1] == [
        "|  | both | `y` | DUnE paper |",
        "|---|---:|---:|---:|",
        "| SR | 75.00, 25.00 % | 25.00 % | 75 % |",
        "| collisions | 0.25, 0.75 | 0.75 | 52 in all |",
        "| episodes | 4, 4 | 4 |  |",
    ]


def test_several_sources_have_their_mean_with_its_interval_and_each_figure(file: Path) -> None:
    file.write_text(
        "<!-- report: table\n"
        "methods:\n  both: [{folder: a, policy: x}, {folder: a, policy: y}]\n"
        f"measures: [SR, episodes]\n-->\n{END}\n"
    )
    rewrite_file(file)
    row = file.read_text().splitlines()[-2]
    assert re.fullmatch(r"\| both \| 50\.0 % \([\d.]+ to [\d.]+\); 75\.0, 25\.0 \| 4, 4 \|", row)


def test_a_pair_is_a_sentence(file: Path) -> None:
    pair = "<!-- report: pair\nfirst: {folder: a, policy: x}\nsecond: {folder: a, policy: y}\n-->\n"
    file.write_text(f"{pair}{END}\n")
    rewrite_file(file)
    # x alone succeeds in two of the four: p = 2 / 2^2.
    assert (
        "Of 4 episodes, `x` alone succeeds in 2, `y` alone in 0: exact McNemar test, p = 0.5.\n"
        in file.read_text()
    )


def test_blocks_that_a_page_shows_as_code_stay(file: Path) -> None:
    shown = f"```markdown\n{TABLE}{END}\n```\n"
    found = rewrite_text(shown, file)
    assert (found.text, found.blocks) == (shown, 0)


def test_line_endings_stay_as_they_are(file: Path) -> None:
    text = f"before\n\n{TABLE}old\n{END}\nafter\n"
    file.write_bytes(text.replace("\n", "\r\n").encode())
    assert rewrite_file(file).blocks == 1
    windows = file.read_bytes()
    file.write_bytes(text.encode())
    rewrite_file(file)
    assert b"75.0 %" in windows and windows == file.read_bytes().replace(b"\n", b"\r\n")
    fenced = f"```markdown\n{TABLE}{END}\n```\n".replace("\n", "\r\n")
    assert rewrite_text(fenced, file).blocks == 0


def test_what_is_to_be_known_of_the_sources_is_told_once(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_evaluation(file.parent / "b", episode_rows("x", 4), packages={"dune_rl": "0.0.1"})
    write_evaluation(file.parent / "b" / "half", episode_rows("x", 4), complete=False)
    (file.parent / "a" / "provenance.json").unlink()
    of_b = TABLE.replace("folder: a", "folder: b")
    file.write_text(f"{TABLE}{END}\n{TABLE}{END}\n{of_b}{END}\n")
    monkeypatch.setattr(sys, "argv", ["report", f"into={file}"])
    with pytest.raises(SystemExit) as ended:
        report.main()
    told = capsys.readouterr()
    assert ended.value.code == 0 and "3 tables written" in told.out
    assert told.err.count("has no provenance.json: nothing says by which command") == 1
    assert told.err.count("was made with dune_rl 0.0.1") == 1
    assert told.err.count("left out: ") == 1 and "was cut off" in told.err


def test_frames_that_are_not_known_are_named(file: Path) -> None:
    table = TABLE.replace("[SR, TC]", "[frames]")
    for text in ("kind,SR\neval,0.5\n", "kind,frames\neval,10\neval,\n", "kind,frames\n"):
        (file.parent / "a" / "metrics.csv").write_text(text)
        with pytest.raises(ConfigError, match=r"metrics\.csv.* frames"):
            rewrite_text(f"{table}{END}\n", file)
    (file.parent / "a" / "metrics.csv").write_text("kind,frames\neval,10\neval,2000\n")
    assert "| ours | 2,000 |" in rewrite_text(f"{table}{END}\n", file).text


def test_numbers_are_written_as_in_reports(file: Path) -> None:
    rows = [{**row, "clearance": -0.0001 * row["episode"]} for row in episode_rows("x", 4)]
    write_evaluation(file.parent / "b", rows)
    table = TABLE.replace("folder: a", "folder: b").replace("[SR, TC]", "[OC]")
    rewritten = rewrite_text(f"{table}{END}\n", file).text
    # No minus before a zero that rounding made.
    assert "| ours | 0.00 (0.00 to 0.00) |" in rewritten


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no block\n", "has no block"),
        (TABLE, "has no <!-- end report -->"),
        (f"{TABLE}{TABLE}{END}\n", "has no <!-- end report -->"),
        (f"<!-- report: chart\n-->\n{END}\n", "there is no block 'chart'"),
        (f"<!-- report: table\nmethods: [\n-->\n{END}\n", "is not YAML"),
        (f"<!-- report: table\nmethods: {{o: a}}\n-->\n{END}\n", "measures: Field required"),
        (TABLE.replace("SR", "SRX") + f"{END}\n", "has no measure SRX"),
        (
            TABLE.replace("folder: a", "folder: b") + f"{END}\n",
            "b has no episodes of x: there is no such folder",
        ),
        (TABLE.replace(", policy: x", "") + f"{END}\n", "several methods (x, y)"),
        (TABLE.replace("measures", "paper: mars\nmeasures") + f"{END}\n", "the paper has no figures of mars"),
    ],
)
def test_blocks_that_cannot_be_made_change_nothing(text: str, message: str, file: Path) -> None:
    file.write_text(text)
    with pytest.raises(ConfigError) as raised:
        rewrite_file(file)
    assert message in str(raised.value) and str(file) in str(raised.value)
    assert file.read_text() == text
