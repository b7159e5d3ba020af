"""A scene of a simulation as a page: bodies, beams, ways, and the numbers of the agent that is followed."""

import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.goal_markers import goal_arrow
from dune_rl.env.live.numbers import describe_agent
from dune_rl.env.live.panel import Panel
from dune_rl.env.live.playback import Playback
from dune_rl.env.pictures import Pictures
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.rendering.moving_mesh import PosedMesh, RayMesh
from dune_rl.rendering.web.scene import Colour, WebScene
from dune_rl.rendering.web.server import LOCALHOST, free_port, open_server, stop_server
from dune_rl.sensors.lidar import LidarConf, ScannerConf
from dune_rl.sensors.returns import find_returns

_BEAM: Colour = (255, 196, 61)
_POINT: Colour = (90, 200, 255)
# Of more points some are left out.
_MOST_POINTS, _POINT_M = 2_500, 0.025
_TRACK: Colour = (255, 120, 20)
_WAY: Colour = (150, 160, 175)
# Of ways with more points some are left out.
_MOST_WAY_POINTS = 150
# Lines on the ground are drawn this far above it.
_ABOVE_GROUND_M = 0.06
# Numbers and plots are written this often at most, in the viewer's time.
_NUMBERS_PER_S = 5.0
_BEHIND_M, _ABOVE_M, _TARGET_M = 6.0, 2.8, 0.4
_TERM = "reward/"
# Distance of the points of a track; the oldest ones of a long track are left out.
_BETWEEN_M, _MOST_TRACK_POINTS = 0.05, 2_000


class SceneView:
    """What is to be seen of a simulation's scene 0; the agent in `row` of `group` is followed."""

    def __init__(self, simulation: VectorSimulation, web: WebScene, group: AgentGroup, row: int) -> None:
        self._simulation, self._web, self.group, self.row = simulation, web, group, row
        self.pictures = Pictures(simulation)
        self._arrow = RayMesh(goal_arrow())
        self._track: deque[Array] = deque(maxlen=_MOST_TRACK_POINTS)

    @property
    def position(self) -> Array:
        """Position (3,) [m] of the agent."""
        return self.group.body.motion.position_w[self.row].copy()

    @property
    def target(self) -> Array:
        """The point (3,) [m] that views of the agent look at."""
        return self.position + np.array([0.0, 0.0, _TARGET_M])

    def begin(self) -> None:
        """Show the world of a new episode; `update` shows who is in it."""
        self._web.show_world(*self.pictures.scenery(0))
        self._web.load_looks(self.pictures.looks_by_name(0))
        self._track.clear()
        self._web.look(*self._first_view())

    def show_agent_to(self, client: Any) -> None:
        """Let one visitor look at the agent."""
        self._web.show_to(client, *self._first_view())

    @property
    def _goal(self) -> Array | None:
        """Position (2,) [m] of the agent's goal, if it has one."""
        return self.group.starts.goals_w[self.row] if self.group.task is not None else None

    def _first_view(self) -> tuple[Array, Array]:
        """Eye (3,) and target (3,) [m] of a view of the agent from above; its goal is beyond it."""
        yaw = float(self.group.body.motion.yaw[self.row])
        if self._goal is not None:
            dx, dy = self._goal - self.position[:2]
            yaw = np.arctan2(dy, dx)
        ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        eye = self.position - _BEHIND_M * ahead
        eye[2] = max(eye[2], self._ground(*eye[:2])) + _ABOVE_M
        reach_m = float(np.linalg.norm(eye - self.position))
        return self.pictures.free_eye(0, self.position, eye, reach_m), self.target

    def free_eye(self, eye: Array) -> Array:
        """`eye` (3,) [m], or a point near it where something hides the agent from there."""
        pictures, position = self.pictures, self.position
        if pictures.is_in_sight(0, position, eye):
            return eye
        return pictures.free_eye(0, position, eye, float(np.linalg.norm(eye - position)))

    def update(self, *, shows_beams: bool = True, shows_ways: bool = True) -> None:
        """Show the present state."""
        self._web.show_bodies(self.pictures.bodies_by_name(0) | self._goal_arrow())
        self._show_returns(shows_beams)
        self._extend_track()
        self._show_ways(shows_ways)

    def _goal_arrow(self) -> dict[str, list[PosedMesh]]:
        """An arrow over the goal of the agent, if it has one."""
        if self._goal is None:
            return {}
        position = np.array([*self._goal, self._ground(*self._goal)])
        return {"arrow": [PosedMesh(self._arrow, position, np.eye(3))]}

    def _show_returns(self, is_shown: bool) -> None:
        """Draw the beams of planar LiDARs that return, and the points of those with rings."""
        suite, motion = self.group.suite, self.group.body.motion
        readings = self._simulation.observe(self.group.name) if suite is not None and is_shown else {}
        position, rotation = motion.position_w[self.row], motion.rotation[self.row]
        beams, points = [np.zeros((0, 2, 3))], [np.zeros((0, 3))]
        for name, conf in {} if suite is None else suite.settings.items():
            key = name if isinstance(conf, LidarConf) else f"{name}_range"
            if isinstance(conf, ScannerConf) and key in readings:
                origin, ends = find_returns(conf, readings[key][0, self.row], position, rotation)
                if isinstance(conf, LidarConf):
                    beams.append(np.stack([np.broadcast_to(origin, ends.shape), ends], axis=1))
                else:
                    points.append(ends[:: 1 + len(ends) // _MOST_POINTS])
        self._web.show_lines("beams", np.concatenate(beams), _BEAM, width=1.0)
        self._web.show_points("points", np.concatenate(points), position, _POINT, _POINT_M)

    def _extend_track(self) -> None:
        """Draw the way that the agent has come, on the ground."""
        x, y, _ = self.position
        point = np.array([x, y, self._ground(x, y) + _ABOVE_GROUND_M])
        if not self._track or np.linalg.norm(point - self._track[-1]) > _BETWEEN_M:
            self._track.append(point)
            self._web.show_lines("track", _segments(np.array(self._track)), _TRACK, width=3.0)

    def _show_ways(self, is_shown: bool) -> None:
        """Draw the paths on which agents are now."""
        ways = [np.zeros((0, 2, 3))]
        for group in self._simulation.groups if is_shown else ():
            for agent in group.agents_of(0):
                way = group.starts.present_path(agent)
                if way is not None:
                    ways.append(_segments(self._on_ground(way[:: 1 + len(way) // _MOST_WAY_POINTS])))
        self._web.show_lines("ways", np.concatenate(ways), _WAY, width=1.5)

    def _ground(self, x: float, y: float) -> float:
        return float(self._simulation.worlds.worlds[0].terrain.height(np.array([x, y])))

    def _on_ground(self, points: Array) -> Array:
        heights = self._simulation.worlds.worlds[0].terrain.height(points[:, :2])
        return np.column_stack([points[:, :2], heights + _ABOVE_GROUND_M])


def _segments(points: Array) -> Array:
    """The segments (N - 1, 2, 3) of a line through points (N, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1)


class LivePage:
    """A page on `host` and `port` with a simulation's scene 0 and a panel; `url` is its address.

    It says the state, rewards and metrics of the agent in `row` of `group`, and looks at it.
    """

    def __init__(
        self,
        simulation: VectorSimulation,
        group: AgentGroup,
        row: int,
        *,
        host: str = LOCALHOST,
        port: int | None = None,
        title: str = "dune_rl",
        announces: bool = False,
    ) -> None:
        """Without a `port`, the first one from 8080 on is taken that is free.

        A page that `announces` itself writes its address to the terminal.
        """
        port = free_port(host) if port is None else port
        self.server = open_server(host, port, title, announces=announces)
        # Colons of IPv6 are not those of a port.
        self.url = f"http://{f'[{host}]' if ':' in host else host}:{self.server.get_port()}"
        self.playback = Playback()
        self.panel = Panel(self.server, self.playback)
        self._web = WebScene(self.server)
        self.scene_view = SceneView(simulation, self._web, group, row)
        self._simulation, self._group, self._row = simulation, group, row
        self._is_begun = False
        self._numbers_due_s = 0.0
        self._times_s: list[float] = []
        self._values: list[Array] = []
        self.server.on_client_connect(self._welcome)

    def _welcome(self, client: Any) -> None:
        """Let a visitor see the agent where it is, once there is an episode."""
        if self._is_begun:
            self.scene_view.show_agent_to(client)

    @property
    def is_watched(self) -> bool:
        """Whether anybody has the page open."""
        return bool(self.server.get_clients())

    def show(self, more: Sequence[tuple[str, str]] = (), headline: str = "") -> None:
        """Show the present state; `more` are names and values for the table beside those of the agent."""
        if not self._is_begun or not self._simulation.steps[0]:
            self._times_s, self._values = [], []
            self._numbers_due_s = 0.0
            self.scene_view.begin()
        with self.server.atomic():
            self.scene_view.update(shows_beams=self.panel.shows_beams, shows_ways=self.panel.shows_ways)
        if not self._is_begun:
            self._is_begun = True
            for client in self.server.get_clients().values():
                self._welcome(client)
        elif self.panel.follows or not self._simulation.steps[0]:
            self._web.follow(self.scene_view.target, self.scene_view.free_eye)
        self._show_numbers(more, headline)

    def _show_numbers(self, more: Sequence[tuple[str, str]], headline: str) -> None:
        simulation, name = self._simulation, self._group.name
        names = simulation.metric_names(name)
        values = simulation.metrics(name)[0, self._row]
        time_s = float(simulation.steps[0]) * simulation.physics.control_step_s
        self._times_s.append(time_s)
        self._values.append(values)
        now = time.monotonic()
        if now < self._numbers_due_s and not headline and not self.playback.is_paused:
            return
        self._numbers_due_s = now + 1.0 / _NUMBERS_PER_S
        rows = describe_agent(simulation, self._group, self._row, time_s)
        self.panel.show_state(headline, [*more, *rows])
        times_s, curves = np.array(self._times_s), dict(zip(names, np.array(self._values).T, strict=True))
        self.panel.show_metrics(times_s, {each: curve for each, curve in curves.items() if "/" not in each})
        sums = {each.removeprefix(_TERM): curve for each, curve in curves.items() if each.startswith(_TERM)}
        self.panel.show_rewards(times_s, sums)
        readings = simulation.observe(name)
        picture = next((value for each, value in readings.items() if each.endswith("_rgb")), None)
        if picture is not None:
            self.panel.show_picture(picture[0, self._row])

    def close(self) -> None:
        """Close the page's server."""
        stop_server(self.server)
