"""Overrides, faulty ones above all: what is refused, and in which words."""

import shlex
from pathlib import Path

import hydra
import pytest
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig

from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import check_sweep, compose, compose_environment, override_value
from dune_rl.config.schema import Conf, EnvConf
from dune_rl.core import paths
from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import split_word, text_word, typed_word
from dune_rl.worlds.flat import FlatConf

CONF = paths.conf_folder()
EXPERIMENTS = sorted(path.stem for path in CONF.glob("experiment/*.yaml"))
WORLDS = "construction, flat, heightmap, inspection, island, mesh, mixed, obstacle_course, rubicon or sdf"
CHOOSE = f"choose a world: +world=NAME with {WORLDS}"
NO_MOON = f"there is no world 'moon'; choose {WORLDS}"


@pytest.mark.slow(all_but=["quick"])
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_experiments_compose_and_give_way(experiment: str) -> None:
    assert compose(Conf, [f"+experiment={experiment}", "seed=7"]).seed == 7
    for world in ("world=inspection", "+world=inspection"):
        assert compose(Conf, [f"+experiment={experiment}", world]).world.name == "inspection"


@pytest.mark.parametrize("seed", ["seed=3", "+seed=3", "++seed=3"])
@pytest.mark.parametrize("world", ["world=flat", "+world=flat"])
@pytest.mark.parametrize("actors", ["actors=none", "+actors=none"])
def test_the_plus_makes_no_difference(world: str, actors: str, seed: str) -> None:
    conf = compose(Conf, [world, actors, seed])
    assert (conf.world.name, conf.actors, conf.seed) == ("flat", {}, 3)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ([], CHOOSE),
        (["+world=inspektion"], "there is no world 'inspektion'; did you mean inspection?"),
        (["+wrld=flat", "world=flat"], "wrld is not a setting; did you mean world?"),
        (["world=flat", "actors=throng"],
         "there are no actors 'throng'; choose cars, cows, crossing, crowd, default, dogs, drones, "
         "external_walkers, flee, follow, herd, jaywalkers, learning_walkers, none, orca, patrol, "
         "pedestrians, random_waypoint, social_force, tractor, trucks or walkers"),
        (["world=flat", "learning.batch_size=0"], "learning.batch_size must be at least 1 (got 0)"),
        (["world=flat", "world.friction=-1"], "world.friction must be above 0.0 (got -1)"),
        (["world=flat", "world.friction=6"], "world.friction must be at most 5.0 (got 6)"),
        (["world=flat", "learning.tau=nan"], "learning.tau must be a finite number (got nan)"),
        (["world=flat", "learning.hidden=[0]"], "learning.hidden.0 must be at least 1 (got 0)"),
        (["world=flat", "learning.hidden=[]"], "learning.hidden must be a list of at least 1 (got [])"),
        (["world=flat", "total_frames=1.5"], "total_frames must be a whole number (got 1.5)"),
        (["world=flat", "total_frames=abc"], "total_frames must be a whole number (got 'abc')"),
        (["world=flat", "total_frames=null"], "total_frames must be a whole number (got null)"),
        (["world=flat", "device=tpu"], "device must be one of cpu, cuda (got 'tpu')"),
        (["world=flat", "task.spawn.region=moon"],
         "task.spawn.region must be one of world, anywhere or a list (got 'moon')"),
        (["world=flat", "sensors.lidar=3"],
         "sensors.lidar must be a section with settings of its own (got 3)"),
        (["world=flat", "sensors.lidar.n_beam=5"],
         "sensors.lidar.n_beam is not a setting; did you mean sensors.lidar.n_beams?"),
        (["world=flat", "+sensors.lidar.n_beam=5"],
         "sensors.lidar.n_beam is not a setting; did you mean sensors.lidar.n_beams?"),
        (["world=flat", "++sensors.lidar.n_beam=5"],
         "sensors.lidar.n_beam is not a setting; did you mean sensors.lidar.n_beams?"),
        (["world=inspection", "world.region=3"],
         "world.region is not a setting; did you mean task.spawn.region?"),
        (["world=flat", "learning.collector.scenes=1000000"],
         "learning.collector.scenes must be at most 8192 (got 1000000)"),
        (["world=flat", "learning.standing_cost=1"],
         "learning.standing_cost is not a setting of sac, but of imitation"),
        (["world=flat", "learning=ppo", "learning.n_steps=1"],
         "learning.n_steps is not a setting of ppo, but of crossq, discrete_sac or sac"),
        (["world=flat", "batch_size=64"], "batch_size is not a setting; did you mean learning.batch_size?"),
        (["world=flat", "max_steps=64"],
         "max_steps is not a setting; did you mean task.terminations.time_limit.max_steps?"),
        (["world=flat", "physics.zzz=1"],
         "physics.zzz is not a setting; physics has backend, physics_hz, control_hz, action_repeat, "
         "solver_iterations, friction"),
        (["world=flat", "actors.walker.body.speed_mps=9"],
         "actors.walker.body.speed_mps must be at most 5.0 (got 9)"),
        (["world=flat", "actors.1.speed_mps=9"],
         "actors.1: agent groups have names, not numbers; write walker for 1"),
        (["world=flat", "actors.walker.speed_mps=9"],
         "actors.walker.speed_mps is not a setting; did you mean actors.walker.body.speed_mps?"),
        (["world=flat", "physics.control_hz=30"],
         "physics: control_hz must divide physics_hz (30 does not divide 200); "
         "take 10, 20, 25, 40 or 50 with 200"),
        (["world=flat", "learning.replay.capacity=64"],
         "learning: replay.capacity must be at least batch_size (got 64 and 512)"),
        (["world=flat", "actors=external_walkers", "learning.groups.walkr.hidden=[8]"],
         "learning.groups.walkr: there is no external group 'walkr'; did you mean walker?"),
        (["world=flat", "actors=external_walkers", "learning.groups.walker.hiddn=[8]"],
         "learning.groups.walker.hiddn is not a setting; did you mean hidden?"),
        (["world=flat", "actors=external_walkers", "learning.groups.walker.batch_size=0"],
         "learning.groups.walker.batch_size must be at least 1 (got 0)"),
        (["world=flat", "actors=external_walkers", "learning.groups.walker.replay.capacity=8"],
         "learning.groups.walker.replay.capacity must be at least batch_size (got 8 and 512)"),
        (["world=flat", "actors=external_walkers", "learning.groups.walker.collector.scenes=8"],
         "learning: groups.walker.collector: all groups share it; set it for the run"),
        (["world=flat", "actors=external_walkers", "learning.groups.walker.frozen=3"],
         "learning: groups.walker.frozen must be the path of a policy (got 3)"),
        (["world=flat", "learning.groups.rover.frozen=runs/a"],
         "every external group is frozen, so that nothing learns; leave out learning.groups.rover.frozen, or "
         "evaluate the policies with python -m dune_rl.evaluate"),
        (["world=flat", "learning.population.probability=0.5"],
         "learning.population.probability: past opponents are of other groups that learn, and rover alone "
         "does; set it to 0, or have another group learn (actors=learning_walkers)"),
        (["world=flat", "seed"], "cannot read 'seed'; write key=value"),
        (["world=flat", "learning.hidden=[256"],
         "cannot read 'learning.hidden=[256'; write key=value, and quote a value that holds commas, "
         "brackets, quotes or backslashes: 'learning.hidden=\"...\"'"),
        (["world=flat", "seed=1,2"],
         "seed=1,2 has several values; add -m to run them all, or quote the value"),
        (["world=flat", "wrold/x=1"],
         "there is no group 'wrold/x'; "
         "choose from actors, experiment, learning, metrics, physics, randomisation, robot, scenario, "
         "sensors, task, weather, world"),
        (["world=flat", "seed=${nowhere}"],
         "cannot resolve the settings: Interpolation key 'nowhere' not found"),
    ],
)  # fmt: skip
def test_bad_overrides(overrides: list[str], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        compose(Conf, overrides)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "name", ["2024_01", "20240101", "1e5", "true", "monde été", "runs (2)/a=b", "it", "~/a", "a:b", "日本"]
)
def test_names_of_folders_are_taken_as_they_are_typed(name: str) -> None:
    typed = [
        compose(Conf, ["+world=flat", word]).run_dir for word in (f"run_dir={name}", f'run_dir="{name}"')
    ]
    assert typed == [name, name]
    assert override_value([f"verify={name}"], "verify") == name
    assert compose(Conf, ["+world=sdf", f"world.path={name}/site.sdf"]).world.path == f"{name}/site.sdf"


def test_where_one_value_is_read_several_are_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"^checkpoint=a,b has several values; give one, or quote the value$"
    ):
        override_value(["checkpoint=a,b"], "checkpoint")
    assert override_value(["checkpoint=[a,b]"], "checkpoint") == ["a", "b"]


def test_numbers_stay_numbers() -> None:
    conf = compose(Conf, ["+world=flat", "total_frames=1_000", "learning.tau=5e-3", "resume=null"])
    assert (conf.total_frames, conf.learning.tau, conf.resume) == (1000, 0.005, None)


def test_enormous_numbers_are_named() -> None:
    steps = "task.terminations.time_limit.max_steps"
    with pytest.raises(ConfigError, match=f"^{steps} must be a smaller number$"):
        compose(Conf, ["+world=flat", f"{steps}={'9' * 400}"])
    with pytest.raises(ConfigError, match=r"^seed must be below 9223372036854775808 \(got 1"):
        compose(Conf, ["+world=flat", f"seed={10**30}"])


def test_what_hydra_cannot_merge_is_said(tmp_path: Path) -> None:
    (tmp_path / "experiment").mkdir()
    text = "# @package _global_\ntask:\n  terminations:\n  - null\n"
    (tmp_path / "experiment" / "mine.yaml").write_text(text)
    with pytest.raises(
        ConfigError, match=r"^cannot compose the settings: In 'experiment/mine': .* Cannot merge"
    ):
        compose(Conf, ["+world=flat", "+experiment=mine"], [str(tmp_path)])


def test_faults_come_together() -> None:
    with pytest.raises(ConfigError) as caught:
        compose(
            Conf,
            ["world=moon", "seed=-1", "blah", "+sensors.lidar.n_beam=5", "actors.walker.body.radius_m=0"],
        )
    assert sorted(str(caught.value).splitlines()) == [
        "actors.walker.body.radius_m must be above 0.0 (got 0)",
        "cannot read 'blah'; write key=value",
        "seed must be at least 0 (got -1)",
        "sensors.lidar.n_beam is not a setting; did you mean sensors.lidar.n_beams?",
        NO_MOON,
    ]


@pytest.mark.slow
def test_a_sweep_is_checked_in_every_value() -> None:
    assert check_sweep(["+world=flat,inspection", "seed=1,2"]) == ["+world=flat,inspection", "seed=1,2"]
    with pytest.raises(ConfigError) as caught:
        check_sweep(["+world=flat,moon", "seed=1,-2", "robot.wheel_friction=0.5,1.0,9"])
    assert str(caught.value).splitlines() == [
        NO_MOON,
        "seed must be at least 0 (got -2)",
        "robot.wheel_friction must be at most 3.0 (got 9)",
    ]


def test_environment_settings_reach_what_the_command_line_reaches() -> None:
    by_words = compose(
        Conf,
        ["+world=flat", "actors=none", "task.terminations.time_limit.max_steps=100", "world.friction=0.5"],
    )
    by_settings = compose_environment(
        {"name": "flat", "friction": 0.5},
        (),
        {"actors": "none", "task": {"terminations": {"time_limit": {"max_steps": 100}}}},
    )
    mixed = compose_environment(
        "flat", ["task.terminations.time_limit.max_steps=100", "world.friction=0.5"], {"actors": []}
    )
    expected = EnvConf(**{name: getattr(by_words, name) for name in EnvConf.model_fields})
    assert by_settings == mixed == expected


def test_environment_settings_share_the_messages() -> None:
    with pytest.raises(ConfigError) as caught:
        compose_environment("moon", (), {"sensors": {"lidar": {"n_beam": 5}}, "colour": 3})
    assert sorted(str(caught.value).splitlines()) == [
        "colour is not a setting; "
        "the top level has world, weather, agents, robot, robots, actors, sensors, physics, task, metrics, "
        "randomisation, shield",
        "sensors.lidar.n_beam is not a setting; did you mean sensors.lidar.n_beams?",
        NO_MOON,
    ]


@pytest.mark.slow
def test_saved_settings_stay_unless_asked() -> None:
    saved = compose(Conf, ["+world=inspection", "actors=none", "seed=5", "learning.tau=0.1"]).model_dump(
        mode="json"
    )
    resumed = compose(Conf, ["total_frames=9"], (), saved)
    assert (resumed.world.name, resumed.actors, resumed.seed) == ("inspection", {}, 5)
    assert (resumed.learning.tau, resumed.total_frames) == (0.1, 9)

    same = compose(EvaluateConf, ["checkpoint=x"], (), saved)
    assert (same.world.name, same.actors, same.seed) == ("inspection", {}, 0)
    other = compose(EvaluateConf, ["checkpoint=x", "+world=flat", "physics.control_hz=10"], (), saved)
    assert (other.world, other.actors, other.physics.control_hz) == (FlatConf(), {}, 10)


@pytest.mark.parametrize(("words", "held"), [([], 4), (["physics.action_repeat=2"], 2)])
def test_another_engine_keeps_how_often_a_policy_decides(words: list[str], held: int) -> None:
    saved = compose(Conf, ["+world=flat", "physics.action_repeat=4"]).model_dump(mode="json")
    conf = compose(EvaluateConf, ["checkpoint=x", "physics=dart", *words], (), saved)
    assert (conf.physics.backend, conf.physics.action_repeat) == ("dart", held)


def test_saved_settings_share_the_messages() -> None:
    saved = compose(Conf, ["+world=flat"]).model_dump(mode="json")
    with pytest.raises(ConfigError) as caught:
        compose(Conf, ["total_frames=0", "lerning.tau=1"], (), saved)
    assert str(caught.value).splitlines() == [
        "total_frames must be at least 1 (got 0)",
        "lerning is not a setting; did you mean learning?",
    ]


def test_an_evaluation_has_one_policy_or_several() -> None:
    with pytest.raises(ConfigError, match="choose a policy: checkpoint=PATH, or policy=NAME with dwa"):
        compose(EvaluateConf, ["+world=flat"])
    conf = compose(EvaluateConf, ["+world=flat", "policy=[random,a:b]", "checkpoint=x", "against=go_to_goal"])
    assert (conf.checkpoint, conf.policy, conf.against) == (("x",), ("random", "a:b"), ("go_to_goal",))


def test_own_folders_add_options(tmp_path: Path) -> None:
    (tmp_path / "world").mkdir()
    (tmp_path / "world" / "icy.yaml").write_text("name: flat\nfriction: 0.1\n")
    assert compose(Conf, ["+world=icy"], [str(tmp_path)]).world == FlatConf(friction=0.1)
    with pytest.raises(ConfigError, match="there is no world 'icy'"):
        compose(Conf, ["+world=icy"])
    with pytest.raises(ConfigError, match=r"there is no folder .*absent to read"):
        compose(Conf, ["+world=icy"], [str(tmp_path / "absent")])


def test_composing_leaves_a_callers_hydra_alone() -> None:
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        before = GlobalHydra.instance().hydra
        compose(Conf, ["+world=flat"])
        assert before is not None
        assert GlobalHydra.instance().is_initialized()
        assert hydra.compose("train", ["+world=flat"]).world.name == "flat"
    GlobalHydra.instance().clear()
    assert HydraConfig.instance().cfg is None or not GlobalHydra.instance().is_initialized()


def test_a_broken_file_of_the_user_is_named(tmp_path: Path) -> None:
    (tmp_path / "world").mkdir()
    (tmp_path / "world" / "mine.yaml").write_text("name: flat\nname: flat\n")
    with pytest.raises(ConfigError, match=r"no valid YAML: .*mine\.yaml.*duplicate key name") as caught:
        compose(Conf, ["+world=mine"], [str(tmp_path)])
    assert "\n" not in str(caught.value)


HARD = ['a"b', "a\\", 'a\\"b\\', "2024_01", "1e3", "Null", "-1.5", "true", "../a", "/b/1", "1/2", "~/a"]


@pytest.mark.parametrize("text", ["a/b-1.sdf", "my yärd/w.sdf", "a,b=[c]", "it's", *HARD])
def test_a_text_is_quoted_as_hydra_reads_it(text: str) -> None:
    assert override_value([text_word("world.path", text)], "world.path") == text
    assert override_value(shlex.split(typed_word("world.path", text)), "world.path") == text


@pytest.mark.parametrize("text", ["a/b-1.sdf", "my yärd/w.sdf", "it's", "a=b", ""])
def test_a_text_in_quotes_is_read_without_hydra(text: str) -> None:
    for word in (f"out={text}", text_word("out", text), f"out='{text}'"):
        assert split_word(word) == ("out", "=", text)
    for hard in HARD:
        assert split_word(text_word("out", hard)) == ("out", "=", hard)
    assert split_word("run") == ("run", "", "") and split_word('a="') == ("a", "=", '"')
