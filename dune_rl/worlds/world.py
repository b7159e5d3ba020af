"""A world: terrain, and the props that stand on it."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.scenery import Segment
from dune_rl.rendering.texture import MeshTexture
from dune_rl.worlds.cache_folder import DiskCache
from dune_rl.worlds.clearance import ClearanceField
from dune_rl.worlds.grass import Grass
from dune_rl.worlds.ground import MEADOW, Ground, GroundPicture
from dune_rl.worlds.queries import NearestObstacle, ObstacleSearch, RoughnessField
from dune_rl.worlds.surface_map import Deck, Decks, SurfaceMap
from dune_rl.worlds.surfaces import SurfaceName

Array = NDArray[np.float64]
Rectangle = tuple[float, float, float, float]
Colour = tuple[float, float, float]
T = TypeVar("T")

# A robot's length or so, wheels included: what its wheels stand on at once.
ROUGHNESS_RADIUS_M = 0.5


@dataclass(frozen=True, eq=False)
class Prop:
    """A fixed thing in the world, as one mesh in the world frame: `vertices` (V, 3) [m], `faces` (F, 3).

    `solid=False` is to look at only (water): neither physics nor rays meet it.
    `drivable=True` (a bridge's deck) counts as ground: touching it is no
    collision. `colour` is red, green, blue in [0, 1], and `face_colours` (F, 3)
    are those of its faces where they differ; `texture` is the pictures on them. A
    solid prop is made of closed surfaces whose faces run counter-clockwise seen
    from outside.
    `segment` is what it is shown as where that does not follow from the rest.
    `surface` is what a drivable one is made of where the world has a map of
    surfaces; None: of what the ground below it is.
    """

    name: str
    kind: str
    vertices: Array
    faces: NDArray[np.int32]
    solid: bool = True
    drivable: bool = False
    colour: Colour = (0.6, 0.6, 0.6)
    segment: Segment | None = None
    surface: SurfaceName | None = None
    face_colours: NDArray[np.float32] | None = None
    skin: MeshTexture | None = None

    @property
    def segment_class(self) -> Segment:
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
    looks like, with `picture` over it where there is one; `grass` is what grows
    on it. `surfaces`, where given, is what the ground and what lies drivable on
    it are made of: wheels take it in place of `friction`, which is then that of
    other things alone. `light` is its own sun, for weathers that do not say
    where theirs is. `disk_cache` is where a `WorldStore` keeps what is worked out
    from it.
    """

    shelf: DiskCache | None = None

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
        surfaces: SurfaceMap | None = None,
        picture: GroundPicture | None = None,
        light: LightConf | None = None,
    ) -> None:
        self.name = name
        self.terrain = terrain
        self.props = tuple(props)
        self.region = region
        self.friction = friction
        self.ground = ground
        self.texture_seed = texture_seed
        self.grass = grass
        self.surfaces = surfaces
        self.picture = picture
        self.light = light

    @cached_property
    def _kept(self) -> dict[Hashable, Any]:
        return {}

    def memoize(self, key: Hashable, make: Callable[[], T]) -> T:
        """What `make` gives, made at the first call with `key` and kept as long as the world.

        For what follows from the world, and from the settings in `key`, alone.
        It must not refer to the world, which would then outlive its use.
        """
        if key not in self._kept:
            self._kept[key] = make()
        found: T = self._kept[key]
        return found

    def disk_cached(self, name: str, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """What `make` gives, read back from `disk_cache` if there is one: what follows from the world alone."""
        return make() if self.disk_cache is None else self.disk_cache.keep(name, make)

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
    def _decks(self) -> Decks | None:
        assert self.surfaces is not None
        decks = [
            Deck(
                prop.vertices,
                prop.faces,
                None if prop.surface is None else self.surfaces.number(prop.surface),
            )
            for prop in self.props
            if prop.solid and prop.drivable
        ]
        return Decks(decks, self.terrain, self.surfaces) if decks else None

    def surface_below(self, points_w: Array) -> tuple[NDArray[np.uint8], Array]:
        """What is under the bottoms of wheels (..., 3) [m]: its number in `surfaces`, and its height [m].

        Each is of shape (...). One over a deck is on it unless it is well
        below its top, as under a bridge. For worlds with `surfaces` only.
        """
        assert self.surfaces is not None, "the world has no map of surfaces"
        numbers = self.surfaces.at(points_w[..., :2])
        height = self.terrain.height(points_w[..., :2])
        if self._decks is not None:
            on, deck, top = self._decks.under(points_w)
            numbers, height = np.where(on, deck, numbers), np.where(on, top, height)
        return numbers, height

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

    @cached_property
    def _obstacle_search(self) -> ObstacleSearch:
        return ObstacleSearch(self.clearance_field)

    def nearest_obstacle(self, xy: ArrayLike) -> NearestObstacle:
        """Clearance [m], (...), of points (..., 2), and the points (..., 2) of the obstacles it is to.

        These lie within two cells of `clearance_field` (0.1 m) of the true ones.
        """
        return self._obstacle_search(xy)

    @cached_property
    def _roughness_fields(self) -> dict[float, RoughnessField]:
        return {}

    def roughness(self, xy: ArrayLike, radius_m: float = ROUGHNESS_RADIUS_M) -> Array:
        """RMS height [m], (...), of the ground about its plane within `radius_m` of points (..., 2).

        See `RoughnessField`; the first question about a radius takes longer.
        """
        if radius_m not in self._roughness_fields:
            self._roughness_fields[radius_m] = RoughnessField(self.terrain, radius_m)
        return self._roughness_fields[radius_m](xy)


def _join(parts: Sequence[tuple[int, Array, NDArray[np.int32]]]) -> SolidMesh:
    starts = np.cumsum([0, *(len(vertices) for _, vertices, _ in parts[:-1])])
    return SolidMesh(
        np.concatenate([vertices for _, vertices, _ in parts]),
        np.concatenate(
            [faces + start for (_, _, faces), start in zip(parts, starts, strict=True)], dtype=np.int32
        ),
        np.concatenate([np.full(len(faces), index, np.int32) for index, _, faces in parts]),
    )
