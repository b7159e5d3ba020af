"""The documentation is true: its snippets run, its commands compose, its links lead somewhere."""

import importlib
import importlib.util
import re
import shlex
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import page_sources
import pytest
from documents import (
    CLIENTS_PAGE,
    DOCS,
    PAGES,
    ROOT,
    TUTORIAL,
    code_blocks,
    commands,
    extension_text,
    page_name,
)
from gazebo import PLANE, write_model
from urdf_files import CART
from user_packages import packages_on_path, shown_files, write_package
from world_files import write_yard

from dune_rl.commands import doctor, episode_sets, robots
from dune_rl.commands.command_line import config_folders, parse_arguments
from dune_rl.commands.drive import parse_words as drive_words
from dune_rl.commands.engines import parse_settings as engines_settings
from dune_rl.commands.export import subjects_of
from dune_rl.commands.export.gazebo import compose_words
from dune_rl.commands.export.policy import parse_words as policy_words
from dune_rl.commands.pages import PAGES as PROGRAMS
from dune_rl.commands.report import parse_words
from dune_rl.commands.resuming import AUTO
from dune_rl.config.commands import EvaluateConf, ForecastConf, RosConf, ViewConf
from dune_rl.config.compose import check_sweep, compose, override_value
from dune_rl.config.schema import Conf
from dune_rl.core import paths
from dune_rl.core.errors import ConfigError, DuneError
from dune_rl.evaluation.episode_sets.files import read_episode_set
from dune_rl.trajectories.settings import choose_world
from dune_rl.trajectories.settings import parse_words as trajectory_words

# The page of clients has tests of its own.
SHOWN = [
    (page, command) for page in PAGES for command in dict.fromkeys(commands(page)) if page != CLIENTS_PAGE
]
SNIPPETS = [
    (page, text)
    for page in PAGES
    for language, text in code_blocks(page)
    if page != CLIENTS_PAGE and language == "python" and not re.match(r"# [\w/]+\.py\n", text)
]
PLUGINS = {
    "joblib": "hydra_plugins.hydra_joblib_launcher",
    "submitit": "hydra_plugins.hydra_submitit_launcher",
    "ray": "hydra_plugins.hydra_ray_launcher",
    "optuna": "hydra_plugins.hydra_optuna_sweeper",
}


def is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def compose_command(words: list[str]) -> None:
    program, *rest = words
    if program == "dune_rl":
        return
    if program == "dune_rl.robots":
        robots.run(rest)
        return
    if program == "dune_rl.doctor":
        doctor.parse(rest)
        return
    if program == "dune_rl.episode_sets":
        asked = episode_sets.parse(rest)
        if asked.command == "make":
            assert [recipe.settings for recipe in episode_sets.named_recipes(asked)]
        return
    parsed = parse_arguments(rest, sweeps=program == "dune_rl.train")
    overrides, folders = parsed.overrides, config_folders(parsed)
    saved = compose(Conf, ["+world=inspection"]).model_dump(mode="json")
    if program == "dune_rl.train" and override_value(overrides, "resume") not in (None, AUTO):
        compose(Conf, overrides, folders, saved)
    elif program == "dune_rl.train":
        check_sweep(overrides, folders) if parsed.multirun else compose(Conf, overrides, folders)
    elif program == "dune_rl.evaluate" and {"resume", "verify", "join"} & {
        word.partition("=")[0] for word in rest
    }:
        assert {word.partition("=")[0] for word in rest} <= {
            *("resume", "processes", "verify", "sample", "join", "out")
        }
    elif program == "dune_rl.evaluate":
        add_world_of_set(overrides)
        compose(EvaluateConf, overrides, folders, saved if override_value(overrides, "checkpoint") else None)
    elif program == "dune_rl.forecast":
        compose(ForecastConf, overrides, folders)
    elif program == "dune_rl.ros":
        compose(RosConf, overrides, folders, saved if override_value(overrides, "checkpoint") else None)
    elif program == "dune_rl.drive":
        drive_words(rest)
    elif program == "dune_rl.engines":
        engines_settings(overrides)
    elif program == "dune_rl.report":
        parse_words(rest)
    elif program == "dune_rl.export":
        policy_words(rest) if "policy" in subjects_of(overrides) else compose_words(parsed)
    elif program == "dune_rl.trajectory":
        trajectory_words(rest)
    elif program == "dune_rl.view":
        add_world_of_set(overrides)
        compose(ViewConf, overrides, folders, saved if override_value(overrides, "checkpoint") else None)
    else:
        assert program == "dune_rl.benchmark"


def add_world_of_set(overrides: list[str]) -> None:
    """Choose the world of the set that they name, as the commands do, where no checkpoint tells it."""
    name = override_value(overrides, "set")
    if name is not None and not override_value(overrides, "checkpoint"):
        # A path is that of a set that the page has made.
        own = str(name).endswith(".json")
        overrides.append(f"+world={'inspection' if own else read_episode_set(str(name)).world}")


def write_named_files(folder: Path) -> None:
    """Small files for those of a user's that the pages name."""
    for name in ("marsyard", "maze", "hall"):
        write_model(folder / "models", name, PLANE.format(surface=""))
    (folder / "FOLDER").mkdir()
    (folder / "FOLDER" / "world_0.world").write_text(f'<sdf version="1.7">{PLANE.format(surface="")}</sdf>')
    write_yard(folder, "glb").rename(folder / "site.glb")
    (folder / "my_robot.urdf").write_text(re.sub(r"<mesh[^>]*/>", '<box size="0.4 0.3 0.12"/>', CART))


def write_options(page: Path, folder: Path) -> None:
    """The files of options that a page shows, and the file beside them that one of them names."""
    for name, content in shown_files(page.read_text()).items():
        if name.endswith(".yaml"):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(content)
            write_yard((folder / name).parent, "glb").rename((folder / name).with_suffix(".glb"))


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A current folder with the files that the pages show, whose packages are installed."""
    folder = tmp_path / "work"
    folder.mkdir()
    with ExitStack() as stack:
        for name, text in (("parts", TUTORIAL.read_text()), ("dunes", extension_text())):
            (tmp_path / name).mkdir()
            stack.enter_context(packages_on_path(write_package(text, tmp_path / name)))
        write_named_files(folder)
        monkeypatch.chdir(folder)
        yield folder


@pytest.mark.slow(all_but=["README.md*"])
@pytest.mark.parametrize(
    ("page", "command"), SHOWN, ids=[f"{page_name(page)}: {command}" for page, command in SHOWN]
)
def test_commands_compose(page: Path, command: str, packages: Path) -> None:
    for plugin, module in PLUGINS.items():
        if plugin in command and not is_installed(module):
            pytest.skip(f"{module} is not installed")
    write_options(page, packages)
    compose_command(shlex.split(command))


def test_a_stale_command_would_be_noticed() -> None:
    with pytest.raises(ConfigError):
        compose_command(["dune_rl.train", "+world=inspection", "total_frame=1"])


def test_every_command_of_the_package_is_shown() -> None:
    shown = {command.split()[0] for _, command in SHOWN}
    assert {f"dune_rl.{name}" for name in PROGRAMS} <= shown


@pytest.mark.slow(all_but=["README.md-0", "docs/how_to/gymnasium.md-8", "docs/how_to/torchrl.md-13"])
@pytest.mark.parametrize(
    ("page", "snippet"),
    SNIPPETS,
    ids=[f"{page_name(page)}-{number}" for number, (page, _) in enumerate(SNIPPETS)],
)
def test_snippets_run(page: Path, snippet: str, packages: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # Python may have listed this folder in the same instant, before the files were there.
    importlib.invalidate_caches()
    exec(compile(snippet, page_name(page), "exec"), {"__name__": "__main__"})


@pytest.mark.slow
def test_the_shown_errors_are_the_real_ones() -> None:
    shown = [text for page in PAGES for language, text in code_blocks(page) if language == "console"]
    assert shown
    for text in shown:
        command, *expected = text.strip().splitlines()
        words = shlex.split(command)
        with pytest.raises(DuneError) as caught:
            if "dune_rl.trajectory" in words:
                world, settings, conf = trajectory_words(words[3:])
                conf.plan(choose_world(world, settings))
            else:
                compose(Conf, words[4:])
        assert str(caught.value).splitlines() == expected


def test_the_table_of_groups_is_complete() -> None:
    text = (DOCS / "reference" / "configuration.md").read_text()
    rows = dict(re.findall(r"^\| `(\w+)` \| (`.*?`) \|", text, flags=re.MULTILINE))
    stated = {group: set(re.findall(r"`(\w+)`", options)) for group, options in rows.items()}
    there = {
        folder.name: {path.stem for path in folder.glob("*.yaml")}
        for folder in paths.conf_folder().iterdir()
        if folder.is_dir()
    }
    assert stated == there


def test_the_table_of_observations_is_that_of_the_spaces() -> None:
    import dune_rl

    text = (DOCS / "concepts" / "agents.md").read_text()
    robot, walker = text.split("## The walker")
    settings = {"sensors": "all", "actors": "external_walkers"}
    env = dune_rl.parallel_env("flat", **settings)
    for part, agent in ((robot, "rover_0"), (walker, "walker_0")):
        space = env.observation_space(agent)
        sizes = {
            name: int(size) for name, size in re.findall(r"^\| `(\w+)` \| (\d+) \|", part, flags=re.MULTILINE)
        }
        vectors = {name: each.shape[0] for name, each in space.items() if len(each.shape) == 1}
        assert sizes == vectors
    for name, each in env.observation_space("rover_0").items():
        if len(each.shape) > 1:
            assert f"`{name}`" in robot, name
    env.close()


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_links_lead_to_files(page: Path) -> None:
    page_sources.redirect_links(page.read_text(), page, page, {})


def test_named_test_files_are_there() -> None:
    studies = (ROOT / "experiments").rglob("*.md")
    named = {
        name for page in (*PAGES, *studies) for name in re.findall(r"tests/[\w/]+\.py", page.read_text())
    }
    assert named and [name for name in sorted(named) if not (ROOT / name).is_file()] == []


def test_a_broken_link_would_be_noticed() -> None:
    with pytest.raises(FileNotFoundError, match=r"there is no gone\.md"):
        page_sources.redirect_links("[text](gone.md)", DOCS / "index.md", DOCS / "index.md", {})
    with pytest.raises(IsADirectoryError, match="link a file"):
        page_sources.redirect_links("[text](how_to)", DOCS / "index.md", DOCS / "index.md", {})
    for text in ("[text](https://example.org)", "[text](#part)", "```\n[text](gone.md)\n```"):
        assert page_sources.redirect_links(text, DOCS / "index.md", DOCS / "index.md", {}) == text


def test_an_included_file_keeps_its_links() -> None:
    shown = page_sources.shown_pages()
    page = DOCS / "results" / "flat.md"
    readme = ROOT / "experiments" / "inspection" / "README.md"
    assert shown[ROOT / "experiments" / "flat" / "README.md"] == page
    text = page_sources.redirect_links("![curve](curve.png) [all](../README.md)", readme, page, shown)
    assert text == "![curve](../../experiments/inspection/curve.png) [all](index.md)"
