"""The episode sets of the package: unchanged, free, apart as stated, and the same in any simulation."""

import json
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from dune_rl.commands import episode_sets, evaluate
from dune_rl.config.build import make_simulation
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose, compose_environment
from dune_rl.config.schema import EnvConf
from dune_rl.config.shorthands import replace_actors
from dune_rl.core.errors import ConfigError, DuneError
from dune_rl.core.paths import conf_folder
from dune_rl.env.requests import EpisodePlan, PlannedEpisode
from dune_rl.evaluation.episode_sets.apply import (
    check_set_overrides,
    faulty_episodes,
    plan_of_set,
    settings_on_set,
)
from dune_rl.evaluation.episode_sets.files import (
    checksum,
    read_episode_set,
    set_names,
    sets_folder,
    write_episode_set,
)
from dune_rl.evaluation.episode_sets.recipes import (
    FAMILIES,
    V1,
    V2,
    VARIANTS,
    SetVersion,
    all_recipes,
    generate_on_site,
)

RECIPES, NAMES = all_recipes(), set_names()
# Those of each family and variant but for two crowds, and one of obstacle courses.
FINAL = len(FAMILIES) * len(VARIANTS) - 2 + 1


def version_of(name: str) -> SetVersion:
    return next(version for version in (V1, V2) if name.endswith(version.suffix))


# As one session of a machine differs from another: rows are rounded to a millimetre.
ABOUT = 0.002


def with_defaults(settings: dict[str, Any], conf: EnvConf) -> dict[str, Any]:
    """The settings of a set's header with what they leave out, as validation fills it in."""
    plain = conf.model_dump(mode="json")
    own = {section: values for section, values in settings.items() if section != "actors"}
    own["agents"] = replace_actors(plain["agents"], settings["actors"])
    merged = {**plain, **own, "task": {**plain["task"], **settings["task"]}}
    conf = EnvConf.model_validate(merged)
    filled = conf.model_dump(mode="json")
    filled["actors"] = {name: filled["agents"][name] for name in conf.actors}
    return {
        section: {key: filled["task"][key] for key in values} if section == "task" else filled[section]
        for section, values in settings.items()
    }


def test_every_family_has_every_variant() -> None:
    assert {name for name in RECIPES if name.endswith("-v1")} < set(NAMES) <= set(RECIPES)
    assert len(RECIPES) == 15 + FINAL == 29


@pytest.mark.slow(
    all_but=["flat-v1", "island-crowd-v1", "construction-site-v1", "inspection-v2", "obstacle_course-v2"]
)
@pytest.mark.parametrize("name", NAMES)
def test_a_set_is_as_its_recipe_says(name: str) -> None:
    episode_set, recipe = read_episode_set(name), RECIPES[name]
    rows, seeds = episode_set.episodes, [one.world_seed for one in episode_set.episodes]
    version = version_of(name)
    assert len(rows) == version.episodes
    if recipe.world == "flat":
        assert set(seeds) == {None}
    else:
        drawn = yaml.safe_load((conf_folder() / "randomisation" / "worlds.yaml").read_text())["world_seed"]
        assert len(set(seeds)) == version.sites
        # The sites of no training, nor of another version.
        first = V1.first_site if version is V1 else drawn["high"] + 1
        assert all(
            first <= seed < (drawn["low"] if version is V1 else 2**24)
            for seed in (int(one or 0) for one in seeds)
        )
    header = json.loads(json.dumps(recipe.header(len(set(seeds)))))
    stated = episode_set.header.model_dump(mode="json")
    # A set that was made before there was a setting has its default.
    robot = [f"robot={episode_set.header.robot}"]
    stated["settings"] = with_defaults(stated["settings"], compose_environment(recipe.world, robot))
    assert {key: stated[key] for key in header} == header
    starts, goals = (np.array([getattr(one, end)[:2] for one in rows]) for end in ("start", "goal"))
    apart = np.hypot(*(goals - starts).T)
    low, high = recipe.goal_distance_m
    assert apart.min() >= low and apart.max() <= (high or np.inf)
    # No two rows are the same case.
    assert len({row.line().partition(",")[2] for row in rows}) == version.episodes


@pytest.mark.slow(all_but=["flat-v1", "construction-site-v1", "obstacle_course-v2"])
@pytest.mark.parametrize("name", NAMES)
def test_rows_come_out_of_their_recipe_again_and_start(name: str) -> None:
    episode_set = read_episode_set(name)
    numbers = [0, 3]
    again = generate_on_site(RECIPES[name], episode_set.episodes[0].world_seed, numbers)
    for number, made in zip(numbers, again, strict=True):
        row = episode_set.episodes[number]
        assert made.world_seed == row.world_seed
        assert (*made.start, *made.goal) == pytest.approx((*row.start, *row.goal), abs=ABOUT)
    assert faulty_episodes(episode_set, numbers) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_all_episodes_of_some_sites_start(name: str) -> None:
    """Of some dozen sites, spread over the set: building a site takes seconds."""
    episode_set = read_episode_set(name)
    seeds = list(dict.fromkeys(row.world_seed for row in episode_set.episodes))
    kept = set(seeds[:: max(1, len(seeds) // 12)])
    numbers = [row.episode for row in episode_set.episodes if row.world_seed in kept]
    assert faulty_episodes(episode_set, numbers) == []


@pytest.mark.slow
def test_planned_episodes_are_the_same_in_any_number_of_scenes() -> None:
    episode_set = read_episode_set("island-v1")
    conf = settings_on_set(compose_environment("flat"), episode_set)
    starts: dict[int, list[list[float]]] = {}
    for scenes in (1, 3):
        simulation = make_simulation(
            conf, scenes, episode_set.header.seed, plan=plan_of_set(conf, episode_set)
        )
        simulation.reseed(episode_set.header.seed, 3)
        for _ in range(6 // scenes):
            simulation.reset()
            state = simulation.state
            walkers = state.groups["walker"].motion.position_w.reshape(scenes, -1)
            rover = state.groups["rover"]
            for scene, episode in enumerate(simulation.episodes.tolist()):
                row = episode_set.episodes[episode]
                assert rover.goal.position_w[scene].tolist() == list(row.goal)
                assert rover.motion.position_w[scene, :2] == pytest.approx(row.start[:2], abs=0.1)
                assert simulation.worlds.worlds[scene].name == "island"
                assert simulation.randomized["world_seed"][scene] == row.world_seed
                values = [*rover.motion.position_w[scene].tolist(), *walkers[scene].tolist()]
                starts.setdefault(episode, []).append(values)
        simulation.close()
    assert sorted(starts) == [3, 4, 5, 6, 7, 8]
    for alone, batched in starts.values():
        assert alone == batched


def test_a_saved_state_of_a_planned_episode_is_restored() -> None:
    episode_set = read_episode_set("island-v1")
    conf = settings_on_set(compose_environment("flat", ["actors=none"]), episode_set)
    simulation = make_simulation(conf, 1, 3, plan=plan_of_set(conf, episode_set))
    simulation.reset()
    simulation.step({"rover": np.full((1, 1, 2), 0.3)})
    saved, before = simulation.save_state(), simulation.state.groups["rover"].motion.position_w.copy()
    simulation.reset()
    simulation.restore(saved)
    assert np.array_equal(simulation.state.groups["rover"].motion.position_w, before)
    simulation.close()


def _copy(name: str, folder: Path) -> Path:
    for suffix in (".json", ".csv"):
        shutil.copy(sets_folder() / f"{name}{suffix}", folder)
    return folder / f"{name}.json"


def test_a_changed_set_is_refused(tmp_path: Path) -> None:
    file = _copy("flat-v1", tmp_path)
    rows = file.with_suffix(".csv")
    kept = rows.read_text()
    assert read_episode_set(str(file)) == read_episode_set("flat-v1")
    rows.write_bytes(kept.replace("\n", "\r\n").encode())
    assert read_episode_set(str(file)) == read_episode_set("flat-v1")
    rows.write_text(kept.replace("-1.427", "-1.428"))
    with pytest.raises(ConfigError, match=r"flat-v1\.csv was changed: its checksum is"):
        read_episode_set(str(file))
    rows.write_text(kept)
    header = json.loads(file.read_text())
    many = {**header, "episodes": 10**12}
    file.write_text(json.dumps({**many, "sha256": checksum(many, kept)}))
    with pytest.raises(ConfigError, match="must have the episodes 0 to 999999999999"):
        read_episode_set(str(file))
    header["settings"]["actors"] = {}
    file.write_text(json.dumps(header))
    with pytest.raises(ConfigError, match="a changed set needs a name and a file of its own"):
        read_episode_set(str(file))
    header["settings"]["task"] = 1.5
    file.write_text(json.dumps(header))
    with pytest.raises(
        ConfigError, match=r"is no episode set \(settings\.task: Input should be a valid dict"
    ):
        read_episode_set(str(file))
    header["settings"]["task"] = {}
    del header["seed"]
    file.write_text(json.dumps(header))
    with pytest.raises(ConfigError, match=r"is no episode set \(seed: Field required\)"):
        read_episode_set(str(file))
    file.write_text("{")
    with pytest.raises(ConfigError, match="is not JSON; copy the set again"):
        read_episode_set(str(file))
    rows.unlink()
    _copy("flat-v1", tmp_path).with_suffix(".csv").unlink()
    with pytest.raises(ConfigError, match="a set has a"):
        read_episode_set(str(file))
    with pytest.raises(ConfigError, match="there is no episode set 'flat-v3'; did you mean"):
        read_episode_set("flat-v3")


def test_a_set_of_ones_own(tmp_path: Path) -> None:
    rows = read_episode_set("flat-v1").episodes[:3]
    header = {**RECIPES["flat-v1"].header(1), "name": "mine-v1", "episodes": 3}
    written = write_episode_set(tmp_path, header, rows)
    assert read_episode_set(str(tmp_path / "mine-v1.json")) == written
    assert written.header.sha256 != read_episode_set("flat-v1").header.sha256


def make_own(*words: str) -> None:
    episode_sets.run(["make", *words])


@pytest.mark.slow
def test_the_command_makes_a_set_of_ones_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("hills.npy", np.random.default_rng(1).uniform(0.0, 0.1, (40, 40)))
    heights = ["+world=heightmap", "world.path=hills.npy", "world.size_m=[40,40]"]
    make_own("hills-v1", *heights, "robot=hyperdog", "--episodes", "3", "--farthest=6", "actors=none")
    made = read_episode_set("episode_sets/hills-v1.json")
    assert made.header.sha256 in capsys.readouterr().out
    assert made.header.robot == "hyperdog" and len(made.episodes) == 3
    for row in made.episodes:
        assert 2.0 <= np.hypot(*np.subtract(row.goal, row.start[:2])) <= 6.0
    episode_sets.run(["check", "episode_sets/hills-v1.json"])
    assert "0 faults" in capsys.readouterr().out
    words = ["set=episode_sets/hills-v1.json", "policy=random", "robot=hyperdog", "episodes=1", "scenes=1"]
    evaluate.run([*words, "out=results"])
    assert (tmp_path / "results" / "episodes.csv").read_text().count("\n") == 2
    # What made it is in the file, and makes it again.
    words = shlex.split(made.header.command)[4:]
    make_own(*words, "--out", "again")
    assert read_episode_set("again/hills-v1.json") == made
    make_own("mine-v1", "+world=island", "--sites=2", "--episodes=4", "--seed=8")
    seeds = [one.world_seed for one in read_episode_set("episode_sets/mine-v1.json").episodes]
    assert seeds == [500, 500, 501, 501]
    conf = compose(EvaluateConf, ["+world=flat", "policy=random", "seed=3"])
    assert settings_on_set(conf, read_episode_set("episode_sets/mine-v1.json")).seed == 8


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("flat-v3", "there is no recipe 'flat-v3'; did you mean flat-v2? For one of your own give settings"),
        ("flat-v1 --episodes 3", "--episodes is for a set of your own; add its settings: +world=NAME"),
        ("robot=leo_rover", "settings are for one set: make NAME robot=leo_rover"),
        ("mine-v1 robot=leo_rover", "the set mine-v1 needs a world: +world=NAME"),
        ("flat-v1 +world=flat", "flat-v1 is a set of the package; give yours another name"),
        ("../x +world=flat", "a set's name has letters, digits, '-' and '_' alone, such as mine-v1"),
        ("x +world=flat robots=[leo_rover,leo_rover]", "set=x is for one robot"),
        ("x +world=flat --sites 2", "the world flat has no seed, and so one site; leave --sites out"),
        ("x +world=island --sites 3", "--episodes 100 must be a multiple of --sites 3"),
        ("x +world=island randomisation=worlds", "leave randomisation.world_seed out, and take --sites N"),
        ("x +world=flat --farthest 1", "--farthest 1 must be more than task.spawn.min_goal_distance_m=2"),
        ("x +world=flat --seed=-1", "--seed must be at least 0 (got -1)"),
        ("x +world=flat robot=dog", "there is no robot 'dog'"),
    ],
)
def test_a_set_that_cannot_be_made(
    words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DuneError) as caught:
        make_own(*words.split())
    assert message in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_what_a_set_determines_is_not_set_beside_it() -> None:
    check_set_overrides("flat-v1", ["task=paper", "sensors=all", "physics=dart", "episodes=3"])
    for word, message in (
        ("+world=flat", "set=flat-v1 determines world; leave \\+world=flat out"),
        ("world.size_m=30", "determines world; leave world.size_m=30 out"),
        ("task.terminations.time_limit.max_steps=3", "determines task.terminations"),
        ("seed=4", "determines seed"),
        ("robots=[rover_zero,rover_zero]", "is for one robot; take robot=NAME"),
    ):
        with pytest.raises(ConfigError, match=message):
            check_set_overrides("flat-v1", [word])
    two = compose_environment("flat", ["robots=[rover_zero,rover_zero]"])
    with pytest.raises(ConfigError, match="set=flat-v1 is for one robot"):
        settings_on_set(two, read_episode_set("flat-v1"))


def test_a_larger_robot_has_no_room(tmp_path: Path) -> None:
    header = {**RECIPES["flat-v1"].header(1), "footprint_radius_m": 0.2}
    small = write_episode_set(tmp_path, header, read_episode_set("flat-v1").episodes)
    with pytest.raises(ConfigError, match=r"room for footprints of 0.20 m \(rover_zero\), and the robot"):
        settings_on_set(compose_environment("flat"), small)


def test_plans_that_are_none() -> None:
    with pytest.raises(ValueError, match="a plan needs episodes"):
        EpisodePlan([])
    with pytest.raises(ValueError, match="in all of them or in none"):
        EpisodePlan([PlannedEpisode(), PlannedEpisode(world_seed=3)])


def test_limits_in_steps_hold_for_one_control_rate() -> None:
    conf = compose_environment(
        "flat", ["robot=rover_zero", "sensors.enabled=[goal]", "physics.control_hz=10"]
    )
    with pytest.raises(ConfigError, match=r"leave physics\.control_hz=10 out"):
        settings_on_set(conf, read_episode_set("flat-v1"))
