"""What shows people where a goal is: a flag in a ring, and an arrow over it. No sensor sees them."""

from collections.abc import Iterable

import numpy as np
import trimesh

from dune_rl.rendering.light import srgb_to_linear
from dune_rl.rendering.scenery import ColouredMesh, Segment, join_meshes

_Part = tuple[trimesh.Trimesh, tuple[float, float, float]]

_GREEN, _WHITE = (0.10, 0.75, 0.35), (0.9, 0.9, 0.88)
# No world and no body has this colour.
_MAGENTA = (1.0, 0.0, 0.55)
# The tip of the arrow is above the flag.
_FLAG_M, _TIP_M = 1.6, 1.7


def goal_flag() -> ColouredMesh:
    """A flag that stands at its origin, in a ring on the ground."""
    pole = trimesh.creation.cylinder(0.025, _FLAG_M, sections=12)
    pole.apply_translation([0.0, 0.0, _FLAG_M / 2])
    flag = trimesh.creation.box([0.02, 0.55, 0.32])
    flag.apply_translation([0.0, 0.29, 1.42])
    ring = trimesh.creation.annulus(0.32, 0.42, 0.04, sections=32)
    ring.apply_translation([0.0, 0.0, 0.06])
    return _join([(pole, _WHITE), (flag, _GREEN), (ring, _GREEN)])


def goal_arrow() -> ColouredMesh:
    """An arrow that points down at its origin, from above a flag there."""
    tip = trimesh.creation.cone(0.28, 0.5, sections=24)
    tip.apply_transform(np.diag([1.0, -1.0, -1.0, 1.0]))
    tip.apply_translation([0.0, 0.0, _TIP_M + 0.5])
    shaft = trimesh.creation.cylinder(0.1, 0.5, sections=24)
    shaft.apply_translation([0.0, 0.0, _TIP_M + 0.7])
    return _join([(tip, _MAGENTA), (shaft, _MAGENTA)])


def _join(parts: Iterable[_Part]) -> ColouredMesh:
    """Meshes in one colour each, in sRGB, as one mesh."""
    return join_meshes(
        [
            ColouredMesh(
                np.asarray(mesh.vertices),
                np.asarray(mesh.faces, np.int32),
                np.tile(srgb_to_linear(np.array(colour)), (len(mesh.faces), 1)),
                np.full(len(mesh.faces), Segment.SKY, np.uint8),
            )
            for mesh, colour in parts
        ]
    )
