"""Each robot reaches goals in either engine: a hundred episodes each, which take minutes."""

import numpy as np
import pytest
from simulations import every_engine

from dune_rl.config.build import make_learning_env
from dune_rl.config.compose import compose_environment
from dune_rl.learning.evaluation import evaluate
from dune_rl.learning.policies import built_in_policy
from dune_rl.physics.interface import Engine
from dune_rl.statistics.measures import MetricsRow

pytestmark = pytest.mark.slow

FAR_M = 5.0


def episodes(world: str, robot: str, engine: Engine, *settings: str) -> list[MetricsRow]:
    """A hundred with goals from `FAR_M` to 8 m away."""
    conf = compose_environment(
        world,
        [
            *(f"robot={robot}", f"physics={engine}", "actors=none", "sensors=[goal]"),
            f"task.spawn.min_goal_distance_m={FAR_M}",
            "task.spawn.region=[-2.8,2.8,-2.8,2.8]",
            *settings,
        ],
    )
    env = make_learning_env(conf, 16, 0)
    (rows,) = evaluate(built_in_policy("go_to_goal", env), env, 100, 0).values()
    env.close()
    return rows


@every_engine
@pytest.mark.parametrize("robot", ["rover_zero", "leo_rover", "hyperdog"])
def test_a_robot_reaches_goals_on_flat_ground(engine: Engine, robot: str) -> None:
    rows = episodes("flat", robot, engine)
    assert np.mean([row["success"] for row in rows]) >= 0.98
    assert sum(row["flipped"] for row in rows) == 0


@every_engine
def test_a_dog_walks_five_metres_on_a_slope_of_ten_degrees(engine: Engine, tmp_path) -> None:
    places = np.arange(0.0, 40.1, 0.5)
    np.save(tmp_path / "ramp.npy", np.tile(np.tan(np.deg2rad(10.0)) * places, (len(places), 1)))
    ramp = [f"world.path={tmp_path / 'ramp.npy'}", "world.size_m=[40,40]"]
    rows = episodes("heightmap", "hyperdog", engine, *ramp)
    # Who falls does not succeed.
    assert np.mean([row["success"] for row in rows]) >= 0.95
    # By the least way that it can have had: its speed is more.
    arrived_m = compose_environment("flat").task.terminations["goal_reached"].distance_m
    assert np.nanmedian([(FAR_M - arrived_m) / row["time_to_goal"] for row in rows]) >= 0.2
