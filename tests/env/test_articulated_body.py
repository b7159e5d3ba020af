"""What is read of robots in physics: their motion, their joints, and what to believe of impossible states."""

from typing import Any

import numpy as np
import pytest
from scenes import about
from scripted_physics import ScriptedRobot

from dune_rl.env.articulated import ArticulatedBody
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.physics.interface import PhysicsConf
from dune_rl.rendering.weather import WeatherConf
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.flat import FlatConf, build_flat

STEP_S = 0.05
LEFT = tuple(about([0, 0, 1], np.pi / 2))


def physics_state(position=(0, 0, 0), quaternion=(0, 0, 0, 1), velocity=(0, 0, 0), angular=(0, 0, 0)):
    return np.array([*position, *quaternion, *velocity, *angular], float)


class ReadRobots:
    """Robots that are where a test puts them, and the body that reads them; they begin at rest."""

    def __init__(self, rows: int = 1) -> None:
        robot = RoverZero(RoverZeroConf(), rows)
        worlds = BatchedWorlds([(build_flat(FlatConf()), WeatherConf())] * rows)
        self.body = ArticulatedBody(robot, PhysicsConf(), worlds, 1)
        self.body.reads_joints = True
        self.engines: list[Any] = [ScriptedRobot(robot.body) for _ in range(rows)]
        self.body.engines = self.engines
        self.body.read_start(np.ones(rows, bool))

    def read(self, *states: dict[str, Any]) -> None:
        for engine, state in zip(self.engines, states, strict=True):
            engine.state = physics_state(**state)
        self.body.read()

    @property
    def motion(self):
        return self.body.motion


def test_motion_is_that_of_physics_in_the_world_and_in_the_body_s_frame():
    robots = ReadRobots()
    quaternion = about([0.6, 0.0, 0.8], 1.1)
    robots.read(
        {"position": (1, 2, 3), "quaternion": quaternion, "velocity": (0.3, 0.7, 0), "angular": (0, 1, 2)}
    )
    motion, rotation = robots.motion, rotation_matrices(quaternion)
    np.testing.assert_array_equal(motion.position_w, [[1, 2, 3]])
    np.testing.assert_allclose(motion.rotation[0], rotation)
    np.testing.assert_allclose(motion.velocity_b[0], rotation.T @ [0.3, 0.7, 0], atol=1e-12)
    np.testing.assert_allclose(motion.angular_b[0], rotation.T @ [0, 1, 2], atol=1e-12)
    assert motion.tilt[0] == pytest.approx(np.arccos(rotation[2, 2]))
    robots.read({"quaternion": LEFT})
    assert robots.motion.yaw[0] == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(robots.body.poses, [[0, 0, 0, np.pi / 2]], atol=1e-12)


def test_acceleration_is_the_change_of_velocity_over_a_step_in_the_body_s_frame():
    robots = ReadRobots()
    np.testing.assert_array_equal(robots.motion.acceleration_b, [[0, 0, 0]])
    robots.read({"quaternion": LEFT, "velocity": (0.0, 0.5, -0.1)})
    np.testing.assert_allclose(robots.motion.acceleration_b, [[10.0, 0.0, -2.0]], atol=1e-9)
    robots.read({"quaternion": LEFT, "velocity": (0.0, 0.5, -0.1)})
    np.testing.assert_allclose(robots.motion.acceleration_b, [[0.0, 0.0, 0.0]], atol=1e-9)
    robots.read({"quaternion": LEFT, "velocity": (1.0, 0.5, -0.1)})
    np.testing.assert_allclose(robots.motion.acceleration_b, [[0.0, -20.0, 0.0]], atol=1e-9)


def test_a_new_episode_begins_without_acceleration_and_leaves_the_others():
    robots = ReadRobots(2)
    robots.read({"velocity": (1.0, 0, 0)}, {"velocity": (1.0, 0, 0)})
    robots.engines[0].state = physics_state(velocity=(3.0, 0, 0))
    robots.body.read_start(np.array([True, False]))
    np.testing.assert_allclose(robots.motion.acceleration_b, [[0, 0, 0], [20, 0, 0]], atol=1e-9)
    robots.read({"velocity": (3.0, 0, 0)}, {"velocity": (1.0, 0, 0)})
    np.testing.assert_allclose(robots.motion.acceleration_b, [[0, 0, 0], [0, 0, 0]], atol=1e-9)


@pytest.mark.parametrize(
    "broken",
    [
        {"velocity": (np.nan, 0, 0)},
        {"velocity": (0, 60.0, 0)},
        {"angular": (0, 0, -300.0)},
        {"position": (1e6, 0, 0)},
        {"quaternion": (0, 0, 0, 2.0)},
        {"quaternion": (0, np.inf, 0, 1)},
    ],
)
def test_a_state_that_cannot_be_leaves_the_last_good_one(broken):
    robots = ReadRobots(2)
    good = {"position": (1, 2, 3), "velocity": (0.5, 0, 0)}
    robots.read(good, good)
    robots.read({}, broken)
    motion = robots.motion
    assert motion.diverged.tolist() == [False, True]
    np.testing.assert_array_equal(motion.position_w, [[0, 0, 0], [1, 2, 3]])
    np.testing.assert_array_equal(motion.velocity_b, [[0, 0, 0], [0.5, 0, 0]])
    assert np.isfinite(motion.acceleration_b).all() and np.isfinite(motion.roll_pitch_yaw).all()
    robots.read(good, good)
    assert not robots.motion.diverged.any()


def test_a_new_episode_is_not_diverged_from_the_last_one():
    robots = ReadRobots(2)
    robots.read({"velocity": (np.nan, 0, 0)}, {"velocity": (np.nan, 0, 0)})
    robots.engines[0].state = physics_state()
    robots.body.read_start(np.array([True, False]))
    assert robots.motion.diverged.tolist() == [False, True]


def test_joints_of_diverged_physics_stay_as_they_were():
    robots = ReadRobots(2)
    drives = np.arange(24.0).reshape(2, 12)
    for engine, drive in zip(robots.engines, drives, strict=True):
        engine.drive = drive
    robots.read({}, {})
    for engine, drive in zip(robots.engines, drives, strict=True):
        engine.drive = drive + 1.0
    robots.engines[1].drive[3] = np.inf
    robots.read({"velocity": (np.nan, 0, 0)}, {})
    joints = robots.motion.joints
    assert joints is not None
    np.testing.assert_array_equal(np.hstack([joints.angle, joints.speed, joints.torque]), drives)
    # What decides an episode's end does not depend on who reads joints.
    np.testing.assert_array_equal(robots.motion.diverged, [True, False])


def test_a_state_that_was_read_stays_as_it_is():
    robots = ReadRobots()
    robots.read({"position": (1, 2, 3), "velocity": (0.5, 0, 0)})
    kept = robots.motion
    robots.read({"position": (4, 5, 6)})
    robots.body.read_start(np.array([True]))
    np.testing.assert_array_equal(kept.position_w, [[1, 2, 3]])
    np.testing.assert_array_equal(kept.velocity_w, [[0.5, 0, 0]])
