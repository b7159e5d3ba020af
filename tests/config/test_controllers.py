"""Behaviours and trained policies that drive groups, as they are configured."""

from pathlib import Path

import numpy as np
import pytest
import torch

from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose, compose_environment
from dune_rl.config.group_files import check_group_files, describe_owner, read_group_files
from dune_rl.config.schema import Conf
from dune_rl.core.errors import CheckpointError, WorldError
from dune_rl.env.simulation import VectorSimulation
from dune_rl.learning.checkpoint import VERSION, read_checkpoint_file
from dune_rl.worlds.world import World

POLICY = Path(__file__).parents[2] / "experiments" / "flat" / "seed1" / "policy.pt"


def simulation_of(controller: object, **sections: object) -> VectorSimulation:
    other = {"body": "rover_zero", "count": 2, "controller": controller} | sections
    conf = compose_environment("flat", (), {"agents": {"idle": {"body": "leo_rover"}, "other": other}})
    simulation = make_simulation(conf, 2, seed=4)
    simulation.reset(np.ones(2, bool))
    return simulation


def goal_distances(simulation: VectorSimulation, steps: int) -> np.ndarray:
    """Distance of each agent of the group `other` to its goal at every step, (steps, N)."""
    still = {"idle": np.zeros((2, 1, 2))}
    distances = []
    for _ in range(steps):
        simulation.step(still)
        distances.append(simulation.state.groups["other"].goal.distance.copy())
    return np.array(distances)


@pytest.mark.slow(all_but=["orca"])
@pytest.mark.parametrize(
    "controller",
    ["go_to_goal", {"name": "go_to_goal"}, "planner", "mppi", "orca", {"checkpoint": str(POLICY)}],
)
def test_a_group_drives_to_its_goals_by_itself(controller: object) -> None:
    simulation = simulation_of(controller)
    assert simulation.agents == ("idle_0",)
    distances = goal_distances(simulation, 160)
    assert (distances.min(axis=0) < distances[0] - 1.0).all()
    simulation.close()


@pytest.mark.slow(all_but=["*orca*"])
@pytest.mark.parametrize("controller", ["orca", "social_force", "herd", "random_waypoint"])
def test_people_with_a_behaviour_go_about_and_know_of_the_robot(controller: str) -> None:
    simulation = simulation_of(controller, body="person", count=3)
    people = simulation.state.groups["other"]
    around = simulation.state.surroundings
    assert around.is_robot.tolist() == [True, False, False, False]
    assert people.body.reach_m == pytest.approx(0.25) and around.reach_m[0] > 0.25
    goal_distances(simulation, 60)
    moved = simulation.state.groups["other"].motion.position_w - people.motion.position_w
    assert np.linalg.norm(moved, axis=1).max() > 0.3
    simulation.close()


def test_settings_of_a_behaviour_reach_it() -> None:
    slow = simulation_of({"name": "go_to_goal", "speed_mps": 0.1})
    distances = goal_distances(slow, 40)
    assert (distances[0] - distances[-1] < 0.3).all()
    slow.close()


def test_policies_that_are_not_there_are_named_at_once(tmp_path: Path) -> None:
    words = [
        "+world=flat",
        "+experiment=multi_agent",
        f"learning.groups.walker.frozen={tmp_path / 'a.pt'}",
        f"learning.start_from={tmp_path / 'c.pt'}",
        f"+actors.foe={{body: person, controller: {{checkpoint: {tmp_path / 'b.pt'}}}}}",
    ]
    with pytest.raises(CheckpointError) as error:
        check_group_files(compose(Conf, words))
    said = [line for line in str(error.value).splitlines() if "There is no" in line]
    assert said == [
        f"agents.foe.controller.checkpoint: There is no {tmp_path / 'b.pt'}.",
        f"learning.start_from: There is no {tmp_path / 'c.pt'}.",
        f"learning.groups.walker.frozen: There is no {tmp_path / 'a.pt'}.",
    ]
    check_group_files(compose(Conf, ["+world=flat", "+experiment=multi_agent"]))
    check_group_files(compose(Conf, ["+world=flat", f"actors.walker.controller={{checkpoint: {POLICY}}}"]))


@pytest.mark.slow
def test_a_policy_of_another_body_is_refused() -> None:
    with pytest.raises(CheckpointError, match=r"for another environment: .*lidar \(32 values\)") as error:
        simulation_of({"checkpoint": str(POLICY)}, sensors=["goal"])
    first, last = str(error.value).splitlines()
    assert first.startswith(f"agents.other.controller.checkpoint: {POLICY} was made for another environment")
    assert last == (
        "The policy is that of rover: write agents.other.body=rover_zero and agents.other.sensors=default, "
        "or take another checkpoint."
    )


@pytest.mark.slow
def test_sensors_that_differ_in_a_setting_alone_are_named() -> None:
    adversary = POLICY.parents[2] / "actors" / "adversaries_1" / "policy.pt"
    foe = {
        "body": "person",
        "path": {},
        "sensors": "actor",
        "controller": {"checkpoint": str(adversary), "group": "walker"},
    }
    conf = compose_environment("flat", (), {"actors": {"foe": foe}})
    with pytest.raises(CheckpointError, match=r"write .*foe\.body=person and .*foe\.sensors=adversary"):
        make_simulation(conf, 1, 0)


def test_a_file_without_the_groups_policy_names_those_that_it_has(tmp_path: Path) -> None:
    content = read_checkpoint_file(POLICY, "policy")
    groups = content["groups"]
    both = tmp_path / "both.pt"
    torch.save(
        {**content, "version": VERSION, "groups": {"rover": groups["rover"], "walker": groups["rover"]}}, both
    )
    foe = {"body": "person", "controller": {"checkpoint": str(both)}}
    with pytest.raises(CheckpointError) as error:
        check_group_files(compose_environment("flat", (), {"actors": {"foe": foe}}))
    assert str(error.value).splitlines() == [
        f"agents.foe.controller.checkpoint: {both} has no policy for the group foe, but for rover, walker.",
        "Set agents.foe.controller.group to rover or walker, after the one whose policy it is to play, or "
        "take another checkpoint.",
    ]
    foe["controller"] = {"checkpoint": str(both), "group": "rover"}
    check_group_files(compose_environment("flat", (), {"actors": {"foe": foe}}))
    foe["controller"] = {"checkpoint": str(POLICY), "group": "walker"}
    with pytest.raises(CheckpointError, match="has no policy for the group walker, but for rover"):
        check_group_files(compose_environment("flat", (), {"actors": {"foe": foe}}))


@pytest.mark.slow
def test_a_policy_is_played_by_a_group_of_another_name(tmp_path: Path) -> None:
    content = read_checkpoint_file(POLICY, "policy")
    rover = content["groups"]["rover"]
    network = {
        key: value * 0.0 if key.endswith(("weight", "bias")) else value
        for key, value in rover["policy"].items()
    }
    both = tmp_path / "both.pt"
    groups = {"rover": rover, "statue": {**rover, "policy": network}}
    torch.save({**content, "version": VERSION, "groups": groups}, both)
    progress = {}
    for name in groups:
        simulation = simulation_of({"checkpoint": str(both), "group": name})
        distances = goal_distances(simulation, 100)
        progress[name] = (distances[0] - distances[-1]).max()
        simulation.close()
    assert progress["rover"] > 1.0 > 0.5 > progress["statue"]


def test_missing_files_are_named_at_once_before_the_world_is_built(tmp_path: Path) -> None:
    (tmp_path / "two.csv").write_text("time_s,x_m\n0,1\n")
    files = [str(tmp_path / "one.sdf"), str(tmp_path / "two.csv")]
    actors = {
        "patrol": {"body": "person", "controller": {"trajectory": files}},
        "foe": {"body": "person", "controller": {"checkpoint": str(tmp_path / "three.pt")}},
    }

    def refuse(conf: object) -> World:
        raise AssertionError("the world is built")

    with pytest.raises(WorldError) as error:
        make_simulation(compose_environment("flat", (), {"actors": actors}), 1, 0, make_world=refuse)
    said = [line for line in str(error.value).splitlines() if line.startswith("agents.")]
    assert said == [
        f"agents.foe.controller.checkpoint: There is no {tmp_path / 'three.pt'}.",
        f"agents.patrol.controller.trajectory: there is no file {files[0]}: name one with trajectories "
        "(.sdf, .csv, .json).",
        "agents.patrol.controller.trajectory: two.csv has no column y_m, z_m, yaw_rad: its first line names "
        "the columns.",
    ]


@pytest.mark.parametrize("name", ["path", "external", "trajectory"])
def test_a_controller_without_settings_may_be_written_as_a_mapping(name: str) -> None:
    plain, mapped = (
        compose_environment("flat", (), {"actors": {"one": {"body": "cow", "controller": controller}}})
        for controller in (name, {"name": name})
    )
    assert plain == mapped and mapped.actors["one"].controller == name


@pytest.mark.slow
def test_a_policy_of_the_robot_is_no_start_for_its_walkers() -> None:
    words = ["+world=flat", "+experiment=multi_agent", f"learning.start_from={POLICY}"]
    with pytest.raises(CheckpointError) as error:
        check_group_files(compose(Conf, words))
    assert str(error.value).splitlines() == [
        f"learning.start_from: {POLICY} has no policy for the group walker, but for rover.",
        "Begin with random weights by learning.groups.walker.start_from=null, or with another run by "
        "learning.groups.walker.start_from=RUN.",
    ]
    check_group_files(compose(Conf, [*words, "learning.groups.walker.start_from=null"]))
    check_group_files(compose(Conf, [*words, f"learning.groups.walker.frozen={POLICY}"]))


def test_who_is_resumed_needs_no_file_that_it_began_with(tmp_path: Path) -> None:
    """The run has weights of its own, and its settings still say where it started."""
    conf = compose(Conf, ["+world=flat", "actors=none", f"learning.start_from={tmp_path / 'gone'}"])
    with pytest.raises(CheckpointError, match=r"^learning\.start_from: There is no"):
        check_group_files(conf)
    assert read_group_files(conf) == {}


def test_what_a_policy_is_for_is_told() -> None:
    assert describe_owner(str(POLICY), "rover", "agents.robot") == (
        "The policy is that of rover: write agents.robot.body=rover_zero and agents.robot.sensors=default, "
        "or take another checkpoint."
    )
