"""Worlds and the parts they are built of; a new world is a function that returns a `World`."""

from dune_rl.core.seeding import stream
from dune_rl.core.settings import Settings
from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.scenery import Segment
from dune_rl.worlds.fractal_terrain import rough_field
from dune_rl.worlds.grass import Grass, grow_grass
from dune_rl.worlds.ground_texture import GRAVEL, MEADOW, GroundColours
from dune_rl.worlds.props import beam, merge_meshes, slab, tube, upright_box
from dune_rl.worlds.rocks import rock
from dune_rl.worlds.validation import check_world
from dune_rl.worlds.world import Prop, World

__all__ = [
    "GRAVEL",
    "MEADOW",
    "Grass",
    "GroundColours",
    "HeightField",
    "Prop",
    "Segment",
    "Settings",
    "World",
    "beam",
    "check_world",
    "grow_grass",
    "merge_meshes",
    "rock",
    "rough_field",
    "slab",
    "stream",
    "tube",
    "upright_box",
]
