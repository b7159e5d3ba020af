"""How actors look, to rays and to cameras: shapes in the actor's own frame, its origin on the ground."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from dune_rl.actors.actor import ActorConf
from dune_rl.rendering.light import srgb_to_linear
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.scenery import Segment, ColouredMesh

_SIDES = 24
# Upper ends of a walker's clothes as shares of its height, and their colours (sRGB).
_CLOTHES = (
    (0.05, (0.10, 0.09, 0.08)),
    (0.47, (0.16, 0.20, 0.34)),
    (0.55, (0.93, 0.45, 0.10)),
    (0.58, (0.86, 0.87, 0.84)),
    (0.68, (0.93, 0.45, 0.10)),
    (0.71, (0.86, 0.87, 0.84)),
    (0.82, (0.93, 0.45, 0.10)),
    (0.91, (0.80, 0.60, 0.47)),
    (1.00, (0.95, 0.80, 0.12)),
)


def actor_moving_meshes(confs: tuple[ActorConf, ...]) -> list[MovingMesh]:
    """The figure of each actor; actors of equal size share theirs."""
    made: dict[tuple[float, float], MovingMesh] = {}
    for conf in confs:
        size = (conf.radius_m, conf.height_m)
        if size not in made:
            made[size] = MovingMesh(_walker(*size))
    return [made[(conf.radius_m, conf.height_m)] for conf in confs]


def _walker(radius_m: float, height_m: float) -> ColouredMesh:
    """An upright capsule, as physics has it, in working clothes."""
    bends = np.linspace(0.0, np.pi / 2, 7)
    round_end = np.column_stack([np.sin(bends), 1.0 - np.cos(bends)]) * radius_m
    seams = height_m * np.array([top for top, _ in _CLOTHES[:-1]])
    seams = seams[(seams > radius_m * 1.05) & (seams < height_m - radius_m * 1.05)]
    sides = np.column_stack([np.full(len(seams), radius_m), seams])
    upper = np.column_stack([round_end[::-1, 0], height_m - round_end[::-1, 1]])
    mesh = trimesh.creation.revolve(np.concatenate([round_end, sides, upper]), sections=_SIDES)
    middle = mesh.triangles_center[:, 2] / height_m
    return ColouredMesh(
        mesh.vertices,
        mesh.faces.astype(np.int32),
        _clothes_at(middle),
        np.full(len(mesh.faces), Segment.ACTOR, np.uint8),
    )


def _clothes_at(share: NDArray[np.float64]) -> NDArray[np.float32]:
    """Linear RGB (F, 3) at shares (F,) of a walker's height."""
    tops = np.array([top for top, _ in _CLOTHES])
    colours = srgb_to_linear(np.array([colour for _, colour in _CLOTHES]))
    return colours[np.minimum(np.searchsorted(tops, share), len(tops) - 1)]
