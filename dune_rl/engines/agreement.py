"""The same commands in both engines, side by side."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.engines.watched import watched_batch
from dune_rl.geometry.frames import wrap_angle
from dune_rl.physics.interface import ENGINES, Engine

Array = NDArray[np.float64]

# Name, seconds, and command: speed as a share of the robot's best, and heading relative to its own [rad].
PHASES: tuple[tuple[str, float, float, float], ...] = (
    ("straight", 3.0, 0.8, 0.0),
    ("curve", 3.0, 0.5, 0.25),
    ("on the spot", 3.0, 0.0, 0.4),
    ("back", 2.0, -0.5, 0.0),
)
# A phase's first second is for the robot to get there.
_SETTLING_S = 1.0


@dataclass(frozen=True)
class Run:
    """What came of all phases in one engine: means over scenes and time, by phase, and the ends.

    `speed` [m/s], `yaw_rate` [rad/s] and `slip` (1 - speed over what the wheels
    turned) are (P,); `end` (M, 4) is x, y, z [m] and yaw [rad]. `touched` (M,)
    tells which scenes ever met an obstacle.
    """

    speed: Array
    yaw_rate: Array
    slip: Array
    end: Array
    touched: NDArray[np.bool_]


def run(place: str, engine: Engine, robot: str, scenes: int, seed: int) -> Run:
    """Play all phases in `scenes` starts of a place."""
    batch, watched = watched_batch(place, engine, robot, scenes, seed, {})
    batch.reset()
    step_s, wheels = batch.physics.control_step_s, batch.robot.wheels
    speed, rate, slip = (np.full(len(PHASES), np.nan) for _ in range(3))
    for phase, (_, seconds, share, heading) in enumerate(PHASES):
        command = np.tile(np.array([share * batch.robot.max_speed_mps, heading], np.float32), (scenes, 1))
        rows = []
        for step in range(round(seconds / step_s)):
            batch.step(command)
            # Endings begin no new episode here: a robot that is stuck stays so.
            if step * step_s >= _SETTLING_S:
                turned = np.nan
                if wheels is not None:
                    turned = float(np.mean([scene.wheel_speeds for scene in watched])) * wheels.radius_m
                motion = batch.motion
                rows.append((motion.velocity_b[:, 0].mean(), motion.angular_b[:, 2].mean(), turned))
        ahead, turn, rolled = np.mean(rows, axis=0)
        speed[phase], rate[phase] = ahead, turn
        if share:
            slip[phase] = 1.0 - ahead / rolled
    motion = batch.motion
    end = np.column_stack([motion.position_w, motion.roll_pitch_yaw[:, 2]])
    batch.close()
    return Run(speed, rate, slip, end, np.array([scene.has_touched for scene in watched]))


def table(robot: str, places: tuple[str, ...], scenes: int, seed: int) -> str:
    """Both engines' runs of a robot as two tables in Markdown."""
    heads = ("place", "phase", *(f"{what}, {engine}" for what in _MEASURES for engine in ENGINES))
    phases = [_row(heads), _row(["---"] * len(heads))]
    ends = [
        _row(
            ("place", "free starts", "distance between ends, median / greatest", "yaw between ends, median")
        ),
        _row(["---"] * 4),
    ]
    for place in places:
        runs = {engine: run(place, engine, robot, scenes, seed) for engine in ENGINES}
        for number, (name, *_) in enumerate(PHASES):
            cells = [
                _figure(getattr(runs[engine], field)[number]) + unit
                for field, unit in _MEASURES.values()
                for engine in ENGINES
            ]
            phases.append(_row((place, name, *cells)))
        one, other = (runs[engine] for engine in ENGINES)
        free = ~(one.touched | other.touched)
        apart = np.linalg.norm(one.end[:, :3] - other.end[:, :3], axis=1)[free]
        turned = np.abs(wrap_angle(one.end[:, 3] - other.end[:, 3]))[free]
        if free.any():
            greatest = f"{np.median(apart):.2f} m / {apart.max():.2f} m"
            ends.append(_row((place, f"{free.sum()} of {scenes}", greatest, f"{np.median(turned):.2f} rad")))
    return "\n".join([*phases, "", *ends])


_MEASURES = {"speed": ("speed", " m/s"), "yaw rate": ("yaw_rate", " rad/s"), "slip": ("slip", "")}


def _row(cells: tuple[str, ...] | list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _figure(value: float) -> str:
    return "-" if np.isnan(value) else f"{value + 0.0:.3f}"
