"""When episodes end, and how goals are renewed."""

import numpy as np
import pytest
from batches import every_engine, idle, metric, real_batch
from planted.puppets import puppet_batch

from dune_rl.env.batch import Batch, Outcome
from dune_rl.tasks.rewards import RewardConf

ENDS = ("reached", "stuck", "flipped", "out_of_world", "timeout", "diverged")


def end_flags(batch: Batch, scene: int = 0) -> list[str]:
    return [name for name in ENDS if metric(batch, name)[scene]]


def assert_ended(batch: Batch, outcome: Outcome, name: str, *, terminated: bool) -> None:
    assert end_flags(batch) == [name]
    assert bool(outcome.terminated[0]) is terminated
    assert bool(outcome.truncated[0]) is not terminated


@pytest.mark.parametrize("edge", range(4))
def test_leaving_the_world_terminates(edge: int) -> None:
    batch, (puppet,) = puppet_batch()
    xmin, xmax, ymin, ymax = batch.world.extent
    inside = [(xmin + 1, 0.0), (xmax - 1, 0.0), (0.0, ymin + 1), (0.0, ymax - 1)][edge]
    outside = [(xmin - 0.1, 0.0), (xmax + 0.1, 0.0), (0.0, ymin - 0.1), (0.0, ymax + 0.1)][edge]
    puppet.put(*inside)
    assert not batch.step(idle(batch)).terminated[0]
    puppet.put(*outside)
    assert_ended(batch, batch.step(idle(batch)), "out_of_world", terminated=True)


@every_engine
def test_rover_drives_out_of_the_world(engine: str) -> None:
    batch = real_batch(physics=engine, task={"spawn": {"region": [46.0, 49.0, -2.0, 2.0]}})
    batch.goals_w[:] = [[0.0, 0.0]]
    for _ in range(160):
        bearing = batch.motion.bearing(np.array([[100.0, 0.0]]))
        outcome = batch.step(np.stack([np.ones(1), bearing], axis=1).astype(np.float32))
        if outcome.terminated[0]:
            break
    assert_ended(batch, outcome, "out_of_world", terminated=True)
    assert 49.5 < batch.motion.position_w[0, 0] < 50.0
    batch.close()


@every_engine
def test_standing_still_is_stuck_after_just_so_many_steps(engine: str) -> None:
    batch = real_batch(physics=engine, task={"termination": {"stuck_steps": 12}})
    for _ in range(11):
        outcome = batch.step(idle(batch))
        assert not (outcome.terminated | outcome.truncated).any()
    assert_ended(batch, batch.step(idle(batch)), "stuck", terminated=True)
    batch.close()


def test_a_new_episode_is_not_stuck_from_the_last_one() -> None:
    batch, _ = puppet_batch(task={"termination": {"stuck_steps": 12}})
    for _ in range(2):
        for _ in range(11):
            assert not batch.step(idle(batch)).terminated[0]
        batch.reset()


def test_crawling_is_not_stuck() -> None:
    batch, (puppet,) = puppet_batch(
        task={"termination": {"stuck_steps": 12, "stuck_distance_m": 0.1, "goal_distance_m": 0.01}}
    )
    for step in range(60):
        puppet.put(20.0 + 0.01 * step, 0.0)
        assert not batch.step(idle(batch)).terminated[0]
    for step in range(30):
        puppet.put(21.0 + 0.005 * step, 0.0)
        outcome = batch.step(idle(batch))
        if outcome.terminated[0]:
            break
    assert_ended(batch, outcome, "stuck", terminated=True)


LYING = [[1, 0, 0, 0], [0, 1, 0, 0], [0.7071, 0, 0, 0.7071], [0, -0.7071, 0, 0.7071]]


@pytest.mark.parametrize("quaternion", LYING)
def test_lying_on_back_side_or_nose_is_flipped(quaternion: list[float]) -> None:
    batch, (puppet,) = puppet_batch()
    puppet.state[3:7] = quaternion
    assert_ended(batch, batch.step(idle(batch)), "flipped", terminated=True)


def test_a_steep_slope_is_not_flipped() -> None:
    batch, (puppet,) = puppet_batch()
    puppet.state[3:7] = [np.sin(np.deg2rad(30)), 0, 0, np.cos(np.deg2rad(30))]
    assert not batch.step(idle(batch)).terminated[0]
    assert end_flags(batch) == []


def test_arrival_on_the_last_step_terminates() -> None:
    batch, (puppet,) = puppet_batch(task={"termination": {"max_steps": 3}})
    for _ in range(2):
        batch.step(idle(batch))
    puppet.put(*batch.goals_w[0])
    assert_ended(batch, batch.step(idle(batch)), "reached", terminated=True)


def test_time_runs_out() -> None:
    batch, _ = puppet_batch(task={"termination": {"max_steps": 3}})
    for _ in range(2):
        assert not batch.step(idle(batch)).truncated[0]
    assert_ended(batch, batch.step(idle(batch)), "timeout", terminated=False)


def test_goals_are_renewed_and_earned_again() -> None:
    batch, (puppet,) = puppet_batch(task={"termination": {"continue_after_goal": True}})
    seen = []
    for count in range(1, 6):
        goal = batch.goals_w[0].copy()
        seen.append(tuple(goal))
        puppet.put(*goal)
        outcome = batch.step(idle(batch))
        assert not (outcome.terminated | outcome.truncated).any()
        assert outcome.rover_reward[0] == np.float32(RewardConf().goal)
        assert metric(batch, "goals")[0] == count
        assert tuple(batch.goals_w[0]) != tuple(goal)
        # The next step's progress is measured from the new goal: 5 cm toward it, whatever the jump.
        offset = batch.goals_w[0] - goal
        if np.hypot(*offset) > 0.81:
            ahead = offset / np.hypot(*offset)
            puppet.put(*(goal + 0.05 * ahead), yaw=np.arctan2(ahead[1], ahead[0]))
            conf, before = batch.task.reward, metric(batch, "reward/distance")[0]
            batch.step(idle(batch))
            earned = metric(batch, "reward/distance")[0] - before
            assert earned == pytest.approx(conf.alpha * conf.distance_scale * 0.05, rel=1e-3)
    assert len(set(seen)) == 5
    assert metric(batch, "reached")[0] == 1.0
    assert metric(batch, "success")[0] == 1.0
    assert metric(batch, "time_to_goal")[0] == np.float32(0.05)


def test_renewed_goals_depend_on_seed_and_episode_alone() -> None:
    task = {"termination": {"continue_after_goal": True}}
    alone, (puppet,) = puppet_batch(task=task)
    among, puppets = puppet_batch(num_scenes=3, task=task)
    for wait in range(4):
        assert np.array_equal(alone.goals_w[0], among.goals_w[0])
        for _ in range(wait):
            among.step(idle(among))
        for batch, one in ((alone, puppet), (among, puppets[0])):
            one.put(*batch.goals_w[0])
            batch.step(idle(batch))


@pytest.mark.parametrize(
    ("engine", "robot"), [("bullet", "rover_zero"), ("dart", "rover_zero"), ("dart", "hyperdog")]
)
def test_physics_that_diverges_truncates_and_leaves_nothing_behind(engine: str, robot: str) -> None:
    settings = {"actors": "walkers", "robot": robot, "physics": engine, "metrics": {"energy": True}}
    sensors = {"enabled": ["lidar", "imu", "goal", "velocity", "encoders", "currents"]}
    batch, calm = (real_batch("flat", 2, 3, sensors=sensors, **settings) for _ in range(2))
    ahead = np.tile(np.float32([0.3, 0.1]), (2, 1))
    for each in (batch, calm):
        each.step(ahead)
    # Thousands of times what it weighs, at once.
    batch._scenes[0].robots[0].apply_force([1e7, 0.0, 1e7])
    outcome = batch.step(ahead)
    calm.step(ahead)
    assert end_flags(batch) == ["diverged"] and end_flags(batch, 1) == []
    assert outcome.truncated.tolist() == [True, False] and not outcome.terminated.any()
    assert np.isfinite(outcome.rover_reward).all()
    assert (metric(batch, "energy_wh") < 0.05).all()
    for each in (batch, calm):
        each.reset(np.array([True, False]))
    for _ in range(5):
        batch.step(ahead)
        calm.step(ahead)
        for name, reading in batch.observe().items():
            assert np.isfinite(reading).all(), name
            assert reading.tobytes() == calm.observe()[name].tobytes(), name
        np.testing.assert_array_equal(batch.metrics(), calm.metrics())
    batch.close()
    calm.close()
