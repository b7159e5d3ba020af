"""Agent groups in the configuration: explicit ones, and those that the shorthands stand for."""

from pathlib import Path
from typing import Any

import pytest

from dune_rl.behaviours.paths.follower import PathConf
from dune_rl.bodies.person import PersonConf
from dune_rl.config.agents import ResolvedGroup, walker_sensors
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose, compose_environment
from dune_rl.config.controllers import FrozenPolicyConf
from dune_rl.config.schema import Conf, EnvConf, SingleAgentConf
from dune_rl.core.errors import ConfigError
from dune_rl.metrics.episode import MetricsConf
from dune_rl.robots.leo_rover import LeoRoverConf
from dune_rl.robots.rover_zero import RoverZeroConf
from dune_rl.tasks.task import TaskConf, walking_task

TEAM = (
    "agents={rover: {body: rover_zero, count: 3, controller: external, task: paper}, "
    "walker: {body: person, count: 5, controller: path}}"
)


def groups_of(*words: str, **settings: Any) -> dict[str, ResolvedGroup]:
    groups = compose_environment("flat", words, settings).groups
    assert len({group.name for group in groups}) == len(groups)
    return {group.name: group for group in groups}


def fault(*words: str, **settings: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        compose_environment("flat", words, settings)
    return str(caught.value)


def summary(groups: dict[str, ResolvedGroup]) -> dict[str, tuple[int, object]]:
    return {name: (group.count, group.controller) for name, group in groups.items()}


def test_groups_on_the_command_line() -> None:
    groups = groups_of(TEAM)
    assert summary(groups) == {"rover": (3, "external"), "walker": (5, "path")}
    assert groups["rover"].agents == ("rover_0", "rover_1", "rover_2")
    assert groups["rover"].task == compose_environment("flat", ["task=paper"]).task
    assert groups["walker"].body == PersonConf()
    assert groups["walker"].path == PathConf()


def test_groups_in_python_and_in_a_file_are_the_same(tmp_path: Path) -> None:
    rover = {"body": "rover_zero", "count": 3, "controller": "external", "task": "paper"}
    walker = {"body": "person", "count": 5, "controller": "path"}
    (tmp_path / "agents").mkdir()
    (tmp_path / "agents" / "team.yaml").write_text(f"rover: {rover}\nwalker: {walker}\n")
    by_words = compose_environment("flat", [TEAM])
    assert compose_environment("flat", (), {"agents": {"rover": rover, "walker": walker}}) == by_words
    assert compose_environment("flat", ["agents=team"], config_dirs=[str(tmp_path)]) == by_words
    # As Python objects, too.
    assert EnvConf.model_validate(by_words.model_dump(mode="json")) == by_words


def test_the_default_is_one_rover_and_two_walkers_on_paths() -> None:
    assert summary(groups_of()) == {"rover": (1, "external"), "walker": (2, "path")}
    assert summary(groups_of("robot=leo_rover", "actors=none")) == {"leo_rover": (1, "external")}
    groups = groups_of("actors=external_walkers")
    assert summary(groups) == {"rover": (1, "external"), "walker": (2, "external")}
    assert (groups["walker"].task, groups["walker"].sensors) == (walking_task(), walker_sensors())
    assert groups["walker"].metrics == MetricsConf()


def test_equal_robots_are_one_group() -> None:
    robots = [
        "rover_zero",
        "leo_rover",
        {"name": "rover_zero"},
        {"name": "rover_zero", "wheel_friction": 0.8},
    ]
    groups = groups_of("actors=none", robots=robots)
    assert summary(groups) == {
        "rover": (2, "external"),
        "leo_rover": (1, "external"),
        "rover_b": (1, "external"),
    }
    assert groups["rover_b"].body == RoverZeroConf(wheel_friction=0.8)
    bodies = [group.body for group in compose_environment("flat", ["robots=[rover_zero,leo_rover]"]).groups]
    assert bodies[:2] == [RoverZeroConf(), LeoRoverConf()]


def test_actors_change_by_their_names() -> None:
    groups = groups_of("actors.walker.count=4", "actors.walker.body.speed_mps=0.5")
    assert (groups["walker"].count, groups["walker"].body) == (4, PersonConf(speed_mps=0.5))
    groups = groups_of(actors={"walker": {"count": 3}, "dog": {"body": "hyperdog"}})
    assert summary(groups) == {"rover": (1, "external"), "walker": (3, "path"), "dog": (1, "external")}


def test_sections_of_a_group() -> None:
    conf = compose_environment(
        "flat",
        ["task.terminations.time_limit.max_steps=77", "sensors.lidar.n_beams=64"],
        {
            "agents": {
                "rover": {"body": "rover_zero"},
                "blind": {"body": "leo_rover", "sensors": ["goal", "velocity"]},
                "eager": {
                    "body": {"name": "rover_zero", "wheel_friction": 0.5},
                    "task": {"name": "paper", "rewards": {"goal": {"weight": 7.0}, "heading": None}},
                    "metrics": {"name": "paper", "energy": True},
                },
                "husky": {"body": "leo_rover", "controller": {"checkpoint": "runs/x"}},
            }
        },
    )
    rover, blind, eager, husky = conf.groups
    assert (rover.sensors, rover.task, rover.metrics) == (conf.sensors, conf.task, conf.metrics)
    assert blind.sensors is not None and list(blind.sensors) == ["goal", "velocity", "lidar"]
    assert not blind.sensors["lidar"].observed and blind.sensors["lidar"].n_beams == 64  # type: ignore[attr-defined]
    assert blind.task == conf.task
    assert eager.body == RoverZeroConf(wheel_friction=0.5)
    assert eager.task is not None and eager.metrics is not None
    assert "heading" not in eager.task.rewards
    assert (eager.task.rewards["goal"].weight, eager.task.rewards["contact"].weight) == (7.0, 0.0)
    assert eager.metrics.energy
    assert husky.controller == FrozenPolicyConf(checkpoint="runs/x")
    assert husky.task is not None
    assert (husky.task.rewards, husky.metrics) == ({}, None)
    assert [(name, term.renew) for name, term in husky.task.terminations.items()] == [("goal_reached", True)]


def test_sections_of_a_group_without_a_name_change_what_it_has_otherwise() -> None:
    words = ["task=paper", "task.spawn.margin_m=0.3", "metrics.energy=true"]
    changes = {
        "sensors": {"lidar": {"n_beams": 64}},
        "task": {"rewards": {"velocity": {"weight": 2.0}}, "terminations": {"time_limit": None}},
        "metrics": {"terms": {"vort": None}},
    }
    groups = {
        "rover": {"body": "rover_zero"} | changes,
        "scout": {"body": "leo_rover", "controller": "go_to_goal", "task": {"spawn": {"margin_m": 0.4}}},
        "walker": {
            "body": "person",
            "controller": "external",
            "task": {"rewards": {"progress": {"weight": 3}}},
        },
    }
    conf = compose_environment("flat", words, {"agents": groups})
    rover, scout, walker = conf.groups
    assert rover.sensors is not None and rover.sensors["lidar"].n_beams == 64  # type: ignore[attr-defined]
    assert list(rover.sensors) == list(conf.sensors)
    assert rover.task is not None and rover.metrics is not None
    assert list(rover.task.rewards) == list(conf.task.rewards)
    assert (rover.task.rewards["velocity"].weight, rover.task.rewards["contact"].weight) == (2.0, 0.0)
    assert rover.task.spawn == conf.task.spawn
    assert {*conf.task.terminations} - {*rover.task.terminations} == {"time_limit"}
    assert rover.metrics.energy and {*conf.metrics.terms} - {*rover.metrics.terms} == {"vort"}
    assert scout.task is not None and scout.task.spawn.margin_m == 0.4
    assert (scout.task.rewards, [*scout.task.terminations]) == ({}, ["goal_reached"])
    assert scout.task.terminations["goal_reached"].renew
    assert walker.task is not None and walker.sensors == walker_sensors()
    assert {name: term.weight for name, term in walker.task.rewards.items()} == {
        "progress": 3.0,
        "near_miss": -0.1,
    }
    again = compose(EvaluateConf, ["policy=random"], (), conf.model_dump(mode="json"))
    assert again.groups == conf.groups


def test_settings_of_a_run_with_groups_stay() -> None:
    words = [TEAM, "agents.rover.task={name: paper, rewards: {heading: null}}"]
    saved = compose_environment("flat", words).model_dump(mode="json")
    again = compose(EvaluateConf, ["policy=random"], (), saved)
    assert again.groups == compose_environment("flat", words).groups
    changed = compose(EvaluateConf, ["policy=random", "agents.walker.count=1"], (), saved)
    assert [group.count for group in changed.groups] == [3, 1]
    other = compose(EvaluateConf, ["policy=random", "agents={rover: {body: leo_rover}}"], (), saved)
    assert [group.name for group in other.groups] == ["rover"]


@pytest.mark.parametrize(
    ("agents", "said"),
    [
        ({"a": {"body": "rover_zro"}},
         "agents.a.body: there is no body 'rover_zro'; did you mean rover_zero?"),
        ({"a": {"body": {"wheel_friction": 1.0}}},
         "agents.a.body: name must be the name of a robot: hyperdog, leo_rover, rover_zero or urdf"),
        ({"a": {"body": {"name": "leo_rover", "wheel_friction": 9}}},
         "agents.a.body.wheel_friction must be at most 3.0 (got 9)"),
        ({"a": {"body": {"name": "person", "hight_m": 1}}},
         "agents.a.body.hight_m is not a setting; did you mean agents.a.body.height_m?"),
        ({"a": {"body": "rover_zero", "conut": 2}},
         "agents.a.conut is not a setting; did you mean agents.a.count?"),
        ({"a": {"body": "rover_zero", "count": 0}}, "agents.a.count must be at least 1 (got 0)"),
        ({"a": {"count": 2}}, "agents.a.body is missing; give it a value"),
        ({"rover": {"body": "rover_zero"}, "rovr": {"count": 2}},
         "agents.rovr.body is missing; give it a value; or did you mean agents.rover?"),
        ({"a": {"body": "rover_zero", "controller": "extern"}},
         "agents.a.controller: there is no controller 'extern'; did you mean external?"),
        ({"a": {"body": "rover_zero", "controller": {"checkpoint": ""}}},
         "agents.a.controller.checkpoint must be text that is not empty (got '')"),
        ({"a": {"body": "rover_zero", "task": "papper"}},
         "agents.a.task: there is no task 'papper'; did you mean paper?"),
        ({"a": {"body": "rover_zero", "sensors": {"lidar": {"n_beam": 5}}}},
         "agents.a.sensors.lidar.n_beam is not a setting; did you mean agents.a.sensors.lidar.n_beams?"),
        ({"a": {"body": "rover_zero", "task": {"rewards": {"distanc": {}}}}},
         "agents.a.task.rewards.distanc: there is no reward 'distanc' (is the package that brings it "
         "installed?); did you mean distance?"),
        ({"a": {"body": "rover_zero", "controller": "path"}},
         "agents.a: paths are walked by persons, and the body is rover_zero: choose another controller, and "
         "leave path out"),
        ({"a": {"body": "rover_zero"}, "b": {"body": "person", "controller": "path", "task": "walking"}},
         "agents.b: task: agents that are moved along a path or a trajectory earn nothing and end no "
         "episode: leave task out (null), or write controller: external"),
        ({"a": {"body": "rover_zero", "sensors": {"near": {"sensor": "nearest_agent", "groups": ["b"]}}}},
         "agents.a.sensors.near.groups: there is no group 'b'; choose a"),
        ({"a": {"body": "rover_zero",
                "metrics": {"terms": {"x": {"term": "ended_by", "termination": "stuk"}}}}},
         "metrics.terms.x.termination: there is no termination 'stuk'; did you mean stuck?"),
        ({"a": {"body": {"name": "urdf", "path": "car.urdf", "drive": {"kind": "ackermann"}},
                "controller": "orca"}},
         "agents.a: controller orca is for bodies that move as holonomic or unicycle, and urdf is bicycle: "
         "choose another controller, or the body person, child, cow, sheep or dog"),
        ({"a": {"body": "rover_zero"},
          "b": {"body": "person", "controller": {"name": "follow", "target": "c"}}},
         "agents.b.controller.target: there is no group 'c'; choose robots, a or b"),
        ({"a": {"body": "rover_zero"},
          "b": {"body": "person", "controller": {"name": "orca", "reaction": "angry"}}},
         "agents.b.controller.reaction must be one of regular, impassive, surprised, curious, scared, "
         "threatening (got 'angry')"),
        ({"a": {"body": "rover_zero"}, "b": {"body": "person", "controller": "patrol"}},
         "agents.b.controller: patrol needs places; write controller: {name: patrol, places: ...}"),
        ({"a": {"body": "rover_zero"}, "b": {"body": "person", "controller": {"name": "patrol"}}},
         "agents.b.controller.places is missing; give it a value"),
        ({"a": {"body": "rover_zero"},
          "b": {"body": "person", "controller": {"name": "random_waypoint", "pause_s": [3, 1]}}},
         "agents.b.controller.pause_s: give the least, at least 0, and then the greatest (got [3.0, 1.0])"),
        ({"a": {"body": "rover_zero"},
          "b": {"body": "person", "controller": "path", "path": {"mode": "loop"}}},
         "agents.b.path: mode=loop needs three waypoints or more (got 0): give them, or take "
         "mode=back_and_forth"),
        ({"a b": {"body": "rover_zero"}},
         "agents: a group cannot be called 'a b': take letters, digits and _, a letter first"),
        ({"done": {"body": "rover_zero"}},
         "agents: a group cannot be called 'done', which is a key of TorchRL's"),
        ({"a": {"body": "person", "controller": "path"}},
         "no agent group is external; set the controller of one to external, such as "
         "agents.a.controller=external"),
        ({}, "agents must be a section with at least one entry (got {})"),
    ],
)  # fmt: skip
def test_faults_of_groups(agents: dict[str, Any], said: str) -> None:
    assert fault(agents=agents) == said


def test_groups_take_the_place_of_the_shorthands() -> None:
    assert fault(TEAM, "robot=leo_rover") == "agents takes the place of robot; leave one of them out"
    assert fault(TEAM, actors="walkers") == "agents takes the place of actors; leave one of them out"
    both = "robots takes the place of robot; leave one of them out"
    assert fault("robots=[rover_zero]", "robot=leo_rover") == both
    assert fault(robots=["rover_zero"], robot="leo_rover") == both


def test_all_groups_are_trained_and_gymnasium_has_one_agent() -> None:
    assert compose(Conf, ["+world=flat", TEAM]).driven_group.name == "rover"
    both = compose(
        Conf, ["+world=flat", "robots=[rover_zero,leo_rover]", "learning.groups.rover.frozen=runs/a"]
    )
    assert both.driven_group.name == "leo_rover"
    several = compose(Conf, ["+world=flat", "+experiment=multi_agent"])
    assert [group.name for group in several.external_groups] == ["rover", "walker"]
    assert several.learning.of_group("walker").hidden == (128, 128)
    assert several.learning.of_group("rover") is several.learning
    with pytest.raises(ConfigError, match="Gymnasium has one agent, and rover has 3; take"):
        compose_environment("flat", [TEAM], None, SingleAgentConf)


def test_sensors_of_every_group_are_checked() -> None:
    realism = {"rate_hz": 3.0}
    said = fault(agents={"a": {"body": "rover_zero", "sensors": {"lidar": {"realism": realism}}}})
    assert said.startswith("agents.a.sensors.lidar.realism: ")


def test_the_task_of_a_group_has_defaults_of_its_own() -> None:
    groups = groups_of(agents={"a": {"body": "rover_zero", "task": {"spawn": {"margin_m": 0.5}}}})
    assert groups["a"].task == TaskConf.model_validate({"spawn": {"margin_m": 0.5}})


def test_a_broken_option_of_the_user_is_named(tmp_path: Path) -> None:
    (tmp_path / "task").mkdir()
    (tmp_path / "task" / "mine.yaml").write_text("defaults:\n  - absent\n  - _self_\n")
    agents = {"rover": {"body": "rover_zero", "task": "mine"}}
    with pytest.raises(ConfigError, match=r"cannot compose the settings: In 'task/mine': .*'task/absent'"):
        compose_environment("flat", (), {"agents": agents}, config_dirs=[str(tmp_path)])


def test_faults_of_controllers_names_and_word_lists_say_what_to_write() -> None:
    person = {"body": "person"}
    for key, told in (
        ("speed_mps", "the controller path has no settings, and speed_mps is none; write controller: path"),
        ("check_point", "and check_point is none; did you mean checkpoint?"),
    ):
        assert told in fault(agents={"walker": {**person, "controller": {"name": "path", key: "x"}}})
    assert "{checkpoint: PATH}" in fault(agents={"walker": {**person, "controller": {"speed_mps": 1.0}}})
    assert "agent groups have names, not numbers" in fault(agents={3: person})
    with pytest.raises(ConfigError, match="are lists of strings"):
        compose_environment("flat", "seed=1")
    with pytest.raises(ConfigError, match="are lists of strings"):
        compose_environment("flat", config_dirs="my")


def test_a_robot_has_no_count() -> None:
    with pytest.raises(ConfigError, match=r"write agents\.leo_rover\.count=2, for others a list"):
        compose_environment("flat", ["robot=leo_rover", "robot.count=2"])
