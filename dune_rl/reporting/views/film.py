"""The film of an episode: an agent from cameras beside its way, what its sensors read, and a map."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from dune_rl.geometry.arrays import Array
from dune_rl.rendering.fixed_camera import FixedCamera
from dune_rl.rendering.moving_mesh import PosedMesh
from dune_rl.rendering.renderer import Renderer, Viewpoint
from dune_rl.reporting.views.episode import EpisodeView
from dune_rl.reporting.views.shots import plan_shots
from dune_rl.visualization.film_frame import FilmFrame, draw_map, draw_scan, fit_picture
from dune_rl.visualization.video import enlarge, open_video

Picture = NDArray[np.uint8]
# The last picture of a film stays this long.
_LAST_PICTURE_S = 1.5
_CAMERA, _SCAN, _MAP = "camera", "LiDAR", "map"
_READINGS = {"camera_rgb": _CAMERA, "lidar": _SCAN}
# Larger pictures are enlarged ones of so many rows, as the codec blurs more than that.
_MOST_ROWS = 720
# What a map shows about the way of the agent and its goals, at least, and from how high.
_MAP_MARGIN_M, _MAP_SMALLEST_M, _MAP_EYE_M = 4.0, 14.0, 90.0


@dataclass(frozen=True, eq=False)
class _Instant:
    """What a frame shows: all bodies, readings by name, the agent's position (3,), goal (2,) and state, and
    positions (K, 2) of other agents; from `behind` it is seen where no camera beside its way sees it.
    """

    bodies: list[PosedMesh]
    readings: dict[str, NDArray[Any]]
    position: Array
    goal: Array | None
    others: Array
    state: list[tuple[str, str]]
    ending: str
    behind: Viewpoint


def write_video(
    view: EpisodeView,
    path: Path,
    console: Console,
    also: Callable[[Picture], None] = lambda picture: None,
) -> Path:
    """The film of an episode (MP4); `also` is called with each of its frames, RGB (height, width, 3)."""
    conf = view.conf
    every = max(1, round(conf.physics.control_hz / conf.frames_per_s))
    rate = conf.physics.control_hz / every
    columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    bar = Progress(*columns, console=console, disable=not console.is_terminal, transient=True)
    with open_video(path, rate, conf.width, conf.height) as add_frame, bar:
        instants = _drive(view, every, bar)
        frames = _Frames(view, instants, rate)
        for number in bar.track(range(len(instants)), description="rendering"):
            frame = frames.frame(number)
            add_frame(frame)
            also(frame)
        for _ in range(round(_LAST_PICTURE_S * rate)):
            add_frame(frame)
    return path


def _drive(view: EpisodeView, every: int, bar: Progress) -> list[_Instant]:
    """Each `every` control steps of the episode, and its last."""
    longest = round(view.conf.longest_s * view.conf.physics.control_hz)
    task, instants, steps = bar.add_task("driving", total=longest), [], 0

    def watch() -> None:
        nonlocal steps
        steps += 1
        if steps % every == 0 and steps <= longest:
            instants.append(_instant(view, steps))

    view.simulation.watchers.append(watch)
    try:
        for done in view.run():
            if not instants:
                instants.append(_instant(view, 0))
            bar.update(task, completed=steps)
            if done or steps >= longest:
                break
    finally:
        view.simulation.watchers.remove(watch)
    if done:
        # How it ended is known only now.
        if steps % every == 0 and steps <= longest:
            instants.pop()
        instants.append(_instant(view, steps))
    bar.remove_task(task)
    return instants


def _instant(view: EpisodeView, steps: int) -> _Instant:
    group, row = view.group, view.row
    readings = {name: value.copy() for name, value in view.readings().items() if name in (*_READINGS, "goal")}
    places = [
        each.body.motion.position_w[agent, :2]
        for each in view.simulation.groups
        for agent in each.agents_of(0)
        if each is not group or agent != row
    ]
    return _Instant(
        view.pictures.bodies(0),
        readings,
        group.body.motion.position_w[row].copy(),
        None if group.task is None else group.starts.goals_w[row].copy(),
        np.array(places).reshape(-1, 2),
        view.status(steps),
        view.ending(),
        view.pictures.behind(0, view.agent),
    )


class _Frames:
    """Renders the frames of `instants`."""

    def __init__(self, view: EpisodeView, instants: list[_Instant], rate_hz: float) -> None:
        self._instants, self._samples = instants, view.conf.samples
        self._lidar = view.sensors.get("lidar")
        read = [title for name, title in _READINGS.items() if name in instants[0].readings]
        self._layout = FilmFrame(view.conf.width, view.conf.height, [*read, _MAP])
        self._renderer = view.pictures.renderer(0)
        self._track = np.array([each.position for each in instants])
        width, height = self._layout.picture_size
        rows = min(height, _MOST_ROWS)
        self._traced_size = round(width * rows / height), rows
        most = max(len(each.others) for each in instants)
        others = np.full((len(instants), most, 2), np.nan)
        for place, each in zip(others, instants, strict=True):
            place[: len(each.others)] = each.others
        self._shots = plan_shots(
            self._track,
            others,
            rate_hz,
            self._renderer.baked,
            width / height,
            lambda number: instants[number].behind,
        )
        self._shown = -1
        self._camera: FixedCamera | None = None
        self._map = self._overview()

    def frame(self, number: int) -> Picture:
        """The frame (height, width, 3) of an instant."""
        instant = self._instants[number]
        panels = {_MAP: self._draw_map(number)}
        if "camera_rgb" in instant.readings:
            size = self._layout.panel_size(_CAMERA)
            panels[_CAMERA] = fit_picture(np.asarray(instant.readings["camera_rgb"], np.uint8), size)
        if "lidar" in instant.readings:
            ranges = np.asarray(instant.readings["lidar"], float)
            goal = instant.readings.get("goal")
            panels[_SCAN] = draw_scan(ranges, self._lidar, goal, self._layout.panel_size(_SCAN))
        picture = self._camera_of(number).render(instant.bodies)
        if self._traced_size != self._layout.picture_size:
            picture = enlarge(picture, *self._layout.picture_size)
        return self._layout.compose(picture, panels, instant.state, instant.ending)

    def _camera_of(self, number: int) -> FixedCamera:
        shot = next(k for k, each in enumerate(self._shots) if number < each.end)
        if shot != self._shown or self._camera is None:
            self._shown = shot
            self._camera = FixedCamera(
                self._renderer, self._shots[shot].view, *self._traced_size, self._samples
            )
        return self._camera

    def _overview(self) -> tuple[Viewpoint, Picture]:
        """The ground from above, about the way and the goals, and the viewpoint that it is seen from."""
        width, height = self._layout.panel_size(_MAP)
        points = [self._track[:, :2], *(each.goal[None] for each in self._instants if each.goal is not None)]
        known = np.concatenate(points)
        known = known[np.isfinite(known).all(axis=1)]
        low, high = known.min(axis=0) - _MAP_MARGIN_M, known.max(axis=0) + _MAP_MARGIN_M
        shown_m = max(float((high - low)[0]), float((high - low)[1]) * width / height, _MAP_SMALLEST_M)
        middle = (low + high) / 2
        ground = float(self._renderer.baked.terrain.height(middle))
        fov_rad = 2.0 * float(np.arctan(shown_m / 2 / _MAP_EYE_M))
        # From a little south, so that north is up.
        eye = (float(middle[0]), float(middle[1]) - 0.01, ground + _MAP_EYE_M)
        view = Viewpoint(eye, (float(middle[0]), float(middle[1]), ground), fov_rad)
        clear = self._renderer if self._renderer.is_clear else Renderer(self._renderer.baked)
        return view, clear.render(view, width, height, (), self._samples)

    def _draw_map(self, number: int) -> Picture:
        instant, (view, ground) = self._instants[number], self._map

        def pixels(xy: Array) -> Array:
            heights = self._renderer.baked.terrain.height(xy)
            column, row, _ = view.project(np.column_stack([xy, heights]), *self._layout.panel_size(_MAP))
            return np.column_stack([column, row])

        goal = None if instant.goal is None else pixels(instant.goal[None])[0]
        return draw_map(ground, pixels(self._track[: number + 1, :2]), pixels(instant.others), goal)
