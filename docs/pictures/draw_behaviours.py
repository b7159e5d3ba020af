"""Draws `behaviours.png`, tracks of each scripted behaviour: `python docs/pictures/draw_behaviours.py`."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from dune_rl.config.build import make_simulation
from dune_rl.config.compose import compose_environment
from dune_rl.env.simulation import VectorSimulation
from dune_rl.visualization.site_map.figure import obstacle_tints
from dune_rl.visualization.site_map.layers import prop_footprints
from dune_rl.visualization.site_map.panel import MapContent, draw_ground, draw_props

FOLDER = Path(__file__).parent
SIDE_M, SIDE_IN, DPI = 16.0, 3.1, 110
DURATION_S = 40.0
SQUARE = [[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]]
LOOP = {"waypoints": SQUARE, "mode": "loop"}
ZIGZAG = {"waypoints": [[-5, -3], [-2, 3], [2, -3], [5, 3]], "mode": "once", "pauses_s": 2.0}
# Title, world, number of actors, controller and other settings of their group.
PANELS: list[tuple[str, str, int, Any, dict[str, Any]]] = [
    ("path, there and back", "inspection", 4, "path", {}),
    ("path, mode: loop", "flat", 1, "path", {"path": LOOP}),
    ("path, mode: once, pauses_s: 2", "flat", 1, "path", {"path": ZIGZAG}),
    ("random_waypoint", "inspection", 4, "random_waypoint", {}),
    ("patrol", "flat", 3, {"name": "patrol", "places": SQUARE, "wait_s": [2, 2]}, {}),
    ("herd", "inspection", 8, "herd", {}),
    ("crossing", "flat", 2, "crossing", {}),
    ("follow", "inspection", 2, "follow", {}),
    ("flee", "flat", 4, "flee", {}),
    ("social_force", "inspection", 6, "social_force", {}),
    ("orca", "inspection", 6, "orca", {}),
    ("orca, reaction: curious", "flat", 4, {"name": "orca", "reaction": "curious"}, {}),
]


def simulate(
    world: str, count: int, controller: Any, settings: dict[str, Any], seed: int
) -> VectorSimulation:
    """A scene of a rover that goes from goal to goal, and `count` persons."""
    roaming = {"terminations": {"goal_reached": {"renew": True}, "time_limit": {"max_steps": 100_000}}}
    agents = {
        "rover": {"body": "rover_zero", "task": roaming},
        "actor": {
            "body": {"name": "person", "speed_mps": 1.5},
            "count": count,
            "controller": controller,
            **settings,
        },
    }
    simulation = make_simulation(compose_environment(world, (), {"agents": agents}), 1, seed)
    simulation.reset()
    return simulation


def record(simulation: VectorSimulation) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the rover (T, 2) and of the actors (T, G, 2)."""
    rover, actors = [], []
    step_s = simulation.physics.control_step_s
    for _ in range(round(DURATION_S / step_s)):
        now = simulation.state.groups["rover"]
        bearing = now.goal.bearing[0]
        action = np.array([[[0.6 * max(np.cos(bearing), 0.0), bearing]]])
        if simulation.step({"rover": action}).done.any():
            break
        rover.append(simulation.state.groups["rover"].motion.position_w[0, :2].copy())
        actors.append(simulation.state.groups["actor"].motion.position_w[:, :2].copy())
    return np.array(rover), np.array(actors)


def draw_track(axes: Axes, points: np.ndarray, colour: str, width: float) -> None:
    """A line that grows darker with time, and a dot at its end."""
    parts = np.stack([points[:-1], points[1:]], axis=1)
    shades = [(colour, 0.15 + 0.85 * share) for share in np.linspace(0.0, 1.0, len(parts))]
    axes.add_collection(LineCollection(list(parts), colors=shades, linewidths=width, zorder=8))
    axes.plot(*points[-1], "o", color=colour, markersize=4.5, markeredgecolor="white", zorder=9)


def draw_panel(
    axes: Axes, title: str, world: str, count: int, controller: Any, settings: dict[str, Any]
) -> None:
    simulation = simulate(world, count, controller, settings, seed=3)
    rover, actors = record(simulation)
    everything = np.concatenate([rover, actors.reshape(-1, 2)])
    middle = (everything.min(axis=0) + everything.max(axis=0)) / 2
    side = max(SIDE_M, 1.0 + 2.0 * np.abs(everything - middle).max())
    place = simulation.worlds.worlds[0]
    xmin, xmax, ymin, ymax = place.extent
    low = np.clip(middle - side / 2, [xmin, ymin], [max(xmin, xmax - side), max(ymin, ymax - side)])
    rectangle = (low[0], low[0] + side, low[1], low[1] + side)
    spawner = simulation.group("rover").spawners.of(place)
    content = MapContent(place, spawner, 25.0, 0.5, prop_footprints(place, 3))
    draw_ground(axes, content, rectangle, (SIDE_IN, SIDE_IN), DPI)
    draw_props(axes, content.footprints, obstacle_tints(content.footprints))
    draw_track(axes, rover, "#1b1f24", 2.2)
    for agent, colour in zip(range(actors.shape[1]), colormaps["tab10"](range(10)), strict=False):
        draw_track(axes, actors[:, agent], colour, 1.4)
    axes.set_title(title, fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.plot([low[0] + 0.5, low[0] + 2.5], [low[1] + 0.5] * 2, color="black", linewidth=3, zorder=9)
    axes.text(low[0] + 1.5, low[1] + 0.7, "2 m", ha="center", fontsize=7, zorder=9)
    simulation.close()


def main() -> None:
    rows = -(-len(PANELS) // 4)
    figure, axes = plt.subplots(rows, 4, figsize=(4 * SIDE_IN + 0.4, rows * (SIDE_IN + 0.3)), squeeze=False)
    for place, panel in zip(axes.flat, PANELS, strict=False):
        draw_panel(place, *panel)
    figure.tight_layout()
    figure.savefig(FOLDER / "behaviours.png", dpi=DPI)


if __name__ == "__main__":
    main()
