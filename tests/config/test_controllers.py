"""Behaviours and trained policies that drive groups, as they are configured."""

from pathlib import Path

import numpy as np
import pytest

from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose, compose_environment
from dune_rl.config.controllers import check_policies
from dune_rl.env.simulation import VectorSimulation
from dune_rl.errors import CheckpointError

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


@pytest.mark.parametrize("controller", ["orca", "social_force", "herd", "random_waypoint"])
def test_people_with_a_behaviour_go_about_and_know_of_the_robot(controller: str) -> None:
    simulation = simulation_of(controller, body="person", count=3)
    people = simulation.state.groups["other"]
    around = simulation.state.surroundings
    assert around.is_robot.tolist() == [True, False, False, False]
    assert people.reach_m == pytest.approx(0.25) and around.reach_m[0] > 0.25
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
        f"+actors.foe={{body: person, controller: {{checkpoint: {tmp_path / 'b.pt'}}}}}",
    ]
    with pytest.raises(CheckpointError) as error:
        check_policies(compose(words))
    said = [line for line in str(error.value).splitlines() if "There is no" in line]
    assert said == [
        f"controller.checkpoint of the group foe: There is no {tmp_path / 'b.pt'}.",
        f"learning.groups.walker.frozen: There is no {tmp_path / 'a.pt'}.",
    ]
    check_policies(compose(["+world=flat", "+experiment=multi_agent"]))
    check_policies(compose(["+world=flat", f"actors.walker.controller={{checkpoint: {POLICY}}}"]))


def test_a_policy_of_another_body_is_refused() -> None:
    with pytest.raises(CheckpointError, match=r"for another environment: .*lidar has 32 values") as error:
        simulation_of({"checkpoint": str(POLICY)}, sensors=["goal"])
    first, *_, last = str(error.value).splitlines()
    assert first.startswith(f"the controller of the group other (controller.checkpoint): {POLICY} was made")
    assert last.startswith("A policy of another group does not fit: give other the body and sensors")
