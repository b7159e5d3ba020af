"""Pictures of the evaluations during training: tracks of episodes on the maps of their worlds."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from dune_rl.env.agent_group import AgentGroup
from dune_rl.reporting.views.tracks import TrackRecorder
from dune_rl.tasks.spawn import Placement
from dune_rl.visualization.site_map import colours
from dune_rl.visualization.site_map.layers import obstacle_tints, prop_footprints
from dune_rl.visualization.site_map.panel import (
    MapContent,
    Track,
    draw_episodes,
    draw_ground,
    draw_props,
    draw_region,
    draw_tracks,
)
from dune_rl.worlds.world import Rectangle, World

Picture = NDArray[np.uint8]
_DPI = 100
_SIDE_IN, _SMALL_SIDE_IN = 6.0, 3.8
_LEGEND_IN, _GAP_IN = 0.55, 0.45
# Round the region of starts and goals, relative to its side.
_MARGIN = 0.15
_KEPT_GROUNDS = 8


@dataclass(frozen=True, eq=False)
class _Episode:
    """An episode that has been seen to its end."""

    world: World
    placements: list[Placement]
    tracks: list[Track]


class EvaluationTracks:
    """Observes evaluations in `env`, and draws the tracks of their first `episodes`.

    Episodes in the same world share a map; where worlds differ there is a map for each of them. The grounds
    of the maps are kept, since a picture is drawn at every evaluation.
    """

    def __init__(self, env: EnvBase, episodes: int) -> None:
        self._simulation = env.base_env.simulation
        self._count = episodes
        self._recorder: TrackRecorder | None = None
        self._placements: dict[int, list[Placement]] = {}
        self._seen: dict[int, _Episode] = {}
        self._grounds: OrderedDict[int, _Ground] = OrderedDict()

    # -- an EpisodeObserver -----------------------------------------------------------------------------

    def begin(self) -> None:
        """Begin the tracks of the scenes that have made no step."""
        simulation = self._simulation
        if self._recorder is None or not (simulation.steps > 0).any():
            self._recorder = TrackRecorder(simulation)
            if simulation.episodes.min() == 0:
                self._seen = {}
        for scene in np.flatnonzero(simulation.steps == 0).tolist():
            self._recorder.reset(scene)
            self._placements[scene] = self._placed(scene)

    def step(self, after: TensorDictBase) -> None:
        """Add where all agents are, while an episode that will be drawn goes on."""
        assert self._recorder is not None
        if ((self._simulation.episodes < self._count) & ~self._simulation.resting).any():
            self._recorder.update()

    def finish(self, rows: Mapping[str, list[dict[str, float]]]) -> None:
        """Keep the tracks of an episode that has ended."""
        assert self._recorder is not None
        episode = int(next(iter(rows.values()))[0]["episode"])
        if episode >= self._count:
            return
        (scene,) = np.flatnonzero(self._simulation.episodes == episode).tolist()
        world = self._simulation.worlds.worlds[scene]
        self._seen[episode] = _Episode(world, self._placements[scene], self._recorder.tracks(scene))

    def _placed(self, scene: int) -> list[Placement]:
        """Starts and goals of the scene's agents that have a task, and are there."""
        found = []
        for group in self._measured:
            state = self._simulation.state.groups[group.name]
            for row in scene * group.count + np.array(group.agents_of(scene), int):
                x, y = state.motion.position_w[row, :2].tolist()
                goal_x, goal_y = state.goal.position_w[row, :2].tolist()
                found.append(Placement(x, y, float(state.motion.yaw[row]), goal_x, goal_y))
        return found

    @property
    def _measured(self) -> list[AgentGroup]:
        return [group for group in self._simulation.external if group.task is not None]

    # -- drawing --------------------------------------------------------------------------------------

    def draw(self) -> Picture:
        """RGB (height, width, 3) of the tracks of the last evaluation."""
        by_world: dict[int, list[int]] = {}
        for episode in sorted(self._seen):
            by_world.setdefault(id(self._seen[episode].world), []).append(episode)
        panels = list(by_world.values())
        columns = 1 if len(panels) == 1 else 2 if len(panels) < 5 else 3
        rows = -(-len(panels) // columns)
        side = _SIDE_IN if columns == 1 else _SMALL_SIDE_IN
        width = columns * side + (columns - 1) * 0.1
        height = rows * (side + _GAP_IN) + _LEGEND_IN
        figure = Figure(figsize=(width, height), dpi=_DPI)
        canvas = FigureCanvasAgg(figure)
        for number, episodes in enumerate(panels):
            row, column = divmod(number, columns)
            left = column * (side + 0.1) / width
            bottom = (_LEGEND_IN + (rows - 1 - row) * (side + _GAP_IN)) / height
            axes = figure.add_axes((left, bottom, side / width, side / height))
            self._draw_panel(axes, episodes, side)
        _add_legend(figure, [track for seen in self._seen.values() for track in seen.tracks])
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    def _draw_panel(self, axes: Axes, episodes: Sequence[int], side_in: float) -> None:
        seen = [self._seen[episode] for episode in episodes]
        tracks = [track for each in seen for track in each.tracks]
        ground = self._ground(seen[0].world, side_in)
        placements = {episode: self._seen[episode].placements for episode in episodes}
        content = replace(ground.content, episodes=placements, tracks=tracks)
        axes.set_axis_off()
        axes.imshow(ground.picture, extent=ground.rectangle, interpolation="nearest")
        draw_tracks(axes, tracks, 1.8, marks=True)
        draw_episodes(axes, content, side_in / (ground.rectangle[1] - ground.rectangle[0]), joined=False)
        axes.set_xlim(ground.rectangle[:2])
        axes.set_ylim(ground.rectangle[2:])
        reached = sum((track.ending or "").startswith("goal reached") for track in tracks)
        ended = sum(track.ending is not None for track in tracks)
        named = ", ".join(str(episode) for episode in episodes)
        axes.set_title(
            f"episode{'s' if len(episodes) > 1 else ''} {named}: {reached} of {ended} at the goal",
            x=0.01, fontsize=9, color=colours.INK, loc="left",
        )  # fmt: skip

    def _ground(self, world: World, side_in: float) -> "_Ground":
        found = self._grounds.get(id(world))
        if found is None:
            found = _draw_ground_of(world, self._measured[0], side_in)
            self._grounds[id(world)] = found
            while len(self._grounds) > _KEPT_GROUNDS:
                self._grounds.popitem(last=False)
        return found


@dataclass(frozen=True, eq=False)
class _Ground:
    """The picture of a rectangle of a world without episodes, rows from north to south."""

    picture: Picture
    rectangle: Rectangle
    content: MapContent


def _draw_ground_of(world: World, group: AgentGroup, side_in: float) -> _Ground:
    assert group.setup.task is not None
    terminations = group.setup.task.terminations.values()
    content = MapContent(
        world=world,
        spawner=group.spawners.of(world),
        max_slope_deg=group.setup.task.spawn.max_slope_deg,
        goal_distance_m=next(
            (float(each.distance_m) for each in terminations if hasattr(each, "distance_m")), 0.0
        ),
        footprints=prop_footprints(world, len(colours.OBSTACLES)),
    )
    xmin, xmax, ymin, ymax = content.spawner.region
    margin = _MARGIN * max(xmax - xmin, ymax - ymin)
    centre, half = ((xmin + xmax) / 2, (ymin + ymax) / 2), max(xmax - xmin, ymax - ymin) / 2 + margin
    rectangle = (centre[0] - half, centre[0] + half, centre[1] - half, centre[1] + half)
    figure = Figure(figsize=(side_in, side_in), dpi=_DPI)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    draw_ground(axes, content, rectangle, (side_in, side_in), _DPI)
    draw_props(axes, content.footprints, obstacle_tints(content.footprints))
    draw_region(axes, content.spawner.region, 1.5)
    canvas.draw()
    return _Ground(np.asarray(canvas.buffer_rgba())[..., :3].copy(), rectangle, content)


def _add_legend(figure: Figure, tracks: Sequence[Track]) -> None:
    endings = list(dict.fromkeys(track.ending for track in tracks if track.ending is not None))
    handles = [
        Line2D([], [], color=colour, marker=mark, markeredgecolor=colours.PAPER, label=ending)
        for ending in endings
        for colour, mark in [colours.ending_style(ending)]
    ]
    if any(track.ending is None for track in tracks):
        handles.append(Line2D([], [], color=colours.FAINT, linewidth=0.9, label="walkers"))
    if handles:
        figure.legend(handles=handles, loc="lower center", ncols=3, frameon=False, fontsize=8)
