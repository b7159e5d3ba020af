"""Episode sets of world files, as the BARN benchmark has them: found from anywhere, refused once changed."""

import csv
from pathlib import Path

import numpy as np
import pytest
from gazebo import model, sdf
from sites import WIDE_PLANE

from dune_rl.commands import episode_sets, evaluate
from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError, DuneError, WorldError
from dune_rl.evaluation.episode_sets.apply import plan_of_set, settings_on_set
from dune_rl.evaluation.episode_sets.files import EpisodeSet, read_episode_set

# Sides of the planes [m], by the number of the world.
SIDES_M = {1: 32, 2: 30, 10: 36}
ENDS = ["start=[-2,3,90]", "goal=[-2,13]"]


def course(number: int) -> str:
    """A course as the BARN benchmark's worlds have it: cylinders between walls, from y = 5 to 10 m."""
    plane = WIDE_PLANE.replace("100 100", f"{SIDES_M[number]} {SIDES_M[number]}")
    walls = [model(f"w{x}", "<box><size>0.2 12 1</size></box>", f"{x} 7 0.5 0 0 0") for x in (-4.6, 0.1)]
    post = "<cylinder><radius>0.075</radius><length>1</length></cylinder>"
    places = np.random.default_rng(number).uniform([-4.3, 5.0], [-0.2, 10.0], (6, 2)).tolist()
    posts = [model(f"unit_cylinder_{n}", post, f"{x} {y} 0.5 0 0 0") for n, (x, y) in enumerate(places)]
    return sdf(plane, *walls, *posts)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "worlds").mkdir()
    for number in SIDES_M:
        (tmp_path / "worlds" / f"world_{number}.world").write_text(course(number))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def make(*words: str) -> None:
    episode_sets.run(["make", "barn", "+world=sdf", "actors=none", *words])


def made() -> EpisodeSet:
    return read_episode_set("episode_sets/barn.json")


@pytest.mark.slow
def test_a_set_of_several_files_is_evaluated_from_another_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make("world.path=worlds/*.world", *ENDS, "task.terminations.time_limit.max_steps=20")
    assert [Path(file.path).name for file in made().header.files] == [
        f"world_{number}.world" for number in (1, 2, 10)
    ]
    assert made().header.bounds == (-18.0, 18.0, -18.0, 18.0)
    assert {(row.start, row.goal) for row in made().episodes} == {((-2.0, 3.0, 1.5708), (-2.0, 13.0))}
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir(folder / "elsewhere")
    evaluate.run(["set=../episode_sets/barn.json", "policy=go_to_goal", "out=results", "scenes=2"])
    rows = list(csv.DictReader((folder / "elsewhere" / "results" / "episodes.csv").read_text().splitlines()))
    assert [row["world_file"] for row in rows] == [f"../worlds/world_{n}.world" for n in (1, 2, 10)]
    assert [float(row["barn_score"]) for row in rows] == [0.0, 0.0, 0.0]
    assert {row["steps"] for row in rows} == {"20"}


@pytest.mark.slow
def test_worlds_of_other_extents_share_the_bounds_of_observations(folder: Path) -> None:
    make("world.path=worlds/*.world", *ENDS)
    conf = settings_on_set(compose_environment("flat", ["sensors.enabled=[goal,position]"]), made())
    simulation = make_simulation(conf, 3, 0, plan=plan_of_set(conf, made()))
    simulation.reset()
    assert [world.extent[1] for world in simulation.worlds.worlds] == [16.0, 15.0, 18.0]
    low, high = simulation.external[0].observation_bounds["position"]
    assert (low[0], high[0]) == (-18.0, 18.0)
    simulation.close()


@pytest.mark.slow
def test_a_changed_file_is_refused(folder: Path) -> None:
    make("world.path=worlds/*.world", *ENDS)
    evaluated = ["set=episode_sets/barn.json", "policy=go_to_goal", "episodes=1"]
    file = folder / "worlds" / "world_2.world"
    file.write_text(course(1))
    with pytest.raises(ConfigError, match=r"world_2\.world was changed; put back the file with which barn"):
        evaluate.run(evaluated)
    file.unlink()
    with pytest.raises(ConfigError, match=r"world_2\.world is missing; put back the file"):
        evaluate.run(evaluated)


def test_a_set_of_one_file_knows_it_too(folder: Path) -> None:
    make(f"world.path={folder}/worlds/world_1.world", "--episodes=2")
    assert made().header.files[0].path == f"{folder}/worlds/world_1.world"
    assert {row.world_seed for row in made().episodes} == {None}
    (folder / "worlds" / "world_1.world").write_text(course(2))
    with pytest.raises(ConfigError, match=r"world_1\.world was changed"):
        settings_on_set(compose_environment("flat"), made())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("world.path=/nonexistent", "there is no file /nonexistent: world.path must name one that exists"),
        ("world.path=worlds/*.sdf", "world.path=worlds/*.sdf matches no file"),
        ("world.path=worlds/*.world start=[-2,3,90]", "start and goal go together"),
        (
            "world.path=worlds/*.world start=[-2,3] goal=[-2,13]",
            "start must be 3 numbers, 'start=[x,y,heading",
        ),
        ("world.path=worlds/*.world --sites=3 --episodes=3", "names 3 files, which are the sites"),
        ("world.path=worlds/*.world --episodes=4", "must be a multiple of the number of files, 3"),
        ("world.path=worlds/world_1.world --sites=2", "has no seed, and so one site"),
    ],
)
def test_words_that_make_no_set(words: str, message: str, folder: Path) -> None:
    with pytest.raises(DuneError) as caught:
        make(*words.split())
    assert message in str(caught.value)
    assert not (folder / "episode_sets").exists()


@pytest.mark.slow
def test_a_file_without_room_at_the_start_is_named(folder: Path) -> None:
    block = model("block", "<box><size>1 1 1</size></box>", "-2 3 0.5 0 0 0")
    file = folder / "worlds" / "world_2.world"
    file.write_text(file.read_text().replace("</world>", f"{block}</world>"))
    with pytest.raises(WorldError, match=r"world_2\.world: the start \(-2, 3\) is .* from an obstacle"):
        make("world.path=worlds/*.world", *ENDS)
