"""Settings under their older names, in overrides, in Python and in the settings of older runs."""

import warnings
from pathlib import Path
from typing import Any

import pytest
import yaml

from dune_rl.config.compose import compose, compose_environment, compose_evaluation
from dune_rl.config.migration import migrated
from dune_rl.config.renaming import RENAMED, rename_in_section
from dune_rl.config.schema import EnvConf
from dune_rl.core.errors import ConfigError, DuneWarning
from dune_rl.tasks.task import TaskConf

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
OLD_TASK: dict[str, Any] = {
    "spawn": {"region": "anywhere", "max_slope_deg": 20.0, "margin_m": 0.1, "min_goal_distance_m": 2.0},
    "reward": {
        "alpha": 2.0,
        "distance_scale": 0.4,
        "min_progress_m": 0.001,
        "signed_progress": True,
        "heading_limit_rad": 1.2566370614359172,
        "misaligned": -0.03,
        "heading_bonus": 0.02,
        "velocity_scale": 0.003,
        "turn_scale": 0.0015,
        "goal": 90.0,
        "collision": -0.6,
        "collision_distance_m": 0.3,
        "contact": -9.0,
        "stuck": -25.0,
        "flipped": -20.0,
        "out_of_world": -10.0,
    },
    "termination": {
        "goal_distance_m": 0.5,
        "max_steps": 1500,
        "stuck_distance_m": 0.001,
        "stuck_steps": 600,
        "flipped_rad": 1.4835298641951802,
        "continue_after_goal": True,
    },
    "walking": {"progress_scale": 1.0, "near_miss": -0.1, "comfort_m": 1.2},
}
NEW_TASK = TaskConf().with_terms(
    spawn={"region": "anywhere", "max_slope_deg": 20.0, "margin_m": 0.1, "min_goal_distance_m": 2.0},
    rewards={
        "distance": {
            "weight": 2.0,
            "scale": 0.4,
            "min_progress_m": 0.001,
            "signed": True,
            "heading_limit_deg": 72.0,
            "misaligned": -0.03,
        },
        "heading": {"weight": 2.0, "bonus": 0.02},
        "velocity": {"speed_scale": 0.003, "turn_scale": 0.0015},
        "goal": {"weight": 90.0},
        "collision": {"weight": -0.6, "distance_m": 0.3},
        "contact": {"weight": -9.0},
        "stuck": {"weight": -25.0},
        "flipped": {"weight": -20.0},
        "out_of_world": {"weight": -10.0},
    },
    terminations={
        "goal_reached": {"distance_m": 0.5, "renew": True},
        "stuck": {"distance_m": 0.001, "steps": 600},
        "flipped": {"angle_deg": 85.0},
        "time_limit": {"max_steps": 1500},
    },
)


def test_the_task_of_an_older_run_is_the_same_task() -> None:
    saved = compose_environment("flat").model_dump(mode="json") | {"task": OLD_TASK}
    conf = compose_evaluation(["policy=random"], (), saved)
    assert conf.task == NEW_TASK
    changed = compose_evaluation(["policy=random", "task.terminations.time_limit.max_steps=5"], (), saved)
    assert changed.task == NEW_TASK.with_terms(terminations={"time_limit": {"max_steps": 5}})


@pytest.mark.parametrize("file", sorted(EXPERIMENTS.rglob("config.yaml")), ids=lambda file: file.parent.name)
def test_settings_of_the_studies_are_read(file: Path) -> None:
    saved = yaml.safe_load(file.read_text())
    conf = compose_evaluation(["policy=random"], (), saved)
    walkers = len(saved["actors"]) if isinstance(saved["actors"], list) else None
    assert walkers is None or sum(group.count for group in conf.groups) == 1 + walkers
    assert conf.external_groups[0].name == "rover"
    # Sets with far goals give three times as long.
    steps = 6000 if file.parent.name.endswith("-site-v1") else 2000
    assert conf.task.terminations["time_limit"].max_steps == steps  # type: ignore[attr-defined]
    # Warnings are errors here: nobody is warned of what a run states that they did not write.


def test_metrics_and_walkers_of_an_older_run() -> None:
    saved = compose_environment("flat").model_dump(mode="json")
    saved["metrics"] = {"max_clearance_m": 8.0, "uneven_tilt_rad": 0.08726646259971647, "energy": True}
    saved["task"] = OLD_TASK | {"walking": {"progress_scale": 2.0, "near_miss": -0.1, "comfort_m": 1.5}}
    saved["actors"] = [
        {"kind": "walker", "controller": "external"},
        {"kind": "walker", "controller": "scripted"},
    ]
    conf = EnvConf.model_validate(migrated(saved))
    terms = conf.metrics.model_dump()["terms"]
    assert [terms[name]["max_m"] for name in ("clearance", "min_clearance")] == [8.0, 8.0]
    assert [terms[name]["initial"] for name in ("clearance", "min_clearance")] == [8.0, 8.0]
    assert (terms["vort"]["uneven_tilt_deg"], conf.metrics.energy) == (5.0, True)
    rewards = conf.actors["walker"].task.model_dump()["rewards"]  # type: ignore[union-attr]
    assert (rewards["progress"]["weight"], rewards["near_miss"]["comfort_m"]) == (2.0, 1.5)
    assert conf.actors["walker_b"].task is None


def test_a_robot_of_an_older_run_keeps_its_drive(tmp_path: Path) -> None:
    words = ["robot=urdf", "robot.path=car.urdf"]
    saved = compose_environment("flat", words).model_dump(mode="json")
    assert migrated(saved) == saved

    def older(robot: dict[str, Any]) -> None:
        del robot["drive"]["kind"], robot["steering_joints"], robot["free_joints"]

    bodies = [group["body"] for group in saved["agents"].values()] if saved.get("agents") else []
    bodies += [saved["robot"]] if isinstance(saved.get("robot"), dict) else []
    assert bodies
    for body in bodies:
        older(body)
    conf = EnvConf.model_validate(migrated(saved))
    (group,) = conf.external_groups
    assert (group.body.drive.kind, group.body.free_joints) == ("skid_steer", ())  # type: ignore[union-attr]


def test_older_names_are_accepted_and_warned_of() -> None:
    words = ["task.reward.goal=50", "task.termination.flipped_rad=1.0"]
    with pytest.warns(DuneWarning) as told:
        conf = compose(["+world=flat", *words])
    assert [str(each.message) for each in told] == [
        "task.reward.goal is now task.rewards.goal.weight",
        "task.termination.flipped_rad is now task.terminations.flipped.angle_deg",
    ]
    assert conf.task == TaskConf().with_terms(
        rewards={"goal": {"weight": 50.0}}, terminations={"flipped": {"angle_deg": 57.295779513}}
    )
    with pytest.warns(DuneWarning, match="metrics.max_clearance_m is now metrics.terms.clearance.max_m and"):
        compose_environment("flat", (), {"metrics": {"max_clearance_m": 5.0}})
    with pytest.warns(DuneWarning, match=r"task\.walking is now actors\.walker\.task\.rewards"):
        conf = compose_environment("flat", ["actors=external_walkers", "task.walking.near_miss=-0.5"])
    assert conf.groups[1].task.rewards["near_miss"].weight == -0.5  # type: ignore[union-attr]


@pytest.mark.parametrize("there", [None, "paper", 3])
def test_an_older_name_beside_what_is_no_section(there: Any) -> None:
    task = {"reward": {"goal": 5.0}, "rewards": there}
    rename_in_section("task", task, "task", warn=False)
    assert task["rewards"] == {"goal": {"weight": 5.0}}


def test_the_length_of_an_episode_keeps_its_name() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        by_words = compose_environment("flat", ["task.termination.max_steps=50"])
        by_settings = compose_environment("flat", (), {"task": {"termination": {"max_steps": 50}}})
    assert (
        by_words == by_settings == compose_environment("flat", ["task.terminations.time_limit.max_steps=50"])
    )


@pytest.mark.filterwarnings("ignore::dune_rl.core.errors.DuneWarning")
def test_faults_under_an_older_name() -> None:
    with pytest.raises(ConfigError) as caught:
        compose(["+world=flat", "task.reward.gaol=1", "task.termination.max_steps=0"])
    assert sorted(str(caught.value).splitlines()) == [
        "task.reward is not a setting; did you mean task.rewards?",
        "task.terminations.time_limit.max_steps must be at least 1 (got 0)",
    ]


@pytest.mark.parametrize("section", sorted(RENAMED))
def test_every_new_name_is_a_setting(section: str) -> None:
    # Robots and worlds have settings of their own.
    robots = ("rover_zero", "hyperdog") if section == "robot" else ("rover_zero",)
    world = "construction" if section == "world" else "flat"
    stated = [compose([f"+world={world}", f"robot={robot}"]).model_dump()[section] for robot in robots]
    for renaming in RENAMED[section]:
        for new in renaming.new:
            assert any(_has_path(data, new.split(".")) for data in stated), f"{section}.{new}"


def _has_path(data: Any, path: list[str]) -> bool:
    for part in path:
        if not isinstance(data, dict) or part not in data:
            return False
        data = data[part]
    return True


def test_an_older_name_of_a_world_s_setting_is_read() -> None:
    with pytest.warns(DuneWarning, match=r"world.things_per_100m2 is now world.props_per_100m2"):
        conf = compose_environment("construction", ["world.things_per_100m2=1.5"])
    assert conf.world.model_dump()["props_per_100m2"] == 1.5
    saved = conf.model_dump(mode="json")
    saved["world"]["things_per_100m2"] = saved["world"].pop("props_per_100m2")
    assert compose_evaluation(["policy=random"], (), saved).world == conf.world
