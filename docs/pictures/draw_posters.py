"""Draws all worlds, robots and actors: `python docs/pictures/draw_posters.py [worlds] [robots] [actors]`.

It writes `poster_worlds.jpg`, `poster_robots.jpg` and `poster_actors.jpg` beside itself.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from draw_bodies import meadow, posed
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dune_rl.config.commands import ViewConf
from dune_rl.config.compose import compose
from dune_rl.env.pictures import Pictures
from dune_rl.rendering.moving_mesh import PosedBodies
from dune_rl.rendering.renderer import Viewpoint
from dune_rl.reporting.views.episode import EpisodeView

FOLDER = Path(__file__).parent
Picture = NDArray[np.uint8]
GAP_PX, SAMPLES = 6, 3


@dataclass(frozen=True)
class Shot:
    """A moment of an episode, seen from `away_m` of the robot and `rise` times as far above it.

    The camera looks along `bearing_deg`, at a point `beyond_m` behind the robot and `above_m` over it.
    """

    settings: str
    seed: int
    seconds: float
    bearing_deg: float
    away_m: float
    rise: float
    beyond_m: float = 1.5
    above_m: float = 0.3
    fov_rad: float = 0.95


WORLDS = {
    "flat": Shot("world=flat actors=cows", 1, 3.0, 45, 7.0, 0.3),
    "inspection": Shot("world=inspection actors=pedestrians", 3, 3.0, 100, 9.5, 0.4),
    "construction": Shot("world=construction actors=pedestrians", 2, 3.0, 10, 9.0, 0.8),
    "rubicon": Shot("world=rubicon actors=pedestrians", 1, 3.0, 45, 9.0, 0.4),
    "island": Shot("world=island actors=pedestrians", 1, 3.0, 45, 9.0, 0.4),
    "obstacle_course": Shot("world=obstacle_course actors=none", 1, 3.0, 30, 6.5, 0.5),
}
ROBOTS = {
    "rover_zero": Shot("world=inspection robot=rover_zero actors=none", 3, 3.0, 160, 1.3, 0.35, 0.0, 0.05),
    "leo_rover": Shot("world=construction robot=leo_rover actors=none", 2, 2.0, 10, 1.7, 0.3, 0.0, 0.2),
    "hyperdog": Shot("world=island robot=hyperdog actors=none", 1, 3.0, 200, 1.4, 0.3, 0.0, -0.05),
}
# Name, x and y [m], heading [degrees] and phase of the stride.
ACTORS = (
    ("truck", 3.0, 6.8, 240.0, 0.0),
    ("tractor", 1.0, -6.0, 125.0, 0.0),
    ("car", -3.5, 4.4, 228.0, 0.0),
    ("cow", -4.0, -2.2, 120.0, 0.1),
    ("person", -7.0, 1.6, 215.0, 0.25),
    ("child", -7.2, 0.5, 140.0, 0.75),
    ("sheep", -7.0, -3.2, 125.0, 0.4),
    ("dog", -8.2, -1.3, 110.0, 0.3),
    ("drone", -5.0, 0.2, 205.0, 0.5),
)


def draw_shot(name: str, shot: Shot, width: int, height: int) -> Image.Image:
    """A picture of a moment, with its name."""
    words = [*shot.settings.split(), f"seed={shot.seed}", "sensors=[goal]", "policy=planner"]
    view = EpisodeView(compose(ViewConf, words))
    for step, _ in enumerate(view.run()):
        if step >= shot.seconds * view.conf.physics.control_hz:
            break
    position = view.group.body.motion.position_w[view.row]
    bearing = np.deg2rad(shot.bearing_deg)
    along = np.array([np.cos(bearing), np.sin(bearing)])
    eye = np.append(position[:2] - shot.away_m * along, position[2] + shot.rise * shot.away_m)
    target = np.append(position[:2] + shot.beyond_m * along, position[2] + shot.above_m)
    camera = Viewpoint(tuple(eye.tolist()), tuple(target.tolist()), shot.fov_rad)
    picture = Image.fromarray(Pictures(view.simulation).seen(camera, 0, width, height, samples=SAMPLES))
    view.close()
    write(picture, name, (14, height - 12), "ls")
    return picture


def write(picture: Image.Image, text: str, at: tuple[float, float], anchor: str) -> None:
    """Write a name into a picture."""
    font = ImageFont.load_default(size=26)
    ImageDraw.Draw(picture).text(at, text, "white", font, anchor, stroke_width=2, stroke_fill="#202020")


def tiled(pictures: Sequence[Image.Image], columns: int) -> Image.Image:
    """Pictures of one size in rows, with gaps."""
    width, height = pictures[0].size
    rows = -(-len(pictures) // columns)
    size = columns * (width + GAP_PX) - GAP_PX, rows * (height + GAP_PX) - GAP_PX
    poster = Image.new("RGB", size, "white")
    for number, picture in enumerate(pictures):
        row, column = divmod(number, columns)
        poster.paste(picture, (column * (width + GAP_PX), row * (height + GAP_PX)))
    return poster


def draw_worlds() -> Image.Image:
    """All families of worlds."""
    return tiled([draw_shot(name, shot, 660, 400) for name, shot in WORLDS.items()], 3)


def draw_robots() -> Image.Image:
    """All robots of the package."""
    return tiled([draw_shot(name, shot, 660, 480) for name, shot in ROBOTS.items()], 3)


def draw_actors() -> Image.Image:
    """All bodies of actors, each with its name, on a meadow."""
    width, height = 1992, 880
    view = Viewpoint((-17.5, -0.4, 2.6), (-3.0, 0.3, 1.0), 0.88)
    bodies = [posed(*one) for one in ACTORS]
    picture = Image.fromarray(meadow().render(view, width, height, bodies, SAMPLES))
    for (name, *_), body in zip(ACTORS, bodies, strict=True):
        columns, rows, _ = view.project(PosedBodies([body]).vertices, width, height)
        middle = float(columns.min() + columns.max()) / 2
        write(picture, name, (middle, float(rows.min()) - 8), "ms")
    return picture


POSTERS = {"worlds": draw_worlds, "robots": draw_robots, "actors": draw_actors}


def main() -> None:
    """Write the posters that are named, or all."""
    for name in sys.argv[1:] or POSTERS:
        POSTERS[name]().save(FOLDER / f"poster_{name}.jpg", quality=85, optimize=True)


if __name__ == "__main__":
    main()
