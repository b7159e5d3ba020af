"""Lowest and highest values of every observation and action: one source for all three interfaces."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.env.batch import Batch
from dune_rl.env.motion import MAX_SENSED_SPEED_MPS, MAX_SENSED_TURN_RADPS

Floats = NDArray[np.float32]
Bounds = tuple[Floats, Floats]

_PI = np.nextafter(np.float32(np.pi), np.float32(4.0))


def _symmetric(high: list[float]) -> Bounds:
    top = np.array(high, np.float32)
    return -top, top


def rover_observation_bounds(batch: Batch) -> dict[str, Bounds]:
    """(low, high), each (n,), of the rover's observations, in the order of `sensors.enabled`."""
    sensors = batch.sensors
    acceleration, turn = sensors.imu.acceleration_range_mps2, sensors.imu.angular_range_radps
    scan = (
        np.full(sensors.lidar.n_segments, sensors.lidar.min_range_m, np.float32),
        np.full(sensors.lidar.n_segments, sensors.lidar.range_m, np.float32),
    )
    everything: dict[str, Bounds] = {
        "lidar": scan,
        "lidar_past": scan,
        "imu": _symmetric([acceleration] * 3 + [turn] * 3 + [_PI] * 3),
        "goal": (
            np.array([0.0, -_PI], np.float32),
            np.array([batch.world_diagonal_m, _PI], np.float32),
        ),
        "velocity": _symmetric([MAX_SENSED_SPEED_MPS, MAX_SENSED_TURN_RADPS]),
    }
    return {name: everything[name] for name in sensors.enabled}


def rover_action_bounds(batch: Batch) -> Bounds:
    """(low, high), each (2,): speed [m/s] and heading relative to the present one [rad]."""
    return _symmetric([batch.robot.max_speed_mps, np.pi])


def walker_observation_bounds(batch: Batch) -> dict[str, Bounds]:
    """(low, high), each (n,), of what an actor that is an agent observes."""
    far = batch.world_diagonal_m
    top = float(batch.actors.top_speed[batch.actors.external].max())
    closing = batch.max_closing_speed_mps
    return {
        "goal": (np.array([0.0, -_PI], np.float32), np.array([far, _PI], np.float32)),
        "rover": (
            np.array([0.0, -_PI, -closing, -closing], np.float32),
            np.array([far, _PI, closing, closing], np.float32),
        ),
        "velocity": _symmetric([top * 1.01, top * 1.01]),
    }


def walker_action_bounds(batch: Batch) -> Bounds:
    """(low, high), each (2,): speed [m/s], not backwards, and heading relative to the present one [rad].

    Groups share one space, so the speed reaches that of the fastest; a slower
    actor walks at its own top speed. A turn takes time: at most 3 rad/s.
    """
    top = float(batch.actors.top_speed[batch.actors.external].max())
    return np.array([0.0, -np.pi], np.float32), np.array([top, np.pi], np.float32)
