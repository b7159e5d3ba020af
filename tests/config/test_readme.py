"""The README is true: its snippets run, its commands compose, its shown errors are the real ones."""

import re
import shlex
from pathlib import Path

import pytest
from user_packages import packages_on_path, write_package

from dune_rl import paths
from dune_rl.command import config_folders, parse_arguments
from dune_rl.config.compose import (
    check_sweep,
    compose,
    compose_evaluation,
    compose_resumed,
    compose_view,
    override_value,
)
from dune_rl.engine_comparison.job import parse_settings as engines_settings
from dune_rl.errors import ConfigError

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)
COMMANDS = sorted(
    {
        match[1].strip()
        for language, text in BLOCKS
        if language in ("sh", "bash")
        for match in re.finditer(
            r"(?:\S*python) -m (dune_rl\..*)$", text.replace("\\\n", " "), flags=re.MULTILINE
        )
    }
)
PYTHON = [text for language, text in BLOCKS if language == "python"]


def compose_command(words: list[str]) -> None:
    program, *rest = words
    parsed = parse_arguments(rest)
    overrides, folders = parsed.overrides, config_folders(parsed)
    saved = compose(["+world=inspection"]).model_dump(mode="json")
    if program == "dune_rl.train" and override_value(overrides, "resume"):
        compose_resumed(overrides, folders, saved)
    elif program == "dune_rl.train":
        check_sweep(overrides, folders) if parsed.multirun else compose(overrides, folders)
    elif program == "dune_rl.evaluate":
        compose_evaluation(overrides, folders, saved if override_value(overrides, "checkpoint") else None)
    elif program == "dune_rl.engines":
        engines_settings(overrides)
    elif program == "dune_rl.view":
        compose_view(overrides, folders, saved if override_value(overrides, "checkpoint") else None)
    else:
        assert program == "dune_rl.benchmark"


def test_readme_opens_with_two_commands_that_set_themselves_up() -> None:
    (first, run), (second, test) = BLOCKS[:2]
    assert (first, second) == ("sh", "sh")
    for block in (run, test):
        assert len(block.strip().splitlines()) == 1
        assert "-m venv" in block
        assert "-c constraints.txt" in block
    assert "dune_rl.train +world=inspection" in run
    assert "-m pytest" in test


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_compose(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(write_package(README, tmp_path))
    with packages_on_path(tmp_path):
        compose_command(shlex.split(command))


def test_a_stale_command_would_be_noticed() -> None:
    with pytest.raises(ConfigError):
        compose_command(["dune_rl.train", "+world=inspection", "total_frame=1"])


@pytest.mark.parametrize("snippet", PYTHON, ids=[f"snippet{index}" for index in range(len(PYTHON))])
def test_snippets_run(snippet: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(snippet, "README.md", "exec"), {})


def test_the_shown_errors_are_the_real_ones() -> None:
    (shown,) = (text for language, text in BLOCKS if language == "console")
    command, *expected = shown.strip().splitlines()
    with pytest.raises(ConfigError) as caught:
        compose(shlex.split(command)[4:])
    assert str(caught.value).splitlines() == expected


def test_the_table_of_groups_is_complete() -> None:
    rows = dict(
        re.findall(r"^\| `(\w+)` \| (`.*?`) \|", README.split("## Configuration")[1], flags=re.MULTILINE)
    )
    stated = {group: set(re.findall(r"`(\w+)`", options)) for group, options in rows.items()}
    there = {
        folder.name: {path.stem for path in folder.glob("*.yaml")}
        for folder in paths.conf_folder().iterdir()
        if folder.is_dir()
    }
    assert stated == there
