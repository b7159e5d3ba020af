"""The driver `dwa_oracle`: the look ahead of `dwa` with the truth in place of readings."""

from typing import Any

import numpy as np
import pytest
from plain_worlds import box, plain
from simulations import put_walkers, simulation_on

from dune_rl.core.errors import ConfigError
from dune_rl.env.requests import AgentRequest
from dune_rl.env.simulation import VectorSimulation
from dune_rl.learning.drivers import BoundDriver
from dune_rl.state.command_grid import CommandGridConf, command_grid

COMMANDS = command_grid(CommandGridConf(), -1.0, 1.0)
STRAIGHT = (COMMANDS == (1.0, 0.0)).all(axis=1)
STANDING = ~COMMANDS.any(axis=1)
CAP_M = 8.0
# What the rover faces at its start; its odometry begins at 0.
YAWS = [0.0, np.pi / 2, -2.0]


def turned(x: float, y: float, yaw: float) -> tuple[float, float]:
    """The place (x, y) after a turn of the world by `yaw`."""
    return float(np.cos(yaw) * x - np.sin(yaw) * y), float(np.sin(yaw) * x + np.cos(yaw) * y)


def simulation_with(yaw: float, *boxes: Any, range_m: float = 12.0, **settings: Any) -> VectorSimulation:
    """A rover at (-2, 0), its goal 5 m ahead, all turned by `yaw`, and a LiDAR of this range."""
    names = ("velocity", "goal_direction", "agent_tracks", "way_left", "command_costs")
    sensors = {"lidar": {"n_segments": 64, "range_m": range_m}, **{name: {} for name in names}}
    simulation = simulation_on(plain(*boxes), sensors=sensors, **settings)
    start = AgentRequest((*turned(-2.0, 0.0, yaw), yaw), turned(3.0, 0.0, yaw))
    simulation.reset(requests={0: {"rover_0": start}})
    return simulation


def judged(simulation: VectorSimulation, steps: int, **others: Any) -> tuple[np.ndarray, np.ndarray]:
    """Costs (C,) of the commands by the readings and by the truth, after standing and turning for `steps`."""
    judge = BoundDriver("dwa_oracle", simulation, simulation.group("rover"))
    for number in range(steps):
        judge.costs(COMMANDS, CAP_M)
        turn = 0.4 if number % 2 else -0.3
        simulation.step({"rover": np.array([[[0.0, turn]]]), **others})
    read = simulation.observe("rover")["command_costs"][0, 0]
    return read, judge.costs(COMMANDS, CAP_M)[0]


@pytest.mark.slow
@pytest.mark.parametrize("yaw", YAWS)
def test_it_agrees_with_dwa_where_nothing_is(yaw: float) -> None:
    simulation = simulation_with(yaw)
    read, known = judged(simulation, 12)
    assert known == pytest.approx(read, abs=1e-3)
    simulation.close()


# The wall's face is 0.85 m before the rover's origin.
@pytest.mark.parametrize(
    ("yaw", "wall"), [(0.0, box(-1.0, 1.0, 0.3, 3.0, 1.0)), (np.pi / 2, box(-1.0, -1.0, 3.0, 0.3, 1.0))]
)
def test_it_knows_a_wall_that_the_lidar_does_not_see(yaw: float, wall: Any) -> None:
    simulation = simulation_with(yaw, wall, range_m=0.5)
    read, known = judged(simulation, 12)
    assert read[STRAIGHT] < 1.0
    assert known[STRAIGHT] > known.min() + 1.0
    simulation.close()


@pytest.mark.slow(all_but=["True-0.0"])
@pytest.mark.parametrize("yaw", YAWS)
@pytest.mark.parametrize("leaves", [False, True])
def test_it_knows_walkers_that_the_lidar_does_not_see(yaw: float, leaves: bool) -> None:
    walker = {"body": "person", "controller": "external", "count": 1}
    simulation = simulation_with(yaw, range_m=0.5, actors={"walker": walker})
    # It comes from the left, and will cross the rover's way 1.5 m ahead in 1.5 s, or walks away.
    course = np.pi / 2 if leaves else -np.pi / 2
    put_walkers(simulation, [[*turned(-0.5, 2.5, yaw), 0.0, yaw + course]])
    read, known = judged(simulation, 20, walker=np.array([[[1.0, 0.0]]]))
    assert read[STRAIGHT] < 1.0
    assert (known[STRAIGHT] > known[STANDING] + 1.0) != leaves
    simulation.close()


@pytest.mark.parametrize("cap", [1.0, 30.0])
def test_labels_are_cut_where_the_teacher_is_asked_to(cap: float) -> None:
    simulation = simulation_with(0.0)
    judge = BoundDriver("dwa_oracle", simulation, simulation.group("rover"))
    costs = judge.costs(COMMANDS, cap)
    assert costs.max() == (cap if cap < 2.0 else pytest.approx(6.0, abs=4.0))
    simulation.close()


def test_it_refuses_commands_that_its_sensor_does_not_know() -> None:
    simulation = simulation_with(0.0)
    judge = BoundDriver("dwa_oracle", simulation, simulation.group("rover"))
    with pytest.raises(ConfigError, match=r"the commands of sensors\.command_costs alone; give learning"):
        judge.costs(COMMANDS[:10], CAP_M)
    simulation.close()
