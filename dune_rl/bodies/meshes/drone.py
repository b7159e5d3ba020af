"""A quadrotor with four propellers that turn, a camera below and skids."""

from typing import TYPE_CHECKING

import numpy as np

from dune_rl.bodies.meshes.solids import ball, box, disc, moved, tube, turned, union
from dune_rl.rendering.scenery import ColouredMesh

if TYPE_CHECKING:
    from dune_rl.bodies.drone import DroneConf

_SHELL = (0.88, 0.89, 0.90)
_DARK = (0.10, 0.10, 0.11)
_BLADE = (0.22, 0.22, 0.24)


def draw_drone(conf: "DroneConf", phase: float) -> ColouredMesh:
    """The drone at a phase in [0, 1) of a quarter of a turn of its propellers; it stands on its origin."""
    long, wide, tall = conf.size_m
    blade = 0.19 * min(long, wide)
    hubs = [(x * (long / 2 - blade), y * (wide / 2 - blade)) for x in (-1, 1) for y in (-1, 1)]
    level = 0.62 * tall
    parts = [
        ball((0, 0, level), (0.21 * long, 0.14 * wide, 0.20 * tall), _SHELL, 10, 5),
        box((-0.02, 0, level + 0.16 * tall), (0.22 * long, 0.12 * wide, 0.12 * tall), _DARK, (0.85, 0.85)),
        ball((0.15 * long, 0, level - 0.22 * tall), (0.05, 0.05, 0.05), _DARK, 8, 5),
        disc((0.15 * long + 0.045, 0, level - 0.22 * tall), 0.025, 0.03, (0.35, 0.45, 0.60), 8, 0),
        box((0.20 * long, 0, level + 0.02), (0.02, 0.10 * wide, 0.02), (0.2, 0.9, 0.2)),
    ]
    for number, (x, y) in enumerate(hubs):
        root = (0.12 * x, 0.12 * y, level)
        parts.append(tube([(root, 0.028, 0.022), ((x, y, level + 0.02), 0.020, 0.018)], _SHELL, 6))
        parts.append(disc((x, y, level + 0.05), 0.032, 0.10, _DARK, 8, 2))
        lamp = (0.9, 0.1, 0.1) if x < 0 else (0.1, 0.8, 0.2)
        parts.append(box((x, y, level - 0.01), (0.03, 0.03, 0.03), lamp))
        turn = (1.0 if number in (0, 3) else -1.0) * (phase * np.pi / 2 + 0.4 * number)
        propeller = box((0, 0, 0), (2 * blade, 0.045, 0.012), _BLADE)
        parts.append(moved(turned(propeller, turn, (0, 0, 0), axis=2), (x, y, level + 0.105)))
    for side in (-1.0, 1.0):
        y = side * 0.17 * wide
        parts.append(
            tube(
                [((-0.22 * long, y, 0.014), 0.014, 0.014), ((0.22 * long, y, 0.014), 0.014, 0.014)], _DARK, 6
            )
        )
        for x in (-0.12 * long, 0.12 * long):
            parts.append(
                tube([((x, y, 0.014), 0.012, 0.012), ((x, 0.6 * y, level - 0.05), 0.012, 0.012)], _DARK, 5)
            )
    return union(parts)
