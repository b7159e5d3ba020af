"""Draws bodies of actors from four sides: `python docs/pictures/draw_bodies.py FOLDER [NAME ...]`.

It writes `NAME.png` into the folder, for each body of the package if none is named.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from dune_rl.bodies.registry import BODIES
from dune_rl.bodies.settings import BodySettings, pictures_of
from dune_rl.geometry.frames import rotation_from_yaw
from dune_rl.rendering.moving_mesh import PosedMesh, RayMesh
from dune_rl.rendering.renderer import Renderer, Viewpoint
from dune_rl.rendering.weather import WeatherConf
from dune_rl.worlds.appearance import bake_in_weather
from dune_rl.worlds.flat import FlatConf, build_flat

_DRONE_M = 2.3


def body_of(name: str) -> BodySettings:
    """The body of this name with its defaults; a person as a figure."""
    settings = {"name": name, "looks": "figure"} if name == "person" else {"name": name}
    body: BodySettings = BODIES.parse_settings(settings)
    return body


def posed(name: str, x: float, y: float, heading_deg: float, phase: float) -> PosedMesh:
    """A body on level ground."""
    body = body_of(name)
    pictures = pictures_of(body)
    height = _DRONE_M if body.flight is not None else 0.0
    turn = rotation_from_yaw(np.asarray(np.deg2rad(heading_deg)))
    shape = RayMesh(pictures[round(phase * len(pictures)) % len(pictures)])
    return PosedMesh(shape, np.array([x, y, height]), turn)


def meadow() -> Renderer:
    """The renderer of a level meadow in fair weather."""
    return Renderer(bake_in_weather(build_flat(FlatConf()), WeatherConf()))


def draw_sides(renderer: Renderer, name: str, size: int = 420) -> Image.Image:
    """A body from the left, the front, behind and half from above."""
    body = body_of(name)
    reach, height = body.keep_out_radius_m, body.size_m[2]
    away = 2.2 * max(reach, 0.62 * height)
    low = (_DRONE_M if body.flight is not None else 0.0) + 0.5 * height
    directions = ((0, 1, 0.12), (1, 0.12, 0.1), (-0.9, 0.45, 0.35), (0.8, 0.7, 0.6))
    tiles = []
    for number, (x, y, z) in enumerate(directions):
        way = np.array([x, y, z]) / np.linalg.norm([x, y, z])
        eye = away * 1.25 * way + [0.0, 0.0, low]
        view = Viewpoint(tuple(eye.tolist()), (0.0, 0.0, low), 0.75)
        mesh = posed(name, 0.0, 0.0, 0.0, 0.25 * number)
        tiles.append(renderer.render(view, size, size, [mesh], samples=2))
    return Image.fromarray(np.concatenate(tiles, axis=1))


def main() -> None:
    """Write the pictures."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    renderer = meadow()
    for name in sys.argv[2:] or BODIES.own:
        draw_sides(renderer, name).save(folder / f"{name}.png")


if __name__ == "__main__":
    main()
