"""A world: terrain, props on it, and queries about both."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.light import LightConf
from dune_rl.rendering.mesh_texture import MeshTexture
from dune_rl.rendering.scenery import Segment
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.cache.folder import DiskCache
from dune_rl.worlds.clearance import ClearanceField, NearestObstacle
from dune_rl.worlds.fractal_terrain import RoughnessField
from dune_rl.worlds.grass import Grass
from dune_rl.worlds.ground_texture import MEADOW, GroundColours, GroundPicture
from dune_rl.worlds.props import Mesh, merge_meshes
from dune_rl.worlds.surfaces import Deck, Decks, SurfaceMap, SurfaceName

Colour = tuple[float, float, float]
Rectangle = tuple[float, float, float, float]
T = TypeVar("T")

BETWEEN_OBJECTS, OPEN_GROUND = "between objects", "open ground"

# About half a robot's length, so that the disc holds all wheels of a robot.
ROUGHNESS_RADIUS_M = 0.5


@dataclass(frozen=True, eq=False)
class Prop:
    """A fixed object, as one mesh in the world frame: `vertices` (V, 3) [m], `faces` (F, 3).

    `solid=False` (water) is only visible: physics and LiDAR beams pass it. `drivable=True` (a bridge's deck)
    counts as ground: touching it is no collision. `colour` is sRGB in [0, 1]; `face_colours` (F, 3) give each
    face its own colour, `texture` its own picture. A solid prop consists of closed surfaces whose faces run
    counter-clockwise seen from outside. `segment` overrides the semantic class that follows from the other
    fields. `surface` is the material of a drivable prop in a world with a surface map; None: that of the
    ground below it.
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
    face_colours: Floats | None = None
    texture: MeshTexture | None = None

    @property
    def mesh(self) -> Mesh:
        """`vertices` and `faces`."""
        return self.vertices, self.faces

    @property
    def segment_class(self) -> Segment:
        """Semantic class in segmentations: `segment` if given, else from `kind` and `drivable`."""
        if self.segment is not None:
            return self.segment
        if self.kind == "water":
            return Segment.WATER
        return Segment.DECK if self.drivable else Segment.OBSTACLE


@dataclass(frozen=True)
class RegionCandidate:
    """A rectangle (xmin, xmax, ymin, ymax) [m] in which a robot can drive from one place to another.

    `place` says what is around it: `BETWEEN_OBJECTS` or `OPEN_GROUND`. `free_m2` is the area of the positions
    that the middle of a robot can take.
    """

    rectangle: Rectangle
    place: str
    free_m2: float

    def describe(self) -> str:
        """Where the rectangle is and why it was chosen, as part of a sentence."""
        xmin, xmax, ymin, ymax = self.rectangle
        where = f"x {xmin:.4g} to {xmax:.4g}, y {ymin:.4g} to {ymax:.4g} m"
        share = self.free_m2 / ((xmax - xmin) * (ymax - ymin))
        return f"{where}: {self.place}, {min(share, 1.0):.0%} of it free and connected"


class SolidMesh(NamedTuple):
    """Terrain and solid props; `owner` (F,) is each face's index in `World.props`, -1 for terrain."""

    vertices: Array
    faces: NDArray[np.int32]
    owner: NDArray[np.int32]


@dataclass(eq=False, repr=False)
class World:
    """Terrain and props, with the queries that physics, sensors and tasks need.

    `region` is the rectangle (xmin, xmax, ymin, ymax) [m] in which tasks draw starts and goals by default;
    `friction` is the friction coefficient of the ground and of every prop. `ground` and `texture_seed`
    determine the ground's texture, with `picture` over it if there is one; `grass` is the tall grass on it.
    `surfaces`, if given, maps the materials of the ground and of drivable props: they determine the contacts
    of wheels, and `friction` only those of everything else. The friction of a contact is the product of both
    coefficients or, with `takes_smaller_friction`, the smaller one, as in Gazebo's ODE. `light` is the
    world's own sun, for weathers that do not set one. `disk_cache`, set by a `WorldStore`, keeps arrays
    computed from the world. `region_candidates` are the regions that an importer found, the preferred one
    first; other worlds have none. `trajectories` are those of the actors that a file brings along.
    """

    name: str
    terrain: HeightField
    props: Sequence[Prop] = ()
    _: KW_ONLY
    region: Rectangle
    friction: float = 1.0
    takes_smaller_friction: bool = False
    ground: GroundColours = MEADOW
    texture_seed: int = 0
    grass: Grass | None = None
    surfaces: SurfaceMap | None = None
    picture: GroundPicture | None = None
    light: LightConf | None = None
    region_candidates: tuple[RegionCandidate, ...] = field(default=(), init=False)
    trajectories: tuple[ActorTrajectory, ...] = field(default=(), init=False)
    disk_cache: DiskCache | None = field(default=None, init=False)
    _clearance_class: ClassVar[type[ClearanceField]] = ClearanceField

    def __post_init__(self) -> None:
        self.props = tuple(self.props)

    @cached_property
    def _memo(self) -> dict[Hashable, Any]:
        return {}

    def memoize(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of `make()`, computed at the first call with `key` and stored with the world.

        It may depend on the world and on `key` only. It must not refer to the
        world, or the cycle would keep the world in memory after its last use.
        """
        if key not in self._memo:
            self._memo[key] = make()
        return self._memo[key]

    def disk_cached(self, name: str, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """The array `make()`, read from the `disk_cache` if there is one and it holds `name`."""
        return make() if self.disk_cache is None else self.disk_cache.get_or_compute(name, make)

    @property
    def extent(self) -> Rectangle:
        """The terrain's rectangle (xmin, xmax, ymin, ymax) [m]."""
        return self.terrain.extent

    def solid_mesh(self) -> SolidMesh:
        """Terrain and solid props as one mesh, terrain first."""
        solid = {-1: self.terrain.mesh()} | {k: prop.mesh for k, prop in enumerate(self.props) if prop.solid}
        owner = np.repeat(np.array(list(solid), np.int32), [len(faces) for _, faces in solid.values()])
        return SolidMesh(*merge_meshes(solid.values()), owner)

    @cached_property
    def rays(self) -> RayScene:
        """Ray scene of `solid_mesh()`."""
        solid = self.solid_mesh()
        return RayScene(solid.vertices, solid.faces)

    @cached_property
    def _decks(self) -> Decks | None:
        assert self.surfaces is not None
        decks = [
            Deck(*prop.mesh, None if prop.surface is None else self.surfaces.number(prop.surface))
            for prop in self.props
            if prop.solid and prop.drivable
        ]
        return Decks(decks, self.terrain, self.surfaces) if decks else None

    def surface_below(self, points_w: Array) -> tuple[NDArray[np.uint8], Array]:
        """Surface below wheels' lowest points (..., 3) [m]: number in `surfaces` (...), height [m] (...).

        A point over a deck is on the deck unless it is well below the deck's
        top, as under a bridge. For worlds with `surfaces` only.
        """
        assert self.surfaces is not None, "the world has no map of surfaces"
        numbers = self.surfaces.at(points_w[..., :2])
        height = self.terrain.height(points_w[..., :2])
        if self._decks is not None:
            on_deck, deck_number, top = self._decks.surface_below(points_w)
            numbers, height = np.where(on_deck, deck_number, numbers), np.where(on_deck, top, height)
        return numbers, height

    @cached_property
    def clearance_field(self) -> ClearanceField:
        """The distance field that `clearance` interpolates."""
        solid = [prop for prop in self.props if prop.solid]
        return self._clearance_class(
            self.terrain,
            [prop.mesh for prop in solid if not prop.drivable],
            [prop.mesh for prop in solid if prop.drivable],
        )

    def clearance(self, xy: ArrayLike) -> Array:
        """Distance [m], shape (...), from points (..., 2) to the nearest obstacle.

        An obstacle is a prop where it occupies the height band from 0.03 to 0.45 m above the ground (or above
        a drivable deck). 0 inside an obstacle, inf in a world without obstacles.
        """
        return self.clearance_field(xy)

    def nearest_obstacle(self, xy: ArrayLike) -> NearestObstacle:
        """Clearance [m], (...), of points (..., 2), and the nearest obstacle points (..., 2).

        Obstacle points are accurate to two cells of `clearance_field` (0.1 m).
        """
        return self.clearance_field.nearest(xy)

    def roughness(self, xy: ArrayLike, radius_m: float = ROUGHNESS_RADIUS_M) -> Array:
        """RMS height [m], (...), of the ground about its best-fit plane within `radius_m` of points (..., 2).

        See `RoughnessField`; the first query of each radius computes its grid.
        """
        field = self.memoize(("roughness", radius_m), lambda: RoughnessField(self.terrain, radius_m))
        return field(xy)


def describe_choice(region: Rectangle, candidates: tuple[RegionCandidate, ...]) -> str | None:
    """One line about the chosen region and how to choose another; None if it is none of the candidates."""
    numbers = [number for number, each in enumerate(candidates, start=1) if each.rectangle == region]
    if not numbers:
        return None
    number, count = numbers[0], len(candidates)
    if count == 1:
        ways = "world.region=[xmin,xmax,ymin,ymax] chooses another"
    else:
        ways = f"world.region={1 if number > 1 else 2} chooses another of {count}; view=map shows them"
    return f"Starts and goals: {candidates[number - 1].describe()} ({ways})"
