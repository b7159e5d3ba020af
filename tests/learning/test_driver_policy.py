"""The reference drivers as policies in true physics, and as controllers of groups."""

import pytest

from dune_rl.config.build import make_learning_env, make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.learning.drivers import DRIVERS
from dune_rl.learning.evaluation import evaluate
from dune_rl.learning.policies import built_in_policy
from dune_rl.state.command_grid import CommandGridConf, command_grid

SHORT = "task.terminations.time_limit.max_steps=60"
_COSTS = ["sensors=perception", "+sensors.command_costs={}"]
SENSORS = {"dwa": _COSTS, "dwa_oracle": _COSTS}


def rows_of(name: str, scenes: int) -> list[dict[str, float]]:
    env = make_learning_env(compose_environment("flat", [SHORT, *SENSORS.get(name, ())]), scenes, 0)
    rows = evaluate(built_in_policy(name, env, 5), env, 4, 5)["rover"]
    env.close()
    return rows


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVERS)
def test_the_number_of_scenes_changes_no_row(name: str) -> None:
    alone, beside = rows_of(name, 1), rows_of(name, 3)
    assert len(alone) == 4
    assert alone == [pytest.approx(row, rel=0.0, abs=0.0, nan_ok=True) for row in beside]


@pytest.mark.slow(all_but=["dwa_oracle"])
@pytest.mark.parametrize("name", DRIVERS)
def test_joints_are_refused(name: str) -> None:
    conf = compose_environment("flat", ["robot=hyperdog", "robot.action=joints"])
    env = make_learning_env(conf, 1, 0)
    with pytest.raises(ConfigError, match=f"{name} cannot act for the group hyperdog: .* 12 components"):
        built_in_policy(name, env)
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("headings", [15, 9])
def test_dwa_takes_the_cheapest_of_the_sensors_commands(headings: int) -> None:
    commands = f"+sensors.command_costs={{commands: {{headings: {headings}}}}}"
    env = make_learning_env(compose_environment("flat", [SHORT, "sensors=perception", commands]), 2, 0)
    policy, observation = built_in_policy("dwa", env), env.reset()
    for _ in range(8):
        costs = observation["rover", "observation", "command_costs"].reshape(2, -1)
        observation = policy(observation)
        speed, heading = observation["rover", "action"].reshape(2, 2).T
        grid = command_grid(CommandGridConf(headings=headings), -1.0, 1.0)[costs.argmin(-1).numpy()]
        assert speed.numpy() == pytest.approx(grid[:, 0]) and heading.numpy() == pytest.approx(grid[:, 1])
        observation = env.step_mdp(env.step(observation))
    env.close()
    assert len(set(speed.tolist() + heading.tolist())) > 1


def test_dwa_says_which_sensor_it_lacks() -> None:
    env = make_learning_env(compose_environment("flat", []), 1, 0)
    with pytest.raises(ConfigError, match=r"needs the sensor command_costs; add sensors=perception"):
        built_in_policy("dwa", env)
    env.close()


def test_mppi_without_a_lidar_is_refused_and_the_planner_needs_none() -> None:
    env = make_learning_env(compose_environment("flat", ["sensors=[goal]"]), 1, 0)
    with pytest.raises(
        ConfigError, match=r"has no lidar and no velocity; add to its sensors what sensors=default has"
    ):
        built_in_policy("mppi", env)
    built_in_policy("planner", env)
    env.close()


@pytest.mark.slow
def test_a_controlled_group_with_mppi_observes_by_itself() -> None:
    agents = {"idle": {"body": "leo_rover"}, "other": {"body": "rover_zero", "controller": "mppi"}}
    simulation = make_simulation(compose_environment("flat", (), {"agents": agents}), 1, 0)
    assert {"goal", "lidar", "velocity"} <= set(simulation.group("other").observation_bounds)
    simulation.close()
    agents["other"]["sensors"] = ["goal"]
    with pytest.raises(ConfigError, match="mppi cannot act for the group other"):
        make_simulation(compose_environment("flat", (), {"agents": agents}), 1, 0)
