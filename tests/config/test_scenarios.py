"""Scenarios, `scenario=NAME`, and lists of actors: they compose, give way to what is set beside, and run."""

from pathlib import Path

import numpy as np
import pytest

import dune_rl
from dune_rl.commands.pages import option_group_rows
from dune_rl.config.commands import BenchmarkConf, EvaluateConf, ViewConf
from dune_rl.config.compose import check_sweep, compose, compose_environment
from dune_rl.config.schema import Conf, EnvConf
from dune_rl.core import paths
from dune_rl.core.errors import ConfigError
from dune_rl.learning.checkpoint import read_checkpoint_file

SCENARIOS = sorted(path.stem for path in paths.conf_folder().glob("scenario/*.yaml"))
# The groups of each, with the kinds of their bodies.
GROUPS = {
    "crossing": {"walker": "person"},
    "crowd": {"walker": "person", "child": "person"},
    "farm": {"herd": "animal", "cow": "animal", "tractor": "vehicle"},
    "site_traffic": {"truck": "vehicle", "car": "vehicle", "walker": "person"},
}
RUN = Path(__file__).parents[2] / "experiments" / "inspection" / "policy.pt"


def counts(conf: EnvConf) -> dict[str, int]:
    """The numbers of agents by group, without the robot."""
    return {group.name: group.count for group in conf.groups if group.name != "rover"}


@pytest.mark.slow(all_but=["crossing"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_scenario_starts_and_steps(scenario: str) -> None:
    env = dune_rl.parallel_env(scenario=scenario, seed=5, sensors=["goal", "nearest_agent"])
    try:
        kinds = {group.name: getattr(group.body.conf, "kind", "") for group in env.simulation.groups[1:]}
        assert kinds == GROUPS[scenario]
        env.reset(seed=5)
        start = {name: env.simulation.state.groups[name].motion.position_w.copy() for name in kinds}
        # Nobody crosses the way of a robot that stands.
        ahead = env.action_space("rover_0").high * np.array([1.0, 0.0], np.float32)
        for _ in range(40):
            env.step({"rover_0": ahead})
        for name, before in start.items():
            after = env.simulation.state.groups[name].motion.position_w
            assert np.linalg.norm(after - before, axis=1).max() > 0.2, name
    finally:
        env.close()


@pytest.mark.slow
def test_every_command_takes_a_scenario() -> None:
    composed = [
        compose(Conf, ["scenario=farm"]),
        compose(Conf, ["+scenario=farm"]),
        compose(ViewConf, ["scenario=farm"]),
        compose(BenchmarkConf, ["scenario=farm"]),
        compose(EvaluateConf, ["scenario=farm", "policy=random"]),
        compose_environment(None, (), {"scenario": "farm"}),
    ]
    for conf in composed:
        assert conf.world == composed[0].world
        assert conf.actors == composed[0].actors
    assert counts(composed[0]) == {"herd": 8, "cow": 4, "tractor": 1}


def test_the_world_is_inspection_without_a_scenario() -> None:
    assert compose_environment(None).world.name == "inspection"
    assert compose(BenchmarkConf, []).world.name == "inspection"
    assert compose(BenchmarkConf, ["world.seed=4"]).world.seed == 4
    assert compose_environment("flat", (), {"scenario": "crossing"}).world.name == "flat"


@pytest.mark.slow
def test_what_is_set_beside_a_scenario_wins() -> None:
    conf = compose(Conf, ["scenario=farm", "world.size_m=60", "actors.herd.count=3", "actors=[herd,dogs]"])
    assert conf.world.size_m == 60.0
    assert counts(conf) == {"herd": 3, "dog": 2}
    assert counts(compose(Conf, ["actors=none", "scenario=site_traffic"])) == {}
    assert (
        compose(Conf, ["scenario=site_traffic", "task.spawn.region=anywhere"]).task.spawn.region == "anywhere"
    )
    with pytest.raises(ConfigError, match=r"^actors\.car\.body is missing; give it a value$"):
        compose(Conf, ["scenario=site_traffic", "actors=none", "actors.car.count=2"])


@pytest.mark.slow
def test_a_scenario_changes_the_settings_of_a_run() -> None:
    saved = read_checkpoint_file(RUN, "policy")["config"]
    plain = compose(EvaluateConf, ["checkpoint=run"], (), saved)
    conf = compose(EvaluateConf, ["checkpoint=run", "scenario=site_traffic", "actors.car.count=2"], (), saved)
    assert counts(conf) == {"truck": 2, "car": 2, "walker": 5}
    assert conf.task.rewards == plain.task.rewards
    assert conf.sensors == plain.sensors
    assert conf.task.spawn.region == (-7.0, 19.0, -20.0, 6.0)


@pytest.mark.slow
def test_scenarios_sweep() -> None:
    assert check_sweep(["scenario=crossing,farm", "seed=1,2"]) == ["+scenario=crossing,farm", "seed=1,2"]


@pytest.mark.slow
@pytest.mark.parametrize("actors", ["[walkers,cars,herd]", ["walkers", "cars", "herd"]])
def test_lists_of_actors_compose(actors: str | list[str]) -> None:
    assert counts(compose_environment("flat", (), {"actors": actors})) == {"walker": 2, "car": 2, "herd": 8}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["scenario=farms"], "there is no scenario 'farms'; choose crossing, crowd, farm or site_traffic"),
        (["+world=flat", "actors=[walkers,crs]"], "there are no actors 'crs'; did you mean cars?"),
        (
            ["+world=flat", "actors=[orca,crossing]"],
            "actors: orca and crossing are both of a group walker; leave one of them out, and add its group "
            "by another name: '+actors.NAME={body: person, count: 2, controller: crossing}'",
        ),
        (
            ["+world=flat", "actors=[cars,walkers,cars]"],
            "actors: cars is listed more than once; list it once, and for more of them set actors.car.count",
        ),
        (
            ["scenario=[farm,crowd]"],
            "scenario must be the name of an option: choose crossing, crowd, farm or site_traffic, or leave "
            "it out",
        ),
        (
            ["scenario=farm", "+experiment=quick"],
            "scenario=farm and +experiment=quick both choose a world: leave one of them out",
        ),
        (
            ["scenario=farm", "agents={rover: {body: rover_zero}}"],
            "agents takes the place of the actors of the scenario: leave one of the two out, or add groups "
            "with +actors.NAME={...}",
        ),
    ],
)
def test_faults_are_named(words: list[str], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        compose(Conf, words)
    assert str(caught.value) == message


@pytest.mark.parametrize("scenario", [3, True, ["farm", "crowd"], {"name": "farm"}])
def test_a_scenario_in_python_is_a_name(scenario: object) -> None:
    with pytest.raises(ConfigError, match="scenario must be the name of an option"):
        compose_environment(None, (), {"scenario": scenario})


def test_no_scenario_in_python_is_none() -> None:
    assert compose_environment(None, (), {"scenario": None}).world.name == "inspection"


def test_visitors_come_before_the_episode_ends() -> None:
    words = ["+world=flat", "actors=walkers", "task.terminations.time_limit.max_steps=200"]
    compose(Conf, [*words, "actors.walker.presence={arrive_s: [9, 90]}"])
    with pytest.raises(ConfigError) as caught:
        compose(Conf, [*words, "actors.walker.presence={arrive_s: [10, 90]}"])
    assert str(caught.value) == (
        "actors.walker.presence.arrive_s: episodes end after 10 s, before anybody comes (from 10 s on); let "
        "them come earlier, or raise task.terminations.time_limit.max_steps"
    )


def test_the_help_lists_scenarios() -> None:
    assert ("scenario=NAME", ", ".join(SCENARIOS)) in option_group_rows()


@pytest.mark.slow
def test_a_scenario_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "scenario").mkdir()
    (tmp_path / "scenario" / "yard.yaml").write_text(
        "# @package _global_\n"
        "defaults:\n  - /world: inspection\n  - override /actors: [pedestrians, dogs]\n\n"
        "actors:\n  dog:\n    count: 1\n"
    )
    conf = compose(Conf, ["scenario=yard"], [str(tmp_path)])
    assert counts(conf) == {"walker": 5, "dog": 1}
    assert (
        compose_environment(None, (), {"scenario": "yard"}, config_dirs=[str(tmp_path)]).actors == conf.actors
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "world"), [("farm", "rubicon"), ("crowd", "inspection"), ("farm", "inspection")]
)
def test_another_world_takes_what_it_knows_of_a_scenario(name: str, world: str) -> None:
    conf = compose(Conf, [f"+world={world}", f"scenario={name}"])
    assert conf.world.name == world
    in_python = compose_environment(None, (), {"scenario": name, "world": world})
    assert in_python.world == conf.world


def test_settings_that_another_world_lacks_are_named_where_they_are_given() -> None:
    with pytest.raises(ConfigError, match=r"world\.size_m is not a setting"):
        compose(Conf, ["+world=rubicon", "scenario=farm", "world.size_m=30"])
