"""The page of clients is true: its code runs, its commands compose, its table is that of the tests."""

import importlib.util
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from client_table import CLIENTS, END, PASSED, installed_version, marked_rows, read_table

from dune_rl.commands.command_line import config_folders, parse_arguments
from dune_rl.config.compose import check_sweep

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs" / "how_to" / "clients.md"
BLOCKS = re.findall(r"^## (.*?)$|^```(\w+)\n(.*?)^```$", PAGE.read_text(), flags=re.MULTILINE | re.DOTALL)
PINNED = dict(re.findall(r"^([\w-]+)==(.*)$", (ROOT / "constraints.txt").read_text(), flags=re.MULTILINE))


def snippets() -> list:
    """The Python blocks, by the heading before them."""
    found, heading = [], ""
    for title, language, text in BLOCKS:
        heading = title or heading
        if language == "python":
            found.append(pytest.param(text, id=heading))
    return found


@pytest.mark.slow(all_but=["*PettingZoo*"])
@pytest.mark.parametrize("text", snippets())
@pytest.mark.filterwarnings("ignore::UserWarning:benchmarl.*")
@pytest.mark.filterwarnings("ignore::UserWarning:torchrl.*")
def test_code_runs(text: str, folder: Path) -> None:
    for name in re.findall(r"^(?:import|from) (\w+)", text, flags=re.MULTILINE):
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"without {name}")
    if "benchmarl" in text and installed_version("BenchMARL") is None:
        pytest.skip("without benchmarl")
    exec(compile(text, str(PAGE), "exec"), {"__name__": "__main__"})


COMMANDS = [
    line.removeprefix("python -m dune_rl.train ")
    for _, language, text in BLOCKS
    if language == "bash"
    for line in text.splitlines()
    if line.startswith("python -m dune_rl.train ")
]


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_compose(command: str) -> None:
    parsed = parse_arguments(shlex.split(command), sweeps=True)
    assert parsed.multirun
    plain = [word for word in parsed.overrides if not re.match(r"hydra[/.]", word)]
    check_sweep(plain, config_folders(parsed))


def test_every_part_of_the_page_was_found() -> None:
    assert len(snippets()) == 9 and len(COMMANDS) == 4
    for link in re.findall(r"\]\((\.\./[^)#]*)", PAGE.read_text()):
        assert (PAGE.parent / link).exists(), link


def test_the_table_has_the_tests_rows() -> None:
    assert list(read_table(PAGE)) == marked_rows(HERE)


def test_the_table_is_of_the_pinned_versions_and_all_pass() -> None:
    for row, (version, result) in read_table(PAGE).items():
        assert (version, result) == (PINNED[CLIENTS[row.client]], PASSED), row


@pytest.mark.slow
def test_the_table_tells_what_fails_and_what_was_left_out(tmp_path: Path) -> None:
    shutil.copy(HERE / "conftest.py", tmp_path)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = client: a row\n")
    (tmp_path / "test_planted.py").write_text(
        "import pytest\n"
        "@pytest.mark.client('Gymnasium', 'some of it', 'a')\n"
        "@pytest.mark.parametrize('number', [1, 2, 3])\n"
        "def test_one(number): assert number != 2\n"
        "@pytest.mark.client('PettingZoo', 'nothing', 'b')\n"
        "def test_two(): pytest.skip('no time')\n"
        "@pytest.mark.client('PettingZoo', 'all', 'c')\n"
        "def test_three(): pass\n"
        "@pytest.mark.client('PettingZoo', 'not run', 'c')\n"
        "def test_four(): pass\n"
    )
    page = tmp_path / "page.md"
    row = "| PettingZoo | 0.1 | {} | `c` | no |\n"
    rows = "| a | b | c | d | e |\n" + row.format("all") + row.format("old") + row.format("not run")
    page.write_text(f"before\n<!-- clients: begin -->\n{rows}{END}\nafter\n")
    words = [
        "-k",
        "not four",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        f"--clients-table={page}",
        str(tmp_path),
    ]
    helpers = {"PYTHONPATH": f"{HERE.parent / 'helpers'}"}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words], env=helpers, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 1, done.stdout + done.stderr
    results = ["**fails**", "skipped no time", PASSED, "no"]
    assert [result for _, result in read_table(page).values()] == results
    assert [row.purpose for row in read_table(page)] == ["some of it", "nothing", "all", "not run"]
    assert page.read_text().startswith("before\n") and page.read_text().endswith("\nafter\n")
