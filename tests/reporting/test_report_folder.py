"""A report's folder: whole or not there, by one process at a time."""

import signal
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import pytest
from report_runs import episode_rows, write_evaluation

from dune_rl import report
from dune_rl.commands import command_line
from dune_rl.core import replaced_folder
from dune_rl.core.errors import ConfigError
from dune_rl.core.paths import unused_folder
from dune_rl.reporting import output
from dune_rl.reporting.folder import check_folder, replace_report


def write_files(folder: Path, text: str) -> None:
    """What a report has, in small."""
    for name in ("figures", "tables"):
        (folder / name).mkdir()
    (folder / "tables" / f"{text}.csv").write_text(text)
    (folder / "index.html").write_text(text)


def files(folder: Path) -> list[str]:
    """All files and folders in a folder."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_a_report_is_there_when_it_is_complete(tmp_path: Path) -> None:
    out = tmp_path / "reports" / "r"
    with replace_report(out, overwrite=False) as aside:
        write_files(aside, "a")
        assert not out.exists() and aside.is_relative_to(out.parent)
    assert files(tmp_path / "reports") == ["r", "r/figures", "r/index.html", "r/tables", "r/tables/a.csv"]
    with pytest.raises(ConfigError, match="overwrite=true"), replace_report(out, overwrite=False):
        pass
    with replace_report(out, overwrite=True) as aside:
        write_files(aside, "b")
        assert (out / "index.html").read_text() == "a"
    assert files(tmp_path / "reports") == ["r", "r/figures", "r/index.html", "r/tables", "r/tables/b.csv"]


def test_the_folder_itself_stays_where_it_is_there_already(tmp_path: Path) -> None:
    (tmp_path / "target").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "target")
    before = (tmp_path / "target").stat().st_ino
    with replace_report(tmp_path / "link", overwrite=False) as aside:
        write_files(aside, "a")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "target").stat().st_ino == before
    assert (tmp_path / "target" / "index.html").read_text() == "a"


@pytest.mark.parametrize("error", [KeyboardInterrupt, command_line.Terminated, OSError])
def test_nothing_is_left_of_what_is_cut_off(error: type[BaseException], tmp_path: Path) -> None:
    with pytest.raises(error), replace_report(tmp_path / "new" / "r", overwrite=False) as aside:
        write_files(aside, "a")
        raise error
    assert files(tmp_path) == []


def test_the_old_report_comes_back_if_the_new_one_cannot_be_put_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with replace_report(tmp_path / "r", overwrite=False) as aside:
        write_files(aside, "a")
    before = files(tmp_path)
    move = replaced_folder.shutil.move

    def fail(source: Path, target: Path) -> None:
        if source.name == "index.html" and source.parent.name == "new":
            raise OSError("full")
        move(source, target)

    monkeypatch.setattr(replaced_folder.shutil, "move", fail)
    with pytest.raises(OSError, match="full"), replace_report(tmp_path / "r", overwrite=True) as aside:
        write_files(aside, "b")
    assert files(tmp_path) == before and (tmp_path / "r" / "index.html").read_text() == "a"


def test_one_process_at_a_time_writes_to_a_folder(tmp_path: Path) -> None:
    with replace_report(tmp_path / "r", overwrite=False) as aside:
        with (
            pytest.raises(ConfigError, match=r"another process is writing to .*r; choose another"),
            replace_report(tmp_path / "r", overwrite=True),
        ):
            pass
        with replace_report(tmp_path / "other", overwrite=False) as other:
            write_files(other, "b")
        write_files(aside, "a")
    assert (tmp_path / "r" / "index.html").read_text() == "a"


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    left = tmp_path / ".r.part" / "new"
    left.mkdir(parents=True)
    (left / "half.png").write_text("half")
    with replace_report(tmp_path / "r", overwrite=False) as aside:
        write_files(aside, "a")
    assert files(tmp_path) == ["r", "r/figures", "r/index.html", "r/tables", "r/tables/a.csv"]


# A process that is killed before it moves one entry more than so many.
KILLED = """
import os, shutil, sys
from pathlib import Path
from dune_rl.reporting.folder import check_folder, replace_report

moves, move = 0, shutil.move

def move_or_die(source, target):
    global moves
    if moves == int(sys.argv[2]):
        os._exit(9)
    moves += 1
    move(source, target)

shutil.move = move_or_die
with replace_report(Path(sys.argv[1]), overwrite=True) as aside:
    (aside / "figures").mkdir()
    (aside / "tables").mkdir()
    (aside / "tables" / "b.csv").write_text("b")
    (aside / "index.html").write_text("b")
"""


@pytest.mark.parametrize("moves", range(7))
def test_a_kill_while_a_report_is_put_in_place_leaves_the_old_or_the_new_one(
    moves: int, tmp_path: Path
) -> None:
    with replace_report(tmp_path / "r", overwrite=False) as aside:
        write_files(aside, "a")
    command = [sys.executable, "-c", KILLED, str(tmp_path / "r"), str(moves)]
    ended = subprocess.run(command)
    assert ended.returncode == (9 if moves < 6 else 0)
    with pytest.raises(ConfigError, match="holds a report already"):
        check_folder(tmp_path / "r", overwrite=False)
    whole = "a" if moves < 3 else "b"
    assert files(tmp_path) == ["r", "r/figures", "r/index.html", "r/tables", f"r/tables/{whole}.csv"]
    assert (tmp_path / "r" / "index.html").read_text() == whole


@pytest.mark.slow
@pytest.mark.parametrize("old", [False, True])
def test_an_interrupted_command_says_that_nothing_has_changed(
    old: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_evaluation(tmp_path / "a", episode_rows("x", 2, share=1.0))
    if old:
        (tmp_path / "r").mkdir()
        write_files(tmp_path / "r", "old")
    before = files(tmp_path)

    def interrupt(*_: object) -> str:
        # All but the page is written.
        assert list((tmp_path / ".r.part").rglob("*.png"))
        raise KeyboardInterrupt

    monkeypatch.setattr(output, "render_page", interrupt)
    monkeypatch.setattr(sys, "argv", ["report", "a", "out=r", "overwrite=true"])
    with pytest.raises(SystemExit) as ended:
        report.main()
    assert ended.value.code == 128 + signal.SIGINT
    state = "is as it was" if old else "was not written"
    assert capsys.readouterr().out == f"Cut off: the report in r {state}\n"
    assert files(tmp_path) == before


def test_a_folder_of_results_has_date_and_names_and_is_not_there_yet(tmp_path: Path) -> None:
    now = datetime(2026, 1, 2, 3, 4, 5)
    first = unused_folder(tmp_path, now, ["a b", "é/../c"])
    assert first == tmp_path / "2026-01-02_03-04-05_a_b_c"
    for number in (2, 3):
        first.parent.joinpath(first.name if number == 2 else f"{first.name}_2").mkdir()
        assert unused_folder(tmp_path, now, ["a b", "é/../c"]) == tmp_path / f"{first.name}_{number}"
    assert len(unused_folder(tmp_path, now, ["x" * 300] * 9).name) <= 120
