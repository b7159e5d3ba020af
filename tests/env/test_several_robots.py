"""Robots of two kinds, and two of one kind: apart they drive as if alone, together they collide."""

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from conformance import check_time_limit
from rollouts import digest_of
from scenes import Backend, every_backend
from several_robots import (
    CLOSE,
    KINDS,
    NO_ARRIVAL,
    TWINS,
    distance,
    drive_at_each_other,
    positions,
    simulation_of,
)
from simulations import (
    act,
    every_engine,
    goals_w,
    metric,
    metrics,
    motion_of_group,
    new_simulation,
    observation,
    set_goal,
    started_simulation,
    state_of_group,
)

import dune_rl
from dune_rl.config.build import build_robot
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError, WorldError
from dune_rl.env.scene_spec import scene_spec, standing_pose
from dune_rl.env.simulation import VectorSimulation
from dune_rl.physics.interface import OWN_ENGINES, Engine, PhysicsConf, step_scene
from dune_rl.robots.robot import Robot
from dune_rl.robots.rover_zero import RoverZeroConf
from dune_rl.worlds.flat import FlatConf, build_flat

# -- agents ----------------------------------------------------------------------------------------


def test_time_limit_truncates_all() -> None:
    task = {"terminations": {"time_limit": {"max_steps": 12}, "goal_reached": {"distance_m": 0.1}}}

    def make() -> Any:
        return dune_rl.parallel_env("flat", robots=KINDS, actors="external_walkers", task=task)

    check_time_limit(make, 12)


def test_each_kind_has_its_own_limits() -> None:
    simulation = simulation_of(KINDS)
    top = [float(group.action_bounds[1][0]) for group in simulation.external]
    assert top[0] > top[1]
    simulation.close()


@pytest.mark.parametrize("robots", [KINDS, TWINS], ids=["kinds", "twins"])
def test_who_arrives_waits_for_the_others(robots: list[str]) -> None:
    task = {"terminations": {"time_limit": {"max_steps": 30}, "goal_reached": {"distance_m": 0.3}}}
    simulation = simulation_of(robots, task=task)
    names = [group.name for group in simulation.external]
    # The second robot is a group of its own, or the second of the first's.
    other, row = (names[1], 0) if len(names) == 2 else (names[0], 1)
    set_goal(simulation, row, motion_of_group(simulation, other).position_w[row, :2], other)

    def step(turn: float) -> Any:
        return act(simulation, **{name: [0.4, turn] for name in names})

    first = step(0.0).groups[other]
    assert first.reward[row] == 100.0
    assert first.terminated[row] and not first.truncated[row]
    assert metric(simulation, "success", other)[row] == 1.0
    final = metrics(simulation, other)[row].copy()
    for _ in range(10):
        step(1.0)
    here = motion_of_group(simulation, other).position_w[row].copy()
    for _ in range(11, 29):
        taken = step(1.0)
        assert taken.groups[other].reward[row] == 0.0
        assert taken.groups[names[0]].reward[0] != 0.0
        assert taken.groups[other].terminated[row] and not taken.groups[other].truncated[row]
        assert not taken.groups[names[0]].terminated[0] and not taken.groups[names[0]].truncated[0]
        assert not taken.done[0]
    np.testing.assert_allclose(motion_of_group(simulation, other).position_w[row], here, atol=1e-3)
    assert np.array_equal(metrics(simulation, other)[row], final, equal_nan=True)
    taken = step(0.0)
    assert taken.truncated[0] and not taken.terminated[0]
    assert taken.groups[names[0]].truncated[0] and not taken.groups[names[0]].terminated[0]
    assert taken.groups[other].terminated[row] and not taken.groups[other].truncated[row]
    simulation.reset()
    assert not state_of_group(simulation, other).done[row]
    assert metric(simulation, "success", other)[row] == 0.0
    simulation.close()


def test_the_episode_ends_when_all_have_arrived() -> None:
    simulation = simulation_of(KINDS, task={"terminations": {"goal_reached": {"distance_m": 0.3}}})
    for number, group in enumerate(simulation.external):
        assert not act(simulation).done[0]
        set_goal(simulation, 0, motion_of_group(simulation, group.name).position_w[0, :2], group.name)
        taken = act(simulation)
        assert taken.terminated[0] == taken.done[0] == (number == 1)
        assert taken.groups[group.name].terminated[0]
    simulation.close()


@pytest.mark.parametrize("robots", [KINDS, TWINS], ids=["kinds", "twins"])
def test_where_one_diverges_the_episode_ends_for_all(
    robots: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    simulation = simulation_of(robots, num_scenes=2)
    act(simulation)
    monkeypatch.setattr(simulation.scenes.robots(0)[1], "body_state", lambda: (np.nan,) * 13)
    taken = act(simulation)
    assert taken.truncated.tolist() == [True, False] and not taken.terminated.any()
    diverged = []
    for group in simulation.external:
        outcome = taken.groups[group.name]
        assert outcome.truncated.reshape(2, -1).all(axis=1).tolist() == [True, False]
        assert not outcome.truncated.reshape(2, -1)[1].any() and not outcome.terminated.any()
        assert np.isfinite(observation(simulation, group.name)["lidar"]).all()
        diverged.append(metric(simulation, "diverged", group.name).reshape(2, -1))
    # Of the robot itself alone.
    assert np.concatenate(diverged, axis=1).tolist() == [[0.0, 1.0], [0.0, 0.0]]
    simulation.close()


def robots_of(names: list[str]) -> list[Robot]:
    groups = compose_environment("flat", (), {"robots": names, "actors": "none"}).groups
    return [build_robot(group.body, 1) for group in groups for _ in range(group.count)]


@every_backend
@pytest.mark.parametrize("which", [0, 1])
def test_apart_each_drives_as_if_alone(which: int, backend: Backend) -> None:
    world = build_flat(FlatConf())
    robots = robots_of(KINDS)
    # Leo's rockers ask for 20 iterations: so many for both, alone and together.
    physics = PhysicsConf(solver_iterations=20)
    poses = [
        standing_pose(world, robot.description, 4.0 * index, 0.0, 0.3) for index, robot in enumerate(robots)
    ]
    none = np.zeros((0, 6))
    wanted = [np.array([[0.3, 0.4 * (1 - 2 * index)]]) for index in range(2)]

    class Standing:
        velocity_b = angular_b = roll_pitch_yaw = np.zeros((1, 3))

    commands = [
        robot.commands(action, Standing(), 0.05)[0].tolist()
        for robot, action in zip(robots, wanted, strict=True)
    ]
    shared = backend(scene_spec(world, tuple(robot.body for robot in robots), (), physics))
    alone = backend(scene_spec(world, (robots[which].body,), (), physics))
    for robot, pose in zip(shared.robots, poses, strict=True):
        robot.set_start_pose(*(part.tolist() for part in pose))
    alone.robots[0].set_start_pose(*(part.tolist() for part in poses[which]))
    shared.reset(none)
    alone.reset(none)
    seen = []
    for _ in range(40):
        for robot, command in zip(shared.robots, commands, strict=True):
            robot.set_command(command)
        alone.robots[0].set_command(commands[which])
        step_scene(shared, 10, none)
        step_scene(alone, 10, none)
        seen.append(shared.robots[which].body_state())
    assert np.ptp(np.array(seen)[:, :2], axis=0).max() > 0.1
    np.testing.assert_allclose(seen[-1], alone.robots[0].body_state(), atol=1e-3)
    assert not any(robot.contacts() for robot in shared.robots)
    shared.close()
    alone.close()


@pytest.mark.slow
@pytest.mark.parametrize("robots", [KINDS, TWINS], ids=["kinds", "twins"])
def test_the_first_robot_starts_where_it_starts_alone(robots: list[str]) -> None:
    one = started_simulation("inspection", 1, actors="walkers")
    several = simulation_of(robots, "inspection", actors="walkers")
    for _ in range(6):
        assert np.array_equal(goals_w(one)[0], goals_w(several)[0])
        # To settle takes both of them other solver iterations than one.
        places = [motion_of_group(simulation).position_w[0] for simulation in (one, several)]
        np.testing.assert_allclose(*places, atol=1e-3)
        one.reset()
        several.reset()
    one.close()
    several.close()


@pytest.mark.slow(all_but=["3.0"])
@pytest.mark.parametrize("apart_m", [0.5, 3.0])
def test_robots_start_apart_with_goals_apart(apart_m: float) -> None:
    spawn = {"region": [-5.0, 5.0, -5.0, 5.0], "robots_apart_m": apart_m, "min_goal_distance_m": 2.0}
    simulation = simulation_of([*KINDS, "rover_zero"], num_scenes=8, task={"spawn": spawn})
    radii = np.array(
        [g.body.robot.description.footprint_radius_m for g in simulation.groups for _ in range(g.count)]
    )
    least = radii[:, None] + radii + apart_m
    pairs = np.triu_indices(3, 1)
    starts = set()
    for _ in range(5):
        here = positions(simulation)
        goals = [state_of_group(simulation, group.name) for group in simulation.groups]
        there = np.concatenate([now.by_scene(now.goal.position_w) for now in goals], axis=1)
        # They settle by some millimetres.
        between = np.linalg.norm(here[:, :, None] - here[:, None], axis=-1)
        assert (between[:, *pairs] > least[pairs] - 0.01).all()
        between = np.linalg.norm(there[:, :, None] - there[:, None], axis=-1)
        assert (between[:, *pairs] >= least[pairs]).all()
        assert (np.linalg.norm(there - here, axis=-1) > 2.0 - 0.01).all()
        starts |= set(map(tuple, here.reshape(-1, 2).tolist()))
        simulation.reset()
    assert len(starts) == 3 * 8 * 5
    simulation.close()


def test_no_room_for_another_robot() -> None:
    task = {"spawn": {"region": [-1.5, 1.5, -1.5, 1.5], "min_goal_distance_m": 1.0, "robots_apart_m": 9.0}}
    with pytest.raises(
        WorldError, match=r"no room for another robot beside 1 (.|\n)*, lower task\.spawn\.robots_apart_m"
    ):
        new_simulation("flat", robots=KINDS, task=task)


# -- together --------------------------------------------------------------------------------------


@every_engine
def test_robots_that_meet_both_have_a_collision(engine: Engine) -> None:
    simulation = simulation_of(TWINS, task={**CLOSE, **NO_ARRIVAL}, physics=engine)
    nearest = np.inf
    for _ in range(200):
        apart = distance(simulation)[0]
        drive_at_each_other(simulation)
        clearance = state_of_group(simulation).proximity.clearance("rover")
        nearest = min(nearest, float(clearance.min()))
        assert clearance[0] == clearance[1]
        if metric(simulation, "collisions")[0]:
            break
    # 0.62 m long and 0.443 m wide, each.
    assert 0.44 - 0.03 < distance(simulation)[0] < 0.77 + 0.03
    assert apart < 1.0 and nearest < 0.1
    assert metric(simulation, "collisions").tolist() == [1, 1]
    assert metric(simulation, "min_clearance").tolist() == [0.0, 0.0]
    for _ in range(40):
        drive_at_each_other(simulation)
    assert distance(simulation)[0] > 0.44 - 0.03, "they drive through each other"
    simulation.close()


@every_engine
def test_a_collision_leaves_no_trace_in_the_next_episode(engine: Engine) -> None:
    simulation = simulation_of(KINDS, task={**CLOSE, **NO_ARRIVAL}, physics=engine)

    def drives() -> list[bytes]:
        simulation.reseed(0)
        simulation.reset()
        states = []
        while not metric(simulation, "collisions", "leo_rover")[0]:
            drive_at_each_other(simulation, 0.4)
            states += [robot.body_state() for robot in simulation.scenes.robots(0)]
        return [np.array(state).tobytes() for state in states]

    first = drives()
    assert len(first) > 20
    # They are still pushing at each other.
    assert drives() == first
    simulation.close()


def digest_of_several(engine: Engine) -> str:
    """A rollout of two scenes in which three robots of two kinds drive at random, close together."""
    task = {"spawn": {"region": [-3.0, 3.0, -3.0, 3.0]}, "terminations": {"time_limit": {"max_steps": 25}}}
    simulation = simulation_of(
        [*KINDS, "rover_zero"],
        num_scenes=2,
        physics=engine,
        actors="walkers",
        task=task,
        metrics={"energy": True},
    )
    digest = digest_of(simulation, 60)
    simulation.close()
    return digest


@pytest.mark.slow
def test_equal_seeds_give_equal_bytes_in_any_process() -> None:
    expected = [digest_of_several(engine) for engine in OWN_ENGINES]
    environ = os.environ | {
        "PYTHONPATH": os.pathsep.join(sys.path),
        "PYTHONHASHSEED": "77",
    }
    code = "from test_several_robots import *; print(*map(digest_of_several, reversed(OWN_ENGINES)))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environ, capture_output=True, text=True, check=True
    )
    assert done.stdout.split()[: -len(expected) - 1 : -1] == expected


@pytest.mark.slow(all_but=["bullet"])
@every_engine
def test_a_restored_state_goes_on_as_it_did(engine: Engine) -> None:
    simulation, again = (
        simulation_of([*KINDS, "rover_zero"], num_scenes=2, actors="walkers", physics=engine)
        for _ in range(2)
    )
    rng = np.random.default_rng(0)
    rows = rng.uniform(-1.0, 1.0, (30, 6, 2))

    def step(each: VectorSimulation, row: np.ndarray) -> None:
        act(each, rover=row[:4], leo_rover=row[4:])

    for count, row in enumerate(rows[:20]):
        if count == 7:
            simulation.reset(np.array([False, True]))
        step(simulation, row)
    again.restore(simulation.save_state())
    for row in rows[20:]:
        step(simulation, row)
        step(again, row)
    for group in simulation.external:
        for name, value in observation(simulation, group.name).items():
            assert value.tobytes() == observation(again, group.name)[name].tobytes()
        assert metrics(simulation, group.name).tobytes() == metrics(again, group.name).tobytes()
    simulation.close()
    again.close()


def test_a_list_of_one_is_the_one_robot() -> None:
    digests = []
    for chosen in ({"robots": ["leo_rover"]}, {"robot": "leo_rover"}):
        simulation = started_simulation("flat", 2, **chosen)
        digests.append(digest_of(simulation, 20))
        simulation.close()
    assert digests[0] == digests[1]


# -- settings and refusals -------------------------------------------------------------------------


def test_robots_by_name_with_values_that_differ() -> None:
    conf = compose_environment(
        "flat", (), {"robots": ["leo_rover", {"name": "rover_zero", "wheel_friction": 0.8}]}
    )
    words = compose_environment("flat", ["robots=[leo_rover,{name: rover_zero, wheel_friction: 0.8}]"])
    assert conf.groups == words.groups
    assert conf.groups[1].body == RoverZeroConf(wheel_friction=0.8)


@pytest.mark.parametrize(
    ("robots", "message"),
    [
        ("[rover_zro]", "there is no robot 'rover_zro'; choose "),
        ("[]", "robots must be a list of robots, such as [rover_zero,leo_rover] (got [])"),
        ("[{wheel_friction: 1.0}]", "robots: each is a name or has one: choose "),
        (
            "[rover_zero, {name: leo_rover, wheel_frictio: 1.0}]",
            "robots.1.wheel_frictio is not a setting; did you mean robots.1.wheel_friction?",
        ),
        (
            "[{name: rover_zero, drive: {effective_track_m: -1.0}}]",
            "robots.0.drive.effective_track_m must be above 0.0 (got -1.0)",
        ),
    ],
)
def test_faulty_robots_are_told_in_one_line(robots: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose_environment("flat", [f"robots={robots}"])
    (line,) = str(error.value).splitlines()
    assert line.startswith(message)


def test_gymnasium_refuses_several() -> None:
    with pytest.raises(
        ConfigError, match="one agent group is driven here, and rover and leo_rover are external"
    ):
        dune_rl.gym_env("flat", robots=KINDS)
