"""When episodes end, and how goals are renewed."""

import numpy as np
import pytest
from scripted_physics import scripted_simulation
from simulations import (
    act,
    bearing,
    every_engine,
    goals_w,
    metric,
    metrics,
    motion_of_group,
    observation,
    outcome,
    set_goal,
    started_simulation,
)

from dune_rl.env.simulation import SimulationStep, VectorSimulation

ENDS = ("reached", "stuck", "flipped", "out_of_world", "timeout", "diverged")


def end_flags(simulation: VectorSimulation, scene: int = 0) -> list[str]:
    return [name for name in ENDS if metric(simulation, name)[scene]]


def assert_ended(simulation: VectorSimulation, step: SimulationStep, name: str, *, terminated: bool) -> None:
    assert end_flags(simulation) == [name]
    agent = outcome(step)
    assert bool(step.terminated[0]) is bool(agent.terminated[0]) is terminated
    assert bool(step.truncated[0]) is bool(agent.truncated[0]) is not terminated


@pytest.mark.parametrize("edge", range(4))
def test_leaving_the_world_terminates(edge: int) -> None:
    simulation, (robot,) = scripted_simulation()
    xmin, xmax, ymin, ymax = simulation.worlds.worlds[0].extent
    inside = [(xmin + 1, 0.0), (xmax - 1, 0.0), (0.0, ymin + 1), (0.0, ymax - 1)][edge]
    outside = [(xmin - 0.1, 0.0), (xmax + 0.1, 0.0), (0.0, ymin - 0.1), (0.0, ymax + 0.1)][edge]
    robot.put(*inside)
    assert not act(simulation).terminated[0]
    robot.put(*outside)
    assert_ended(simulation, act(simulation), "out_of_world", terminated=True)


@every_engine
def test_rover_drives_out_of_the_world(engine: str) -> None:
    simulation = started_simulation(physics=engine, task={"spawn": {"region": [46.0, 49.0, -2.0, 2.0]}})
    set_goal(simulation, 0, [0.0, 0.0])
    for _ in range(160):
        turn = bearing(motion_of_group(simulation), [[100.0, 0.0]])[0]
        step = act(simulation, [1.0, turn])
        if step.terminated[0]:
            break
    assert_ended(simulation, step, "out_of_world", terminated=True)
    assert 49.5 < motion_of_group(simulation).position_w[0, 0] < 50.0
    simulation.close()


@every_engine
def test_standing_still_is_stuck_after_just_so_many_steps(engine: str) -> None:
    simulation = started_simulation(physics=engine, task={"terminations": {"stuck": {"steps": 12}}})
    for _ in range(11):
        assert not act(simulation).done.any()
    assert_ended(simulation, act(simulation), "stuck", terminated=True)
    simulation.close()


def test_a_new_episode_is_not_stuck_from_the_last_one() -> None:
    simulation, _ = scripted_simulation(task={"terminations": {"stuck": {"steps": 12}}})
    for _ in range(2):
        for _ in range(11):
            assert not act(simulation).terminated[0]
        simulation.reset()


def test_crawling_is_not_stuck() -> None:
    simulation, (robot,) = scripted_simulation(
        task={
            "terminations": {"stuck": {"steps": 12, "distance_m": 0.1}, "goal_reached": {"distance_m": 0.01}}
        }
    )
    for count in range(60):
        robot.put(20.0 + 0.01 * count, 0.0)
        assert not act(simulation).terminated[0]
    for count in range(30):
        robot.put(21.0 + 0.005 * count, 0.0)
        step = act(simulation)
        if step.terminated[0]:
            break
    assert_ended(simulation, step, "stuck", terminated=True)


LYING = [[1, 0, 0, 0], [0, 1, 0, 0], [0.7071, 0, 0, 0.7071], [0, -0.7071, 0, 0.7071]]


@pytest.mark.parametrize("quaternion", LYING)
def test_lying_on_back_side_or_nose_is_flipped(quaternion: list[float]) -> None:
    simulation, (robot,) = scripted_simulation()
    robot.state[3:7] = quaternion
    assert_ended(simulation, act(simulation), "flipped", terminated=True)


def test_a_steep_slope_is_not_flipped() -> None:
    simulation, (robot,) = scripted_simulation()
    robot.state[3:7] = [np.sin(np.deg2rad(30)), 0, 0, np.cos(np.deg2rad(30))]
    assert not act(simulation).terminated[0]
    assert end_flags(simulation) == []


def test_arrival_on_the_last_step_terminates() -> None:
    simulation, (robot,) = scripted_simulation(task={"terminations": {"time_limit": {"max_steps": 3}}})
    for _ in range(2):
        act(simulation)
    robot.put(*goals_w(simulation)[0])
    assert_ended(simulation, act(simulation), "reached", terminated=True)


def test_time_runs_out() -> None:
    simulation, _ = scripted_simulation(task={"terminations": {"time_limit": {"max_steps": 3}}})
    for _ in range(2):
        assert not act(simulation).truncated[0]
    assert_ended(simulation, act(simulation), "timeout", terminated=False)


RENEWS = {"terminations": {"goal_reached": {"renew": True}}}


def test_goals_are_renewed_and_earned_again() -> None:
    simulation, (robot,) = scripted_simulation(task=RENEWS)
    terms = simulation.group().task.conf.rewards
    seen = []
    for count in range(1, 6):
        goal = goals_w(simulation)[0].copy()
        seen.append(tuple(goal))
        robot.put(*goal)
        step = act(simulation)
        assert not step.done.any()
        assert outcome(step).reward[0] == np.float32(terms["goal"].weight)
        assert metric(simulation, "goals")[0] == count
        assert tuple(goals_w(simulation)[0]) != tuple(goal)
        # The next step's progress is measured from the new goal: 5 cm toward it, whatever the jump.
        offset = goals_w(simulation)[0] - goal
        if np.hypot(*offset) > 0.81:
            ahead = offset / np.hypot(*offset)
            robot.put(*(goal + 0.05 * ahead), yaw=np.arctan2(ahead[1], ahead[0]))
            before = metric(simulation, "reward/distance")[0]
            act(simulation)
            earned = metric(simulation, "reward/distance")[0] - before
            distance = terms["distance"]
            assert earned == pytest.approx(distance.weight * distance.scale * 0.05, rel=1e-3)
    assert len(set(seen)) == 5
    assert metric(simulation, "reached")[0] == 1.0
    assert metric(simulation, "success")[0] == 1.0
    assert metric(simulation, "time_to_goal")[0] == np.float32(0.05)


def test_a_renewed_goal_is_what_the_agent_observes() -> None:
    simulation, (robot,) = scripted_simulation(task=RENEWS)
    robot.put(*goals_w(simulation)[0])
    act(simulation)
    seen = observation(simulation)["goal"][0]
    assert seen[0] == pytest.approx(np.hypot(*(goals_w(simulation)[0] - robot.state[:2])), abs=1e-4)
    assert seen[1] == pytest.approx(bearing(motion_of_group(simulation), goals_w(simulation))[0], abs=1e-4)


def test_each_agent_of_a_team_has_its_goal_renewed_by_itself() -> None:
    simulation, robots = scripted_simulation(num_scenes=2, robots=["rover_zero"] * 2, task=RENEWS)
    before = goals_w(simulation).copy()
    robots[2].put(*before[2])
    assert not act(simulation).done.any()
    assert (goals_w(simulation) != before).any(axis=1).tolist() == [False, False, True, False]
    assert metric(simulation, "goals").tolist() == [0, 0, 1, 0]


def test_renewed_goals_depend_on_seed_and_episode_alone() -> None:
    alone, (robot,) = scripted_simulation(task=RENEWS)
    among, robots = scripted_simulation(num_scenes=3, task=RENEWS)
    for wait in range(4):
        assert np.array_equal(goals_w(alone)[0], goals_w(among)[0])
        for _ in range(wait):
            act(among)
        for simulation, one in ((alone, robot), (among, robots[0])):
            one.put(*goals_w(simulation)[0])
            act(simulation)


@pytest.mark.slow(all_but=["bullet-rover_zero"])
@pytest.mark.parametrize(
    ("engine", "robot"), [("bullet", "rover_zero"), ("dart", "rover_zero"), ("dart", "hyperdog")]
)
def test_physics_that_diverges_truncates_and_leaves_nothing_behind(engine: str, robot: str) -> None:
    settings = {"actors": "walkers", "robot": robot, "physics": engine, "metrics": {"energy": True}}
    sensors = {"enabled": ["lidar", "imu", "goal", "velocity", "encoders", "currents"]}
    wild, calm = (started_simulation("flat", 2, 3, sensors=sensors, **settings) for _ in range(2))
    for each in (wild, calm):
        act(each, [0.3, 0.1])
    # Thousands of times what it weighs, at once.
    wild.scenes.robots(0)[0].apply_force([1e7, 0.0, 1e7])
    step = act(wild, [0.3, 0.1])
    act(calm, [0.3, 0.1])
    assert end_flags(wild) == ["diverged"] and end_flags(wild, 1) == []
    for ends in (step, outcome(step)):
        assert ends.truncated.tolist() == [True, False] and not ends.terminated.any()
    assert np.isfinite(outcome(step).reward).all()
    assert (metric(wild, "energy_wh") < 0.05).all()
    for each in (wild, calm):
        each.reset(np.array([True, False]))
    for _ in range(5):
        act(wild, [0.3, 0.1])
        act(calm, [0.3, 0.1])
        for name, reading in observation(wild).items():
            assert np.isfinite(reading).all(), name
            assert reading.tobytes() == observation(calm)[name].tobytes(), name
        np.testing.assert_array_equal(metrics(wild), metrics(calm))
    wild.close()
    calm.close()
