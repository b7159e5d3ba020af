"""The <actor>s of SDF files: the trajectories of their scripts."""

from xml.etree.ElementTree import Element

import numpy as np

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import ImportReport, printable
from dune_rl.geometry.arrays import Array
from dune_rl.worlds.actor_trajectory import (
    FARTHEST_M,
    LONGEST_S,
    MOST_WAY_POINTS,
    ActorTrajectory,
    unwrap_yaw,
)
from dune_rl.worlds.importing.sdf.elements import parse_numbers, parse_pose
from dune_rl.worlds.world import World

MOST_ACTORS = 500
# A loop whose ends are farther apart than this is closed by a way back, at this speed if the script has none.
_CLOSED_M, _USUAL_MPS = 0.1, 1.0
# Distance of the places where obstacles are looked for, and how many these are.
_LOOK_M, _MOST_LOOKS = 0.25, 20_000
_TRUE = ("true", "1")
# Does not concern who wants nothing but the trajectories.
SKIN_NOTE = "skins and animations of <actor>s are not drawn; a person of ours walks in their place"
# Where the spline is farther than this from the line between two way-points, points of it are added.
_STRAY_M = 0.02
_MOST_PARTS = 64
# Gazebo takes a trajectory whose ends are as close as this for a closed one.
_SAME_END_M = 1e-3


def parse_actor(element: Element, matrix: Array, report: ImportReport) -> ActorTrajectory | None:
    """The trajectory of an <actor> in the frame `matrix` (4, 4); None, with a warning, if it has none.

    Trajectories of a script follow one another, each on its own spline as in Gazebo. Way-points of equal
    times count once, the last of them.
    """
    name = printable(element.get("name") or "actor", 60)
    points = _way_points(element, name, matrix)
    if not points:
        plugin = element.find("plugin")
        mover = "" if plugin is None else printable(plugin.get("name") or "without a name", 60)
        reason = f"is moved by a plugin ({mover}), " if mover else ""
        report.warn(f"the actor {name!r} {reason}has no <trajectory> and is left out")
        return None
    if element.find("skin") is not None or element.find("animation") is not None:
        report.warn(SKIN_NOTE)
    times, poses = _in_order(points)
    script = element.find("script")
    assert script is not None
    loop = (script.findtext("loop") or "true").strip() in _TRUE
    delay_s = float(parse_numbers(script.find("delay_start"), 1, (0.0,))[0])
    if not 0.0 <= delay_s <= LONGEST_S:
        raise WorldError(
            f"<delay_start> of the actor {name!r} must be 0 to {LONGEST_S:g} s (got {delay_s:g})."
        )
    # Until the first way-point's time the actor stands there.
    delay_s, times = delay_s + float(times[0]), times - times[0]
    if (script.findtext("auto_start") or "true").strip() not in _TRUE:
        report.warn(f"the actor {name!r} stands at its start, since its <auto_start> is false")
        times, poses = times[:1], poses[:1]
    elif loop:
        times, poses = close_loop(name, times, poses, report)
    return ActorTrajectory(name, times, poses, loop, delay_s)


def _way_points(element: Element, name: str, matrix: Array) -> dict[float, Array]:
    """Poses (4,) by time [s] of all trajectories of an actor's script."""
    points: dict[float, Array] = {}
    start = 0.0
    for trajectory in element.findall("script/trajectory"):
        own: dict[float, Array] = {}
        for way_point in trajectory.findall("waypoint"):
            time = float(parse_numbers(way_point.find("time"), 1, (0.0,))[0])
            if not 0.0 <= time <= LONGEST_S:
                raise WorldError(
                    f"a <waypoint>'s <time> of the actor {name!r} must be 0 to {LONGEST_S:g} (got {time:g})."
                )
            pose = matrix @ parse_pose(way_point)
            if not np.abs(pose[:3, 3]).max() <= FARTHEST_M:
                raise WorldError(f"a <waypoint> of the actor {name!r} is farther off than {FARTHEST_M:g} m.")
            own[time] = np.array([*pose[:3, 3], np.arctan2(pose[1, 0], pose[0, 0])])
        if not own:
            continue
        if len(points) + len(own) > MOST_WAY_POINTS:
            raise WorldError(
                f"the actor {name!r} has more than {MOST_WAY_POINTS:,} <waypoint>s: reduce them."
            )
        times, poses = add_spline_points(*_in_order(own), _tension(trajectory, name))
        points |= {start + time: pose for time, pose in zip(times.tolist(), poses, strict=True)}
        start += float(times[-1])
        if start > LONGEST_S:
            raise WorldError(f"the <trajectory>s of the actor {name!r} must end before {LONGEST_S:g} s.")
    return points


def _in_order(points: dict[float, Array]) -> tuple[Array, Array]:
    """Times (T,) and poses (T, 4) of `points`, which has poses by time, with turns the shorter way."""
    times = np.array(sorted(points))
    poses = np.stack([points[time] for time in times.tolist()])
    poses[:, 3] = unwrap_yaw(poses[:, 3])
    return times, poses


def _tension(trajectory: Element, name: str) -> float:
    text = trajectory.get("tension") or "0"
    try:
        tension = float(text)
    except ValueError:
        tension = np.nan
    if not 0.0 <= tension <= 1.0:
        raise WorldError(f"tension of the actor {name!r} must be 0 to 1 (got {printable(text, 40)!r}).")
    return tension


def close_loop(name: str, times: Array, poses: Array, report: ImportReport) -> tuple[Array, Array]:
    """The way-points and, where the last is far from the first, a way back at the mean speed."""
    back = float(np.linalg.norm(poses[-1, :2] - poses[0, :2]))
    if back <= _CLOSED_M:
        return times, poses
    travelled = float(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum())
    speed = travelled / times[-1] if times[-1] > 0.0 and travelled > 0.0 else _USUAL_MPS
    report.warn(f"the loop of the actor {name!r} ends {back:.1f} m from its start: it walks back here")
    first = poses[0].copy()
    first[3] = poses[-1, 3] + (first[3] - poses[-1, 3] + np.pi) % (2 * np.pi) - np.pi
    return np.append(times, times[-1] + back / speed), np.concatenate([poses, first[None]])


def _points_between(xy: Array) -> Array:
    """Points (P, 2) at most `_LOOK_M` apart on the lines between way-points (T, 2)."""
    travelled = np.concatenate([[0.0], np.linalg.norm(np.diff(xy, axis=0), axis=1).cumsum()])
    count = min(int(np.ceil(travelled[-1] / _LOOK_M)) + 1, _MOST_LOOKS)
    at = np.linspace(0.0, travelled[-1], count)
    return np.stack([np.interp(at, travelled, xy[:, axis]) for axis in (0, 1)], axis=1)


def place_on_ground(
    actors: list[ActorTrajectory], world: World, report: ImportReport
) -> tuple[ActorTrajectory, ...]:
    """The actors with `on_ground` set for those near the ground.

    Warns of those that walk beyond its edge or through obstacles.
    """
    xmin, xmax, ymin, ymax = world.extent
    placed = []
    for actor in actors:
        xy = actor.poses[:, :2]
        if (xy < [xmin, ymin]).any() or (xy > [xmax, ymax]).any():
            report.warn(f"the actor {actor.name!r} walks beyond the edge of the ground")
        on_it = actor.set_on_ground(world.terrain)
        if on_it.on_ground and (world.clearance(_points_between(xy)) <= 0.0).any():
            report.warn(f"the actor {actor.name!r} walks through an obstacle")
        placed.append(on_it)
    return tuple(placed)


def add_spline_points(times: Array, poses: Array, tension: float = 0.0) -> tuple[Array, Array]:
    """The way-points `times` (T,) and `poses` (T, 4), and points of Gazebo's spline between them.

    Gazebo moves actors on a cubic Hermite spline over the number of the way-point: the tangent of each is
    half the way from the one before to the one behind, times 1 - `tension` (Catmull-Rom with 0), and time
    passes evenly between two. Lines between the points of the result are within 2 cm of it. Yaw stays linear.
    """
    if len(times) < 2:
        return times, poses
    points = poses[:, :3]
    is_closed = np.abs(points[-1] - points[0]).max() <= _SAME_END_M
    before, behind = (points[-2:-1], points[1:2]) if is_closed else (points[:1], points[-1:])
    padded = np.concatenate([before, points, behind])
    tangents = 0.5 * (1.0 - tension) * (padded[2:] - padded[:-2])
    legs = np.diff(points, axis=0)
    # How far both ends of a leg pull the spline away from its even line.
    first, last = (np.linalg.norm(ends - legs, axis=1) for ends in (tangents[:-1], tangents[1:]))
    pull = np.maximum(first, last)
    # A leg strays from its line by at most a quarter of its pull. Its second derivative is at most six times
    # the pull, and n parts stray by an eighth of that over n squared.
    parts = np.ceil(np.sqrt(0.75 * pull / _STRAY_M)).clip(1, _MOST_PARTS).astype(int)
    parts[0.25 * pull <= _STRAY_M] = 1
    before = np.repeat(np.arange(len(legs)), parts)
    share = (np.arange(len(before)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[before]
    u = share[:, None]
    found = np.empty((len(before), 4))
    found[:, :3] = (
        (2 * u**3 - 3 * u**2 + 1) * points[before]
        + (u**3 - 2 * u**2 + u) * tangents[before]
        + (3 * u**2 - 2 * u**3) * points[before + 1]
        + (u**3 - u**2) * tangents[before + 1]
    )
    found[:, 3] = poses[before, 3] + share * (poses[before + 1, 3] - poses[before, 3])
    at = times[before] + share * (times[before + 1] - times[before])
    return np.append(at, times[-1]), np.concatenate([found, poses[-1:]])
