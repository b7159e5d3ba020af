"""The same commands in both engines, side by side."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.engine_comparison.watched import watched_batch
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
    """What came of all phases in one engine: means over time, by scene and phase, and the ends.

    `speed` [m/s], `yaw_rate` [rad/s] and `rolled` [m/s], what the wheels turned,
    are (M, P); `end` (M, 4) is x, y, z [m] and yaw [rad]. `touched` (M,)
    tells which scenes ever met an obstacle.
    """

    speed: Array
    yaw_rate: Array
    rolled: Array
    end: Array
    touched: NDArray[np.bool_]


def run(place: str, engine: Engine, robot: str, scenes: int, seed: int) -> Run:
    """Play all phases in `scenes` starts of a place."""
    batch, watched = watched_batch(place, engine, robot, scenes, seed, {})
    batch.reset()
    step_s, wheels = batch.physics.control_step_s, batch.robot.wheels
    means = np.full((3, scenes, len(PHASES)), np.nan)
    for phase, (_, seconds, share, heading) in enumerate(PHASES):
        command = np.tile(np.array([share * batch.robot.max_speed_mps, heading], np.float32), (scenes, 1))
        rows = []
        for step in range(round(seconds / step_s)):
            batch.step(command)
            # Endings begin no new episode here: a robot that is stuck stays so.
            if step * step_s >= _SETTLING_S:
                turned = np.full(scenes, np.nan)
                if wheels is not None:
                    turned = np.array([scene.wheel_speeds.mean() for scene in watched]) * wheels.radius_m
                rows.append((batch.motion.velocity_b[:, 0], batch.motion.angular_b[:, 2], turned))
        means[:, :, phase] = np.mean(rows, axis=0)
    motion = batch.motion
    end = np.column_stack([motion.position_w, motion.roll_pitch_yaw[:, 2]])
    batch.close()
    speed, yaw_rate, rolled = means
    return Run(speed, yaw_rate, rolled, end, np.array([scene.has_touched for scene in watched]))


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
        one, other = (runs[engine] for engine in ENGINES)
        # Who meets a wall in one engine and just misses it in the other tells nothing of either.
        free = ~(one.touched | other.touched)
        if not free.any():
            continue
        for number, (name, _, share, _) in enumerate(PHASES):
            cells = []
            for what, unit in _MEASURES.items():
                for engine in ENGINES:
                    figure = _measure(what, runs[engine], free, number)
                    shown = not np.isnan(figure) and (what != "slip" or share != 0.0)
                    cells.append(f"{figure + 0.0:.3f}{unit}" if shown else "-")
            phases.append(_row((place, name, *cells)))
        apart = np.linalg.norm(one.end[:, :3] - other.end[:, :3], axis=1)[free]
        turned = np.abs(wrap_angle(one.end[:, 3] - other.end[:, 3]))[free]
        greatest = f"{np.median(apart):.2f} m / {apart.max():.2f} m"
        ends.append(_row((place, f"{free.sum()} of {scenes}", greatest, f"{np.median(turned):.2f} rad")))
    return "\n".join([*phases, "", *ends])


_MEASURES = {"speed": " m/s", "yaw rate": " rad/s", "slip": ""}


def _measure(what: str, run: Run, free: NDArray[np.bool_], phase: int) -> float:
    speed, rolled = run.speed[free, phase].mean(), run.rolled[free, phase].mean()
    if what == "slip":
        return float(1.0 - speed / rolled)
    return float(speed if what == "speed" else run.yaw_rate[free, phase].mean())


def _row(cells: tuple[str, ...] | list[str]) -> str:
    return f"| {' | '.join(cells)} |"
