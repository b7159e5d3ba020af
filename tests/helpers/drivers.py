"""Drivers on kinematic bodies: a unicycle that does what it is told, in a world, among walkers."""

from dataclasses import dataclass

import numpy as np
from states import STEP_S, group_state, motion_of

from dune_rl.behaviours.drivers.context import DriverContext
from dune_rl.geometry.frames import wrap_angle
from dune_rl.rendering.weather import WeatherConf
from dune_rl.sensors.lidar import LidarConf, beam_angles
from dune_rl.state import GoalState, GroupState, State
from dune_rl.state.unicycle import Unicycle
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import World

ROVER = Unicycle(-1.0, 1.0, 2.0, 2.0, length_m=0.6, width_m=0.44, footprint_radius_m=0.372)
LIDAR = LidarConf()


@dataclass
class DrivenBodies:
    """N bodies at `poses` (N, 3: x, y, yaw), each in a scene of `world` of its own.

    `walkers` (N, K, 4: x, y, vx, vy) walk straight on.
    """

    world: World
    poses: np.ndarray
    goals: np.ndarray
    walkers: np.ndarray
    vehicle: Unicycle = ROVER
    steps: int = 0

    def __post_init__(self) -> None:
        self.poses = np.atleast_2d(np.asarray(self.poses, float)).copy()
        self.goals = np.atleast_2d(np.asarray(self.goals, float))
        self.walkers = np.asarray(self.walkers, float).reshape(len(self.poses), -1, 4).copy()
        self.twists = np.zeros((len(self.poses), 2))
        self.ground = BatchedWorlds([(self.world, WeatherConf())] * len(self.poses))

    def state(self) -> tuple[State, GroupState]:
        """The state, with the bodies as the only group."""
        rows = len(self.poses)
        yaw = self.poses[:, 2]
        states = np.zeros((rows, 13))
        states[:, :2] = self.poses[:, :2]
        states[:, 5], states[:, 6] = np.sin(yaw / 2), np.cos(yaw / 2)
        states[:, 7], states[:, 8] = self.twists[:, 0] * np.cos(yaw), self.twists[:, 0] * np.sin(yaw)
        states[:, 12] = self.twists[:, 1]
        away = self.goals - self.poses[:, :2]
        distance = np.hypot(*away.T)
        goal = GoalState(self.goals, distance, distance, wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - yaw))
        neighbours = np.zeros((rows, self.walkers.shape[1], 7))
        neighbours[..., :2] = self.walkers[..., :2]
        group = group_state(motion_of(states), neighbours, steps=self.steps, goal=goal)
        return State({group.name: group}, self.ground, rows), group

    def move(self, actions: np.ndarray) -> None:
        """Obey `actions` (N, 2) for a control step; the walkers walk on."""
        vehicle = self.vehicle
        speed = np.clip(actions[:, 0], vehicle.min_speed_mps, vehicle.max_speed_mps)
        most = vehicle.max_yaw_rate_radps
        turn = np.clip(vehicle.heading_gain_per_s * actions[:, 1], -most, most)
        self.poses[:, 2] = wrap_angle(self.poses[:, 2] + turn * STEP_S)
        self.poses[:, 0] += speed * STEP_S * np.cos(self.poses[:, 2])
        self.poses[:, 1] += speed * STEP_S * np.sin(self.poses[:, 2])
        self.twists = np.stack([speed, turn], axis=1)
        self.walkers[..., :2] += self.walkers[..., 2:] * STEP_S
        self.steps += 1

    def distances(self) -> np.ndarray:
        """Distance (N, K) [m] of the bodies' rectangles from the walkers' centres."""
        away = self.walkers[..., :2] - self.poses[:, None, :2]
        cos, sin = np.cos(self.poses[:, 2:]), np.sin(self.poses[:, 2:])
        ahead = np.abs(cos * away[..., 0] + sin * away[..., 1]) - self.vehicle.length_m / 2
        aside = np.abs(cos * away[..., 1] - sin * away[..., 0]) - self.vehicle.width_m / 2
        return np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0))

    def readings(self, discs: np.ndarray) -> dict[str, np.ndarray]:
        """What goal, LiDAR and velocity read among `discs` (D, 3: x, y, radius), by formula."""
        _, group = self.state()
        bearing = self.poses[:, 2:] + beam_angles(LIDAR)
        along = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        ranges = np.full(bearing.shape, LIDAR.range_m)
        for x, y, radius in discs:
            away = np.array([x, y]) - self.poses[:, None, :2]
            ahead = (along * away).sum(axis=-1)
            under = radius**2 - ((away**2).sum(axis=-1) - ahead**2)
            hit = (under > 0.0) & (ahead > 0.0)
            ranges = np.where(hit, np.minimum(ranges, ahead - np.sqrt(np.maximum(under, 0.0))), ranges)
        segments = ranges.reshape(len(ranges), LIDAR.n_segments, -1).min(axis=2)
        goal = np.stack([group.goal.distance, group.goal.bearing], axis=1)
        return {
            "goal": goal.astype(np.float32),
            "lidar": segments.astype(np.float32),
            "velocity": self.twists.astype(np.float32),
        }

    def context(self, discs: np.ndarray | None = None) -> DriverContext:
        """What a driver of these bodies is bound to; without `discs` nothing is observed."""
        if discs is None:
            return DriverContext("rover", self.vehicle, None, dict)
        return DriverContext("rover", self.vehicle, LIDAR, lambda: self.readings(discs))


def drive(driver, bodies: DrivenBodies, steps: int, discs: np.ndarray | None = None) -> np.ndarray:
    """Poses (steps + 1, N, 3) under a driver until all have arrived."""
    driver.bind(bodies.context(discs))
    _, group = bodies.state()
    driver.reset(np.ones(len(bodies.poses), bool), group)
    poses = [bodies.poses.copy()]
    for _ in range(steps):
        bodies.move(driver.act(*bodies.state()))
        poses.append(bodies.poses.copy())
        if (np.hypot(*(bodies.goals - bodies.poses[:, :2]).T) < 0.5).all():
            break
    return np.array(poses)
