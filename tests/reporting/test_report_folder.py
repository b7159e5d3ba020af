"""A report's folder: whole or not there, by one process at a time."""

import shutil
import signal
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import pytest
from report_runs import episode_rows, write_evaluation

from dune_rl import report
from dune_rl.commands import command_line
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
    rename = Path.rename

    def fail(source: Path, target: Path) -> None:
        if source.name == "index.html" and source.parent.name == "new":
            raise OSError("full")
        rename(source, target)

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(OSError, match="full"), replace_report(tmp_path / "r", overwrite=True) as aside:
        write_files(aside, "b")
    assert files(tmp_path) == before and (tmp_path / "r" / "index.html").read_text() == "a"


def test_what_cannot_be_removed_of_the_old_is_named_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with replace_report(tmp_path / "r", overwrite=False) as aside:
        write_files(aside, "a")

    def refuse(path: Path) -> None:
        raise PermissionError(13, "Permission denied", "a.csv")

    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", refuse)
        with replace_report(tmp_path / "r", overwrite=True) as aside:
            write_files(aside, "b")
        assert (tmp_path / "r" / "index.html").read_text() == "b"
        with (
            pytest.raises(ConfigError, match=r"r\.part/\w+ of an .* \(Permission denied\); remove it"),
            replace_report(tmp_path / "r", overwrite=True),
        ):
            pass
    with replace_report(tmp_path / "r", overwrite=True) as aside:
        write_files(aside, "c")
    assert files(tmp_path) == ["r", "r/figures", "r/index.html", "r/tables", "r/tables/c.csv"]


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


# A process whose move fails at a page, if it is told to, and which is killed after so many moves.
KILLED = """
import os, sys
from pathlib import Path
from dune_rl.reporting.folder import replace_report

out, moves_left, fails = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3] == "True"
rename = Path.rename

def move_fail_or_die(source, target):
    global moves_left, fails
    if not moves_left:
        os._exit(9)
    moves_left -= 1
    if fails and source.name == "index.html" and source.parent.name == "new":
        fails = False
        raise OSError("full")
    rename(source, target)

Path.rename = move_fail_or_die
with replace_report(out, overwrite=True) as aside:
    (aside / "figures").mkdir()
    (aside / "tables").mkdir()
    (aside / "tables" / "b.csv").write_text("b")
    (aside / "index.html").write_text("b")
"""


def end_after(moves: int, fails: bool, out: Path) -> int:
    """Exit code of a process that replaces the report in `out`."""
    command = [sys.executable, "-c", KILLED, str(out), str(moves), str(fails)]
    return subprocess.run(command, capture_output=True).returncode


@pytest.mark.parametrize("fails", [False, True])
def test_a_kill_while_a_report_is_put_in_place_leaves_the_old_or_the_new_one(
    fails: bool, tmp_path: Path
) -> None:
    out, found = tmp_path / "r", []
    for moves in range(14):
        with replace_report(out, overwrite=True) as aside:
            write_files(aside, "a")
        code = end_after(moves, fails, out)
        with pytest.raises(ConfigError, match="holds a report already"):
            check_folder(out, overwrite=False)
        found.append((out / "index.html").read_text())
        assert files(tmp_path) == ["r", "r/figures", "r/index.html", "r/tables", f"r/tables/{found[-1]}.csv"]
        if code != 9:
            break
    # Three entries leave, their folder is renamed, and three others come; or two of them go again.
    assert "".join(found) == ("aaaabbbbbbaaaaa" if fails else "aaaabbbb")[: len(found)]
    assert (code, len(found)) == ((1, 14) if fails else (0, 8))


def test_a_report_on_a_mount_is_replaced_within_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.path.ismount", lambda path: path == tmp_path)
    for text in "ab":
        with replace_report(tmp_path, overwrite=True) as aside:
            write_files(aside, text)
            assert aside.is_relative_to(tmp_path)
        assert files(tmp_path) == ["figures", "index.html", "tables", f"tables/{text}.csv"]
        with pytest.raises(ConfigError, match="holds a report already"):
            check_folder(tmp_path, overwrite=False)


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
