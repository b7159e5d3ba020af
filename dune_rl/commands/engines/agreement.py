"""Equal commands in both engines, and how far their results differ."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dune_rl.commands.engines.recording import RecordedSimulation
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import wrap_angle
from dune_rl.physics.interface import OWN_ENGINES, Engine

# Name, duration [s], and command: speed as a share of the robot's largest, and relative heading [rad].
PHASES: tuple[tuple[str, float, float, float], ...] = (
    ("straight", 3.0, 0.8, 0.0),
    ("curve", 3.0, 0.5, 0.25),
    ("on the spot", 3.0, 0.0, 0.4),
    ("back", 2.0, -0.5, 0.0),
)
# The first second of a phase, in which the robot accelerates, is not evaluated.
_SETTLING_S = 1.0


@dataclass(frozen=True)
class EngineRun:
    """Results of all P phases in one engine: means over time per scene and phase, and final poses.

    `speed` [m/s], `yaw_rate` [rad/s] and `wheel_speed` [m/s], at the wheels'
    circumference, are (M, P); `final_pose` (M, 4) is x, y, z [m] and yaw
    [rad]. `had_contact` (M,) marks scenes whose robot ever hit an obstacle.
    """

    speed: Array
    yaw_rate: Array
    wheel_speed: Array
    final_pose: Array
    had_contact: Flags


def run_phases(world: str, engine: Engine, robot: str, scenes: int, seed: int) -> EngineRun:
    """Drive all phases from `scenes` starts in a world."""
    recorded = RecordedSimulation(world, engine, robot, scenes, seed)
    recorded.simulation.reset()
    described, step_s = recorded.robot.description, recorded.step_s
    wheels = described.wheels
    means = np.full((3, scenes, len(PHASES)), np.nan)
    for phase, (_, seconds, share, heading) in enumerate(PHASES):
        command = np.tile(np.array([share * described.max_speed_mps, heading], np.float32), (scenes, 1))
        rows = []
        for step in range(round(seconds / step_s)):
            # Episodes are not reset when they end: a stuck robot stays stuck.
            recorded.step(command)
            if step * step_s >= _SETTLING_S:
                turned = np.full(scenes, np.nan)
                if wheels is not None:
                    speeds = [scene.wheel_speeds[: wheels.num_driven].mean() for scene in recorded.scenes]
                    turned = np.array(speeds) * wheels.radius_m
                rows.append((recorded.motion.velocity_b[:, 0], recorded.motion.angular_b[:, 2], turned))
        means[:, :, phase] = np.mean(rows, axis=0)
    motion = recorded.motion
    final_pose = np.column_stack([motion.position_w, motion.roll_pitch_yaw[:, 2]])
    recorded.simulation.close()
    speed, yaw_rate, wheel_speed = means
    return EngineRun(
        speed, yaw_rate, wheel_speed, final_pose, np.array([scene.had_contact for scene in recorded.scenes])
    )


def agreement_tables(robot: str, worlds: tuple[str, ...], scenes: int, seed: int) -> str:
    """Both engines' runs of a robot as two Markdown tables."""
    phases = [("world", "phase", *(f"{what}, {engine}" for what in _UNITS for engine in OWN_ENGINES))]
    ends = [("world", "free starts", "distance between ends, median / largest", "yaw between ends, median")]
    for world in worlds:
        runs = {engine: run_phases(world, engine, robot, scenes, seed) for engine in OWN_ENGINES}
        one, other = runs.values()
        # A robot that hits a wall in one engine and just passes it in the other says nothing about either.
        free = ~(one.had_contact | other.had_contact)
        if not free.any():
            continue
        for number, (name, _, share, _) in enumerate(PHASES):
            values = {(what, run): _mean(what, runs[run], free, number) for what in _UNITS for run in runs}
            phases.append((world, name, *(_cell(what, value, share) for (what, _), value in values.items())))
        apart = np.linalg.norm(one.final_pose[:, :3] - other.final_pose[:, :3], axis=1)[free]
        turned = np.abs(wrap_angle(one.final_pose[:, 3] - other.final_pose[:, 3]))[free]
        distances = f"{np.median(apart):.2f} m / {apart.max():.2f} m"
        ends.append((world, f"{free.sum()} of {scenes}", distances, f"{np.median(turned):.2f} rad"))
    return f"{_table(phases)}\n\n{_table(ends)}"


_UNITS = {"speed": " m/s", "yaw rate": " rad/s", "slip": ""}


def _mean(what: str, run: EngineRun, free: Flags, phase: int) -> float:
    speed, wheel_speed = run.speed[free, phase].mean(), run.wheel_speed[free, phase].mean()
    if what == "slip":
        return float(1.0 - speed / wheel_speed)
    return float(speed if what == "speed" else run.yaw_rate[free, phase].mean())


def _cell(what: str, value: float, share: float) -> str:
    is_defined = not np.isnan(value) and (what != "slip" or share != 0.0)
    return f"{value + 0.0:.3f}{_UNITS[what]}" if is_defined else "-"


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *others = rows
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *others))
