"""A world: terrain, and the props that stand on it."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.scenery import Segment
from dune_rl.worlds.clearance import ClearanceField
from dune_rl.worlds.grass import Grass
from dune_rl.worlds.ground import MEADOW, Ground

Array = NDArray[np.float64]
Rectangle = tuple[float, float, float, float]
Colour = tuple[float, float, float]
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Prop:
    """A fixed thing in the world, as one mesh in the world frame: `vertices` (V, 3) [m], `faces` (F, 3).

    `solid=False` is to look at only (water): neither physics nor rays meet it.
    `drivable=True` (a bridge's deck) counts as ground: touching it is no
    collision. `colour` is red, green, blue in [0, 1]. A solid prop is made of
    closed surfaces whose faces run counter-clockwise seen from outside.
    `segment` is what it is shown as where that does not follow from the rest.
    """

    name: str
    kind: str
    vertices: Array
    faces: NDArray[np.int32]
    solid: bool = True
    drivable: bool = False
    colour: Colour = (0.6, 0.6, 0.6)
    segment: Segment | None = None

    @property
    def shown_as(self) -> Segment:
        """What segmentations call it: `segment` where that is given."""
        if self.segment is not None:
            return self.segment
        if self.kind == "water":
            return Segment.WATER
        return Segment.DECK if self.drivable else Segment.OBSTACLE


class SolidMesh(NamedTuple):
    """All that rays and physics meet; `owner` (F,) is each face's index in `World.props`, -1 for terrain."""

    vertices: Array
    faces: NDArray[np.int32]
    owner: NDArray[np.int32]


class World:
    """Terrain and props, and what may be asked of them.

    `region` is the rectangle (xmin, xmax, ymin, ymax) [m] in which tasks spawn
    and set goals unless told otherwise; `friction` is the coefficient of the
    ground and of every prop. `ground` and `texture_seed` are what the ground
    looks like; `grass` is what grows on it.
    """

    def __init__(
        self,
        name: str,
        terrain: HeightField,
        props: Sequence[Prop] = (),
        *,
        region: Rectangle,
        friction: float = 1.0,
        ground: Ground = MEADOW,
        texture_seed: int = 0,
        grass: Grass | None = None,
    ) -> None:
        self.name = name
        self.terrain = terrain
        self.props = tuple(props)
        self.region = region
        self.friction = friction
        self.ground = ground
        self.texture_seed = texture_seed
        self.grass = grass
        self._kept: dict[Hashable, Any] = {}

    def kept(self, key: Hashable, make: Callable[[], T]) -> T:
        """What `make` gives, made at the first call with `key` and kept as long as the world.

        For what follows from the world, and from the settings in `key`, alone.
        It must not refer to the world, which would then outlive its use.
        """
        if key not in self._kept:
            self._kept[key] = make()
        found: T = self._kept[key]
        return found

    @property
    def extent(self) -> Rectangle:
        """The terrain's rectangle (xmin, xmax, ymin, ymax) [m]."""
        return self.terrain.extent

    def solid_mesh(self) -> SolidMesh:
        """Terrain and solid props as one mesh."""
        solid = [(index, prop) for index, prop in enumerate(self.props) if prop.solid]
        vertices, faces = self.terrain.mesh()
        parts = [(-1, vertices, faces), *((index, prop.vertices, prop.faces) for index, prop in solid)]
        return _join(parts)

    @cached_property
    def rays(self) -> RayScene:
        """All that is solid, to cast rays at."""
        solid = self.solid_mesh()
        return RayScene(solid.vertices, solid.faces)

    @cached_property
    def clearance_field(self) -> ClearanceField:
        """The distance field behind `clearance`."""
        blocking = [prop for prop in self.props if prop.solid and not prop.drivable]
        decks = [prop for prop in self.props if prop.solid and prop.drivable]
        return ClearanceField(
            self.terrain,
            [(prop.vertices, prop.faces) for prop in blocking],
            [(prop.vertices, prop.faces) for prop in decks],
        )

    def clearance(self, xy: ArrayLike) -> Array:
        """Distance [m], shape (...), from points (..., 2) to the nearest prop that a robot can hit.

        A prop counts where it stands between 0.03 and 0.45 m over the ground
        (or over a drivable deck); 0 inside one, inf in a world without any.
        """
        return self.clearance_field(xy)


def _join(parts: Sequence[tuple[int, Array, NDArray[np.int32]]]) -> SolidMesh:
    starts = np.cumsum([0, *(len(vertices) for _, vertices, _ in parts[:-1])])
    return SolidMesh(
        np.concatenate([vertices for _, vertices, _ in parts]),
        np.concatenate(
            [faces + start for (_, _, faces), start in zip(parts, starts, strict=True)], dtype=np.int32
        ),
        np.concatenate([np.full(len(faces), index, np.int32) for index, _, faces in parts]),
    )
