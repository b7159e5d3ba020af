"""Segments and luminances of a world's solid surfaces, for LiDAR beams."""

import numpy as np
from scipy import ndimage

from dune_rl.geometry.arrays import Floats
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.beam_surface import BeamSurface
from dune_rl.rendering.scenery import Segment
from dune_rl.worlds.appearance import build_scenery
from dune_rl.worlds.world import World


def beam_surface(world: World) -> BeamSurface:
    """Segments and luminances of the faces of `world.solid_mesh()`, in their order; cached with the world."""
    return world.memoize("beam surface", lambda: _build_beam_surface(world))


def _build_beam_surface(world: World) -> BeamSurface:
    scenery = build_scenery(world)
    albedo = _face_albedo(world.terrain, scenery.ground.albedo)
    solid = np.repeat([prop.solid for prop in world.props], [len(prop.faces) for prop in world.props])
    if len(solid) != len(scenery.props.faces):
        raise ValueError(
            f"the props of {world.name} have {len(solid)} faces, but its scenery has "
            f"{len(scenery.props.faces)}: they must be the same, in the same order"
        )
    ground = np.full(len(albedo), Segment.GROUND, np.uint8)
    solid = solid.astype(bool)
    return BeamSurface.from_faces(
        np.concatenate([ground, scenery.props.segments[solid]]),
        np.concatenate([albedo, scenery.props.albedo[solid]]),
    )


def _face_albedo(terrain: HeightField, texture: Floats) -> Floats:
    """Linear RGB (F, 3) of the terrain's faces: the texture's mean over a square of a cell's size."""
    rows, columns = texture.shape[:2]
    xmin, xmax, ymin, ymax = terrain.extent
    per_m = np.array([columns / (xmax - xmin), rows / (ymax - ymin)])
    width, height = np.maximum(1, np.round(terrain.spacing_m * per_m).astype(int))
    mean = ndimage.uniform_filter(texture, (height, width, 1), mode="nearest")
    vertices, faces = terrain.mesh()
    centres = vertices[faces, :2].mean(axis=1)
    column, row = ((centres - [xmin, ymin]) * per_m).astype(np.intp).T
    return mean[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
