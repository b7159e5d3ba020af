"""Persons that a behaviour moves, beside a robot at constant velocity, without physics."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from states import group_state, motion_of
from yards import yard

from dune_rl.behaviours.drivers.context import BoundBehaviour, DriverContext
from dune_rl.behaviours.registry import BEHAVIOURS
from dune_rl.bodies.person import PersonConf
from dune_rl.env.kinematic import KinematicBody
from dune_rl.rendering.weather import WeatherConf
from dune_rl.state import BodyDescription, EpisodeState, GroupState, Motion, State
from dune_rl.state.unicycle import Unicycle
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import World

STEP_S = 0.05
RADIUS_M = 0.25
ROBOT_REACH_M = 0.3
TOP_MPS = 1.5
FAR_AWAY = ((90.0, 90.0),)


class Stage:
    """Scenes of persons that start at `poses` (M, G, 3: x, y, yaw), and robots in each, (M, R, 2).

    Robots go at `robot_velocity` (2,) [m/s]. Scene m runs the episode `first_episode` + m.
    """

    def __init__(
        self,
        settings: dict,
        poses: np.ndarray,
        *,
        world: World | None = None,
        robots: np.ndarray | Sequence = FAR_AWAY,
        robot_velocity: Sequence[float] = (0.0, 0.0),
        seed: int = 0,
        first_episode: int = 0,
    ) -> None:
        poses = np.asarray(poses, float)
        scenes, self.count = poses.shape[:2]
        self.worlds = BatchedWorlds([(world or yard(), WeatherConf())] * scenes)
        self.body = KinematicBody(PersonConf(speed_mps=TOP_MPS), self.worlds, self.count, STEP_S)
        for scene in range(scenes):
            x, y, yaw = poses[scene].T
            self.body.place(scene, np.column_stack([x, y, np.zeros(self.count), yaw]))
        self.body.read_start(np.ones(scenes * self.count, bool))
        robots = np.asarray(robots, float)
        self.robots = np.broadcast_to(robots, (scenes, *robots.shape[-2:])).copy()
        self.robot_velocity = np.array(robot_velocity, float)
        self.behaviour = BEHAVIOURS.build(BEHAVIOURS.parse_settings(settings), scenes * self.count)
        if isinstance(self.behaviour, BoundBehaviour):
            size = 2 * RADIUS_M
            vehicle = Unicycle(0.0, TOP_MPS, 3.0, 1.0 / STEP_S, size, size, RADIUS_M)
            self.behaviour.bind(DriverContext("people", vehicle, None, dict))
        self.seed, self.ids, self.steps = seed, first_episode + np.arange(scenes), 0
        self.behaviour.reset(np.ones(scenes * self.count, bool), self.state().groups["people"])

    @property
    def places(self) -> np.ndarray:
        """Where the persons are, (M, G, 2)."""
        return self.body.poses[:, :2].reshape(-1, self.count, 2)

    @property
    def headings(self) -> np.ndarray:
        """Where the persons look, (M, G)."""
        return self.body.poses[:, 3].reshape(-1, self.count)

    def state(self) -> State:
        """The state now."""
        people = self._group("people", self.body.motion, self.count, RADIUS_M)
        robots = self._group(
            "robot", self._robot_motion(), self.robots.shape[1], ROBOT_REACH_M, is_robot=True
        )
        return State({"people": people, "robot": robots}, self.worlds, len(self.robots))

    def _group(
        self, name: str, motion: Motion, count: int, reach_m: float, *, is_robot: bool = False
    ) -> GroupState:
        ids = np.repeat(self.ids, count)
        streams = ids + np.tile(np.arange(count), len(self.ids)) * (1 << 40)
        steps = np.full(len(ids), self.steps)
        group = group_state(motion, count=count, name=name)
        episode = EpisodeState(self.seed, ids, steps, streams, STEP_S)
        body = BodyDescription(reach_m=reach_m, is_robot=is_robot)
        return replace(group, episode=episode, body=body)

    def _robot_motion(self) -> Motion:
        states = np.zeros((self.robots[..., 0].size, 13))
        states[:, :2] = self.robots.reshape(-1, 2)
        half = np.arctan2(self.robot_velocity[1], self.robot_velocity[0]) / 2
        states[:, 5], states[:, 6] = np.sin(half), np.cos(half)
        states[:, 7:9] = self.robot_velocity
        return motion_of(states)

    def act(self) -> np.ndarray:
        """The behaviour's actions (N, 2)."""
        state = self.state()
        return self.behaviour.act(state, state.groups["people"])

    def step(self) -> None:
        """Everybody moves."""
        self.body.command(self.act(), self.body.motion)
        self.body.read()
        self.robots = self.robots + STEP_S * self.robot_velocity
        self.steps += 1

    def run(self, duration_s: float) -> np.ndarray:
        """The persons' places (T, M, G, 2) after each step of some seconds."""
        found = []
        for _ in range(round(duration_s / STEP_S)):
            self.step()
            found.append(self.places.copy())
        return np.array(found)


def circle(count: int, radius_m: float) -> np.ndarray:
    """Poses (1, G, 3) on a circle, facing its middle."""
    angles = 2.0 * np.pi * np.arange(count) / count
    return np.stack([radius_m * np.cos(angles), radius_m * np.sin(angles), angles + np.pi], axis=-1)[None]


def gaps(places: np.ndarray) -> np.ndarray:
    """Smallest distance (...) between any two of the places (..., G, 2)."""
    apart = np.linalg.norm(places[..., None, :, :] - places[..., None, :], axis=-1)
    count = places.shape[-2]
    return apart[..., ~np.eye(count, dtype=bool)].min(axis=-1)


def turns(track: np.ndarray, least_mps: float = 0.2) -> np.ndarray:
    """Angles [rad] between the steps of a track (T, 2), where it moves at `least_mps` or faster."""
    steps = np.diff(track, axis=0)
    moves = np.linalg.norm(steps, axis=1) > least_mps * STEP_S
    course = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])[moves])
    return np.abs(np.diff(course))
