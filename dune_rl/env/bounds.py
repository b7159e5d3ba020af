"""Lowest and highest values of every observation and action: one source for all three interfaces."""

import numpy as np

from dune_rl.env.batch import Batch
from dune_rl.sensors.sensor import PI32, Bounds


def _symmetric(high: list[float]) -> Bounds:
    top = np.array(high, np.float32)
    return -top, top


def rover_observation_bounds(batch: Batch, rover: int = 0) -> dict[str, Bounds]:
    """(low, high), each in a reading's own shape and type, in the order of `sensors.enabled`."""
    return batch.rovers[rover].senses.bounds


def rover_action_bounds(batch: Batch, rover: int = 0) -> Bounds:
    """(low, high), each (A,): for most, speed [m/s] and heading relative to the present one [rad]."""
    low, high = batch.rovers[rover].robot.action_bounds()
    return low.astype(np.float32), high.astype(np.float32)


def walker_observation_bounds(batch: Batch) -> dict[str, Bounds]:
    """(low, high), each (n,), of what an actor that is an agent observes."""
    far = batch.farthest_goal_m
    top = float(batch.actors.top_speed[batch.actors.external].max())
    closing = batch.max_closing_speed_mps
    return {
        "goal": (np.array([0.0, -PI32], np.float32), np.array([far, PI32], np.float32)),
        "rover": (
            np.array([0.0, -PI32, -closing, -closing], np.float32),
            np.array([far, PI32, closing, closing], np.float32),
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
