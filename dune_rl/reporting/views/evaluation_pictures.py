"""Pictures of the evaluations during training: tracks of episodes on the maps of their worlds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

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
from dune_rl.visualization.site_map import colours, panel
from dune_rl.visualization.site_map.layers import obstacle_tints, prop_footprints
from dune_rl.worlds.world import Rectangle, World

Picture = NDArray[np.uint8]
_DPI = 100
_SIDE_IN, _SMALL_SIDE_IN = 6.0, 3.8
_LEGEND_IN, _TITLE_IN = 0.55, 0.45
# Round the region of starts and goals, relative to its side.
_MARGIN = 0.15
_KEPT_GROUNDS = 8


@dataclass(frozen=True, eq=False)
class _Episode:
    """An episode that has been seen to its end."""

    world: World
    placements: list[Placement]
    tracks: list[panel.Track]


class EvaluationTracks:
    """Observes evaluations in `env`, and draws the tracks of their first `episodes`: an `EpisodeObserver`.

    Episodes in the same world share a map; where worlds differ there is a map for each of them. The grounds
    of the maps are kept, since a picture is drawn at every evaluation.
    """

    def __init__(self, env: EnvBase, episodes: int) -> None:
        self._simulation = env.base_env.simulation
        self._count = episodes
        self._recorder: TrackRecorder | None = None
        self._placements: dict[int, list[Placement]] = {}
        self._seen: dict[int, _Episode] = {}
        self._ground = lru_cache(_KEPT_GROUNDS)(self._draw_ground)

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

    def draw(self) -> Picture:
        """RGB (height, width, 3) of the tracks of the last evaluation."""
        by_world: dict[World, list[int]] = {}
        for episode in sorted(self._seen):
            by_world.setdefault(self._seen[episode].world, []).append(episode)
        columns = 1 if len(by_world) == 1 else 2 if len(by_world) < 5 else 3
        rows = -(-len(by_world) // columns)
        side = _SIDE_IN if columns == 1 else _SMALL_SIDE_IN
        figure = Figure((columns * side, rows * (side + _TITLE_IN) + _LEGEND_IN), _DPI, layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).reshape(-1)
        for axes in panels:
            axes.set_axis_off()
        for axes, (world, episodes) in zip(panels, by_world.items(), strict=False):
            self._draw_panel(axes, world, episodes, side)
        _add_legend(figure, [track for seen in self._seen.values() for track in seen.tracks])
        return _render(figure)

    def _draw_panel(self, axes: Axes, world: World, episodes: Sequence[int], side_in: float) -> None:
        tracks = [track for episode in episodes for track in self._seen[episode].tracks]
        picture, rectangle, content = self._ground(world, side_in)
        placements = {episode: self._seen[episode].placements for episode in episodes}
        content = replace(content, episodes=placements, tracks=tracks)
        axes.imshow(picture, extent=rectangle)
        panel.draw_tracks(axes, tracks, 1.8, marks=True)
        panel.draw_episodes(axes, content, side_in / (rectangle[1] - rectangle[0]), joined=False)
        axes.set_xlim(rectangle[:2])
        axes.set_ylim(rectangle[2:])
        reached = sum((track.ending or "").startswith("goal reached") for track in tracks)
        ended = sum(track.ending is not None for track in tracks)
        named = ", ".join(str(episode) for episode in episodes)
        axes.set_title(
            f"episode{'s' if len(episodes) > 1 else ''} {named}: {reached} of {ended} at the goal",
            x=0.01, fontsize=9, color=colours.INK, loc="left",
        )  # fmt: skip

    def _draw_ground(self, world: World, side_in: float) -> tuple[Picture, Rectangle, panel.MapContent]:
        """The picture of the region without episodes, rows from north to south, and where it is."""
        group = self._measured[0]
        assert group.setup.task is not None
        content = panel.MapContent(
            world=world,
            spawner=group.spawners.of(world),
            max_slope_deg=group.setup.task.spawn.max_slope_deg,
            goal_distance_m=group.setup.task.goal_reached_m or 0.0,
            footprints=prop_footprints(world, len(colours.OBSTACLES)),
        )
        xmin, xmax, ymin, ymax = content.spawner.region
        half = (0.5 + _MARGIN) * max(xmax - xmin, ymax - ymin)
        x, y = (xmin + xmax) / 2, (ymin + ymax) / 2
        rectangle = (x - half, x + half, y - half, y + half)
        figure = Figure((side_in, side_in), _DPI)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        panel.draw_ground(axes, content, rectangle, (side_in, side_in), _DPI)
        panel.draw_props(axes, content.footprints, obstacle_tints(content.footprints))
        panel.draw_region(axes, content.spawner.region, 1.5)
        return _render(figure), rectangle, content


def _render(figure: Figure) -> Picture:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _add_legend(figure: Figure, tracks: Sequence[panel.Track]) -> None:
    handles = [
        Line2D([], [], color=colour, marker=mark, markeredgecolor=colours.PAPER, label=ending)
        for ending in dict.fromkeys(track.ending for track in tracks if track.ending is not None)
        for colour, mark in [colours.ending_style(ending)]
    ]
    if any(track.ending is None for track in tracks):
        handles.append(Line2D([], [], color=colours.FAINT, linewidth=0.9, label="walkers"))
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
