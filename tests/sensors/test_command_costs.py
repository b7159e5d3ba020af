"""The look ahead over what was seen: what each command costs, by readings alone."""

from typing import Any

import numpy as np
import pytest
from plain_worlds import box, plain
from simulations import put_walkers, simulation_on
from test_perception import SENSORS as PERCEPTION

from dune_rl.core.errors import ConfigError
from dune_rl.env.requests import AgentRequest
from dune_rl.env.simulation import VectorSimulation
from dune_rl.sensors.perception import dynamic_window
from dune_rl.sensors.perception.dynamic_window import RESPONSE, STEPS, predict_actors, score_commands
from dune_rl.sensors.perception.low_obstacles import LowObstacles
from dune_rl.state.command_grid import CommandGridConf, command_grid

SENSORS = {**PERCEPTION, "command_costs": {}}
COMMANDS = command_grid(CommandGridConf(), -1.0, 1.0)
STANDING = ~COMMANDS.any(axis=1)


def costs_after(
    steps: int, *boxes: Any, goal: tuple[float, float] = (3.0, 0.0), sensors: Any = SENSORS, **settings: Any
) -> Any:
    """The costs (C,) for a rover at (-2, 0) that faces along x and has stood there, and the simulation."""
    simulation = simulation_on(plain(*boxes), sensors=sensors, **settings)
    simulation.reset(requests={0: {"rover_0": AgentRequest((-2.0, 0.0, 0.0), goal)}})
    for _ in range(steps):
        simulation.step({"rover": np.zeros((1, 1, 2))})
    return simulation.observe("rover")["command_costs"][0, 0], simulation


@pytest.mark.parametrize("steps", [0, 12])
@pytest.mark.parametrize("side", [-1.0, 0.0, 1.0])
def test_in_the_open_the_cheapest_command_leads_to_the_goal(steps: int, side: float) -> None:
    costs, simulation = costs_after(steps, goal=(3.0, 4.0 * side))
    speed, heading = COMMANDS[costs.argmin()]
    assert costs.min() == 0.0 and costs.max() <= 8.0
    assert speed == 1.0 and np.sign(np.round(heading, 1)) == side
    # Straight away from it costs the way there and back, and standing the way not driven.
    assert costs[STANDING] == pytest.approx(2.0, abs=1.0)
    assert costs[(COMMANDS == (-1.0, 0.0)).all(axis=1)] > costs[STANDING]
    simulation.close()


def test_commands_into_a_wall_cost_more_than_those_round_it() -> None:
    # Its face is 0.85 m before the rover's origin, and the gap beside it is 1.3 m wide.
    wall = box(-1.0, 1.0, 0.3, 3.0, 1.0)
    costs, simulation = costs_after(12, wall)
    _, heading = COMMANDS[costs.argmin()]
    full = COMMANDS[:, 0] == 1.0
    straight = full & (COMMANDS[:, 1] == 0.0)
    assert heading < 0.0
    assert costs[straight] > costs.min() + 1.0
    simulation.close()


@pytest.mark.slow
def test_low_obstacles_reach_no_farther_than_where_rays_met_them() -> None:
    # The gap is 0.6 m wide, between posts that both the scan and the sight of the ground see. By whole cells
    # of the map, to drive on would be a contact, which costs the most there is.
    posts = [box(-1.4, side * 0.375, 0.15, 0.15, 0.8) for side in (-1.0, 1.0)]
    seen_low = {"ground_profile": {}, "low_obstacles": {}, "way_left": {"low_obstacles": "low_obstacles"}}
    costs, simulation = costs_after(12, *posts, sensors={**SENSORS, **seen_low})
    suite = simulation.group("rover").suite
    assert suite is not None
    low = suite.sensors["low_obstacles"]
    assert isinstance(low, LowObstacles) and low.map[0].any()
    assert costs[(COMMANDS == (1.0, 0.0)).all(axis=1)] < 6.0
    simulation.close()


def test_a_robot_that_stays_where_it_is_is_led_away() -> None:
    # All ways to the goal are open, and it does not take them.
    straight = (COMMANDS == (1.0, 0.0)).all(axis=1)
    back = (COMMANDS == (-1.0, 0.0)).all(axis=1)
    for steps, recovers in ((70, False), (90, True), (120, False)):
        costs, simulation = costs_after(steps)
        assert (costs[back] < 0.5) == recovers
        assert costs[straight] < 0.5
        assert costs[STANDING] > 1.0
        simulation.close()


def test_commands_into_the_way_of_a_walker_cost_what_a_contact_does() -> None:
    walker = {"body": "person", "controller": "external", "count": 1}
    simulation = simulation_on(plain(), sensors=SENSORS, actors={"walker": walker})
    simulation.reset(requests={0: {"rover_0": AgentRequest((-2.0, 0.0, 0.0), (3.0, 0.0))}})
    straight = (COMMANDS == (1.0, 0.0)).all(axis=1)
    # It comes from the left, and will cross the rover's way 1.5 m ahead in 1.5 s.
    put_walkers(simulation, [[-0.5, 2.5, 0.0, -np.pi / 2]])
    for _ in range(20):
        simulation.step({"rover": np.zeros((1, 1, 2)), "walker": np.array([[[1.0, 0.0]]])})
    crossing = simulation.observe("rover")["command_costs"][0, 0]
    assert crossing[straight] > crossing[STANDING] + 1.0
    simulation.close()
    alone, simulation = costs_after(20)
    assert alone[straight] == pytest.approx(0.0, abs=0.1)
    simulation.close()


def test_passing_a_walker_closely_costs_more_where_gaps_are_uncertain() -> None:
    walker = {"body": "person", "controller": "external", "count": 1}
    straight = (COMMANDS == (1.0, 0.0)).all(axis=1)
    costs = {}
    for growth_mps in (0.0, 0.25):
        own = {"gap_error_m": 0.0, "gap_error_growth_mps": growth_mps}
        simulation = simulation_on(
            plain(), sensors={**PERCEPTION, "command_costs": own}, actors={"walker": walker}
        )
        simulation.reset(requests={0: {"rover_0": AgentRequest((-2.0, 0.0, 0.0), (3.0, 0.0))}})
        # It comes towards the rover, and will pass it 0.4 m beside its outline.
        put_walkers(simulation, [[2.5, 0.95, 0.0, np.pi]])
        for _ in range(30):
            simulation.step({"rover": np.zeros((1, 1, 2)), "walker": np.array([[[1.0, 0.0]]])})
        costs[growth_mps] = simulation.observe("rover")["command_costs"][0, 0][straight]
        simulation.close()
    assert costs[0.25] > costs[0.0] + 0.5


def test_costs_depend_on_no_other_scene_and_repeat() -> None:
    def of(scenes: int) -> Any:
        simulation: VectorSimulation = simulation_on(
            plain(box(0.0, 0.0, 0.4, 2.0, 1.0)), num_scenes=scenes, sensors=SENSORS
        )
        simulation.reset()
        for _ in range(12):
            simulation.step({"rover": np.full((scenes, 1, 2), 0.4)})
        found = simulation.observe("rover")["command_costs"]
        assert np.array_equal(found, simulation.observe("rover")["command_costs"])
        simulation.close()
        return found[0]

    assert np.array_equal(of(1), of(3))


def test_a_body_that_is_not_driven_by_speed_and_heading_has_no_look_ahead() -> None:
    robot = {"name": "hyperdog", "action": "joints"}
    with pytest.raises(ConfigError, match=r"sensors\.command_costs: the body is not driven by its speed"):
        simulation_on(plain(), sensors=SENSORS, robot=robot)


def test_a_way_that_is_no_way_left_is_refused() -> None:
    sensors = {**SENSORS, "command_costs": {"way_left": "lidar"}}
    with pytest.raises(ConfigError, match=r"sensors\.command_costs\.way_left must be the name"):
        simulation_on(plain(), sensors=sensors)


@pytest.mark.parametrize("gap_error", [(0.0, 0.0), (0.06, 0.25)])
@pytest.mark.parametrize("cap", [1.0, 8.0])
def test_what_is_left_out_would_not_change_the_costs(gap_error: tuple[float, float], cap: float) -> None:
    """Costs up to the cap are those of all commands to their ends, by all actors, without any bounds."""
    random = np.random.default_rng(0)
    rows, cells = 12, 96
    grids = np.tile((-3.0, -3.0, 16.0, cells, cells), (rows, 1)).astype(float)
    spread = np.linspace(0.1, 12.0, rows)[:, None]
    fields = (10.0 + spread * random.uniform(0.0, 1.0, (rows, cells * cells))).astype(np.float32)
    clearances = random.uniform(0.2, 0.8, (rows, cells * cells)).astype(np.float32)
    waypoints = random.integers(0, cells * cells, (rows, cells * cells)).astype(np.int32)
    # Some are outside the grid.
    poses = random.uniform(-0.5, 0.5, (rows, 3)) * np.where(np.arange(rows) % 4 == 3, 8.0, 1.0)[:, None]
    twists = random.uniform(-1.0, 1.0, (rows, 2))
    goals = random.uniform(3.0, 20.0, (rows, 2))
    # Of half of the rows the goal is near: they arrive.
    goals[::2] /= 10.0
    actors = np.zeros((rows, 5, 6))
    actors[..., :2] = random.uniform(-4.0, 4.0, (rows, 5, 2))
    actors[..., 2:5] = random.uniform(-1.0, 1.0, (rows, 5, 3))
    actors[..., 5] = 0.35
    recovers = np.arange(rows) % 3 == 2
    vehicle = (-1.0, 1.0, 2.0, 0.0, 0.15, 0.2, 0.35, 0.1, 4.0, *gap_error)
    places = np.empty((rows, STEPS, 5, 2))
    predict_actors(actors, places)

    def cost(row: int, speed: float, turn: float) -> float:
        maps = grids[row], fields[row], waypoints[row], clearances[row]
        found: list[float] = []
        for then in {0.0, turn}:
            command = np.array([speed, turn, then])
            found.append(
                dynamic_window._command_cost(
                    poses[row], twists[row], command, maps, places[row], actors[row], goals[row], vehicle,
                    RESPONSE, recovers[row], -np.inf, np.inf,
                )
            )  # fmt: skip
        return min(found)

    whole = np.array([[cost(row, *command) for command in COMMANDS] for row in range(rows)])
    whole -= whole.min(axis=1, keepdims=True)
    assert np.isfinite(whole).all()
    found, likely = np.zeros((rows, len(COMMANDS))), np.full(rows, 7)
    score_commands(
        poses, twists, grids, fields, waypoints, clearances, actors, places, goals, vehicle, RESPONSE,
        recovers, COMMANDS, likely, cap, found,
    )  # fmt: skip
    assert np.isinf(found).sum() > 10, "nothing is left out"
    found -= found.min(axis=1, keepdims=True)
    np.testing.assert_array_equal(np.minimum(found, cap), np.minimum(whole, cap))
