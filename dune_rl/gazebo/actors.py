"""Actors of SDF files: a skin, and a trajectory of timed poses."""

from xml.etree.ElementTree import Comment, Element

from dune_rl.gazebo.elements import add
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import wrap_angle

# Printed digits behind the point: micrometres, microseconds and microradians.
_DIGITS = 6
ANIMATION = "walking"


def make_actor(
    name: str,
    times: Array,
    poses: Array,
    *,
    skin: str,
    animation: str,
    interpolate_x: bool = False,
    loop: bool = False,
    delay_s: float = 0.0,
    comment: str | None = None,
) -> Element:
    """The <actor> that is at `poses` (T, 6) at `times` (T,) [s]; between them Gazebo moves it on a spline.

    Poses are x, y, z [m], roll, pitch and yaw [rad] of the skin's origin. `skin` and `animation` are files.
    With `interpolate_x` the animation advances with the way along its own x axis.
    """
    actor = Element("actor", name=name)
    add(add(actor, "skin"), "filename", skin)
    motion = add(actor, "animation", name=ANIMATION)
    add(motion, "filename", animation)
    add(motion, "interpolate_x", interpolate_x)
    script = add(actor, "script")
    add(script, "loop", loop)
    add(script, "delay_start", format_number(delay_s))
    add(script, "auto_start", True)
    if comment is not None:
        script.append(Comment(f" {comment} "))
    trajectory = add(script, "trajectory", id="0", type=ANIMATION)
    for time, position, angles in zip(
        times.tolist(), poses[:, :3].tolist(), wrap_angle(poses[:, 3:]).tolist(), strict=True
    ):
        way_point = add(trajectory, "waypoint")
        add(way_point, "time", format_number(time))
        add(way_point, "pose", " ".join(map(format_number, (*position, *angles))))
    return actor


def format_number(value: float) -> str:
    """A number with six digits behind the point."""
    # Rounded first, so that there is no negative zero.
    return f"{round(value, _DIGITS) + 0.0:.{_DIGITS}f}"
