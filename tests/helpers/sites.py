"""Gazebo worlds with a site on a wide plane: a walled maze, a house with rooms, an orchard, crates."""

from pathlib import Path

import numpy as np
from gazebo import model, sdf

Walls = list[tuple[float, float, float, float]]

WIDE_PLANE = (
    '<model name="ground_plane"><static>true</static><link name="l"><collision name="c"><geometry><plane>'
    "<normal>0 0 1</normal><size>100 100</size></plane></geometry></collision></link></model>"
)
# Ends (x, y, x, y) [m] of walls from the site's corner on.
MAZE: Walls = [
    *((0, 0, 12, 0), (12, 0, 12, 12), (12, 12, 0, 12), (0, 12, 0, 2.5), (2, 0, 2, 8), (4, 2, 4, 12)),
    *((6, 0, 6, 9), (8, 3, 8, 12), (10, 0, 10, 10), (2, 10, 2, 12)),
]
HOUSE: Walls = [
    *((0, 0, 12, 0), (12, 0, 12, 9), (12, 9, 0, 9), (0, 9, 0, 5.2), (0, 3.8, 0, 0), (0, 5.5, 4, 5.5)),
    *((5.4, 5.5, 9, 5.5), (10.4, 5.5, 12, 5.5), (0, 3.5, 2, 3.5), (3.4, 3.5, 8, 3.5), (9.4, 3.5, 12, 3.5)),
    *((6, 5.5, 6, 9), (6, 0, 6, 3.5)),
]
MAZE_AT, HOUSE_AT = (4.0, -11.0), (-20.0, 10.0)
# A door's sill belongs to the inside.
MAZE_INSIDE, HOUSE_INSIDE = (4.0, 16.0, -11.0, 1.0), (-20.3, -8.0, 10.0, 19.0)
ORCHARD_INSIDE, CRATES_INSIDE = (15.0, 35.0, -20.0, 7.5), (11.0, 29.0, 11.0, 29.0)


def walls(ends: Walls, at: tuple[float, float], thickness: float = 0.15, height: float = 1.2) -> list[str]:
    """Models of walls, whose ends are relative to `at`."""
    found = []
    for number, (x0, y0, x1, y1) in enumerate(ends):
        length, yaw = np.hypot(x1 - x0, y1 - y0) + thickness, np.arctan2(y1 - y0, x1 - x0)
        middle = at[0] + (x0 + x1) / 2, at[1] + (y0 + y1) / 2
        shape = f"<box><size>{length} {thickness} {height}</size></box>"
        found.append(model(f"wall_{number}", shape, f"{middle[0]} {middle[1]} {height / 2} 0 0 {yaw}"))
    return found


def orchard() -> list[str]:
    """Six rows of twelve trunks, 4 by 2.5 m apart."""
    trunk = "<cylinder><radius>0.15</radius><length>2</length></cylinder>"
    return [
        model(f"tree_{row}_{number}", trunk, f"{15 + 4 * row} {-20 + 2.5 * number} 1 0 0 0")
        for row in range(6)
        for number in range(12)
    ]


def crates() -> list[str]:
    """Fourteen crates, scattered over 18 by 18 m."""
    rng = np.random.default_rng(0)
    crate = "<box><size>1 1 1.2</size></box>"
    return [
        model(f"crate_{number}", crate, f"{x} {y} 0.6 0 0 0")
        for number, (x, y) in enumerate(rng.uniform(11.0, 29.0, (14, 2)).tolist())
    ]


SITES = {
    "maze": walls(MAZE, MAZE_AT),
    "house": walls(HOUSE, HOUSE_AT),
    "orchard": orchard(),
    "crates": crates(),
    "plane": [],
}


def write_site(folder: Path, name: str, *more: str) -> Path:
    """The file of a site, with further elements of its world."""
    path = folder / f"{name}.sdf"
    path.write_text(sdf(WIDE_PLANE, *SITES[name], *more))
    return path
