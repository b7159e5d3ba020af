"""The core that every environment wraps: way points, bounds, the log of actions, and what driving earns."""

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
    started_simulation,
    state_of_group,
)


def test_a_new_episode_forgets_which_way_a_walker_went() -> None:
    walker = {"controller": "external", "waypoints": [[6.0, 6.0], [7.5, 6.0]]}
    simulation, _ = scripted_simulation(actors=[walker])

    def way_points() -> list[float]:
        """Where the walker goes, one after the other, when it walks on until its third arrival."""
        seen = [float(goals_w(simulation, "walker")[0, 0])]
        for _ in range(400):
            goal = goals_w(simulation, "walker").copy()
            turn = bearing(motion_of_group(simulation, "walker"), goal)[0]
            act(simulation, walker=[0.5 if abs(turn) < 0.5 else 0.0, turn])
            now = state_of_group(simulation, "walker")
            left = now.goal.position_w[0] - now.motion.position_w[0, :2]
            assert np.hypot(*left) >= 0.5, "it is where it is going"
            if now.goal.position_w[0, 0] != seen[-1]:
                seen.append(float(now.goal.position_w[0, 0]))
            if len(seen) == 4:
                break
        return seen

    first = way_points()
    assert len(first) == 4
    assert first[0] == first[2] != first[1] == first[3]
    simulation.reset()
    assert way_points() == first


def test_a_step_needs_the_actions_of_every_external_group() -> None:
    simulation, _ = scripted_simulation(actors="external_walkers")
    with pytest.raises(KeyError, match=r"step needs actions of the group 'walker'; it got \['rover'\]"):
        simulation.step({"rover": np.zeros((1, 1, 2))})


def test_groups_are_found_by_name() -> None:
    simulation, _ = scripted_simulation(robots=["rover_zero", "leo_rover"], actors="walkers")
    assert [group.name for group in simulation.groups] == ["rover", "leo_rover", "walker"]
    assert [group.name for group in simulation.external] == ["rover", "leo_rover"]
    assert simulation.group() is simulation.group("rover")
    assert simulation.group("walker").names == ("walker_0", "walker_1")
    assert simulation.agents == ("rover_0", "leo_rover_0")


# -- observations of extreme states ----------------------------------------------------------------


def test_observations_keep_their_bounds_whatever_the_motion() -> None:
    simulation, robots = scripted_simulation(num_scenes=64, actors="external_walkers")
    rng = np.random.default_rng(3)
    for robot in robots:
        quaternion = rng.normal(size=4)
        # As fast as a state may be without counting as diverged.
        robot.state = np.concatenate(
            [
                rng.uniform(-90, 90, 3),
                quaternion / np.linalg.norm(quaternion),
                rng.uniform(-49.0, 49.0, 3),
                rng.uniform(-199.0, 199.0, 3),
            ]
        )
    step = act(simulation, walker=[1.0, 3.0])
    assert not metric(simulation, "diverged").any()
    for group in simulation.external:
        assert np.isfinite(step.groups[group.name].reward).all()
        seen, bounds = observation(simulation, group.name), group.observation_bounds
        assert seen.keys() == bounds.keys()
        for name, value in seen.items():
            low, high = bounds[name]
            assert value.dtype == np.float32
            assert ((low <= value) & (value <= high)).all(), f"{name} leaves its bounds"


# -- long episodes ---------------------------------------------------------------------------------


def test_history_grows_with_the_episode() -> None:
    task = {"terminations": {"goal_reached": {"distance_m": 0.01}, "stuck": {"steps": 2000}}}
    simulation = started_simulation(num_scenes=2, task=task)
    rng = np.random.default_rng(0)
    actions = rng.uniform([-1, -1], [1, 1], (300, 2, 2)).astype(np.float32)
    for step in range(300):
        if step == 170:
            simulation.reset(np.array([False, True]))
        act(simulation, actions[step])
    saved = simulation.save_state()
    assert [len(history) for history in saved["actions"]] == [300, 130]
    assert np.array_equal(np.float32(saved["actions"][0]), actions[:, 0])
    assert np.array_equal(np.float32(saved["actions"][1]), actions[170:, 1])
    again = started_simulation(num_scenes=2, seed=9, task=task)
    again.restore(saved)
    assert np.array_equal(motion_of_group(again).position_w, motion_of_group(simulation).position_w)
    assert np.array_equal(metrics(again), metrics(simulation), equal_nan=True)
    simulation.close()
    again.close()


# -- driving ---------------------------------------------------------------------------------------


@pytest.mark.slow(all_but=["dart"])
@every_engine
def test_driving_at_the_goal_arrives_in_time_and_earns_what_the_paper_says(engine: str) -> None:
    simulation = started_simulation(num_scenes=6, seed=3, physics=engine)
    terms = simulation.group().task.conf.rewards
    way_weight, speed_scale = terms["distance"].weight, terms["velocity"].speed_scale
    distance = np.hypot(*(goals_w(simulation) - motion_of_group(simulation).position_w[:, :2]).T)
    first = distance.copy()
    turn = np.abs(bearing(motion_of_group(simulation), goals_w(simulation)))
    total, expected, running = np.zeros(6), np.zeros(6), np.ones(6, bool)
    took = np.zeros(6)
    for step in range(1, 300):
        ahead = bearing(motion_of_group(simulation), goals_w(simulation))
        now = act(simulation, np.stack([np.ones(6), ahead], axis=1))
        seen = observation(simulation)
        distance, before = seen["goal"][:, 0].astype(float), distance
        heading, speed = np.abs(seen["goal"][:, 1]).astype(float), seen["velocity"][:, 0]
        progress = before - distance
        nearer = (progress > 0) & (heading <= np.pi / 2)
        way = np.where(nearer, terms["distance"].scale * progress, terms["distance"].misaligned)
        facing = terms["heading"].bonus * (1 - 2 * heading / np.pi)
        reward = way_weight * (way + facing) + speed_scale * speed
        reward = np.where(distance < 0.75, terms["goal"].weight, reward)
        total[running] += outcome(now).reward[running]
        expected[running] += reward[running]
        assert not now.truncated.any()
        took[running & now.terminated] = step / 20
        if (running & now.terminated).any():
            ended = running & now.terminated
            final, names = metrics(simulation)[ended], simulation.metric_names()
            columns = [index for index, name in enumerate(names) if name.startswith("reward/")]
            assert (final[:, names.index("success")] == 1).all()
            np.testing.assert_allclose(final[:, names.index("time_to_goal")], took[ended], rtol=1e-6)
            np.testing.assert_allclose(final[:, names.index("return")], total[ended], rtol=1e-5)
            np.testing.assert_allclose(final[:, columns].sum(axis=1), total[ended], rtol=1e-5)
            np.testing.assert_allclose(final[:, names.index("reward/goal")], terms["goal"].weight)
        running &= ~now.terminated
        if not running.any():
            break
    assert not running.any()
    np.testing.assert_allclose(total, expected, atol=0.02)
    # A metre a second for the way, and time to turn: at most 2 rad/s, with a start and an end.
    assert (took >= (first - 0.75) / 1.05).all()
    assert (took <= (first - 0.75) / 0.9 + turn / 2.0 + 2.0).all()
    simulation.close()


@every_engine
def test_the_rover_goes_as_fast_as_commanded_and_stays_on_the_ground(engine: str) -> None:
    task = {"terminations": {"goal_reached": {"distance_m": 0.01}}}
    simulation = started_simulation(physics=engine, task=task)
    for _ in range(60):
        act(simulation, [0.8, 0.0])
    seen = observation(simulation)
    assert seen["velocity"][0, 0] == pytest.approx(0.8, rel=0.05)
    assert motion_of_group(simulation).position_w[0, 2] == pytest.approx(0.125, abs=0.02)
    assert np.linalg.norm(seen["imu"][0, :3]) == pytest.approx(9.81, rel=0.05)
    simulation.close()
