"""The obstacle course of the BARN benchmark: cylinders in a walled corridor, by a cellular automaton."""

from typing import Annotated, Literal, Self

import numpy as np
import scipy.ndimage
from pydantic import Field, model_validator

from dune_rl.core.errors import WorldError
from dune_rl.core.seeding import stream
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.heightfield import HeightField
from dune_rl.worlds.ground_texture import GRAVEL
from dune_rl.worlds.props import merge_meshes, tube, upright_box
from dune_rl.worlds.settings import SeededConf
from dune_rl.worlds.world import Prop, World

_CELL_M = 0.15
_SPACING_M = 1.0
# Free ground before and behind the field of cylinders, and the world around the walls.
_END_M, _MARGIN_M = 3.0, 4.0
_WALL_M, _WALL_HEIGHT_M, _HEIGHT_M = 0.2, 1.0, 0.8
_MOST_DRAWS = 1_000
_WALL_COLOUR, _CYLINDER_COLOUR = (0.62, 0.60, 0.56), (0.55, 0.32, 0.20)
_AROUND = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]])


Fill = Annotated[float, Field(ge=0.0, le=0.35)]


class ObstacleCourseConf(SeededConf):
    """A field of cylinders between walls, with free ground at both ends.

    Cells of 0.15 m are filled at random; in each round of `smoothing` a cell is filled where five or more of
    the eight cells around are, and cleared where one or none is. The field is drawn anew until a way
    `passage_m` wide leads through. Perille et al. 2020, Benchmarking Metric Ground Navigation.
    """

    name: Literal["obstacle_course"] = "obstacle_course"
    friction: float = Field(default=1.0, gt=0.0, le=5.0)
    width_m: float = Field(default=4.5, ge=2.0, le=30.0, description="of the corridor")
    length_m: float = Field(default=4.5, ge=2.0, le=60.0, description="of the field of cylinders")
    fill: Fill | tuple[Fill, Fill] = Field(
        default=0.2,
        description="share of cells that are filled at first; of two, the least and the most, which the seed "
        "draws from",
    )
    smoothing: int = Field(default=2, ge=0, le=10, description="rounds of the cellular automaton")
    passage_m: float = Field(default=0.5, ge=0.3, le=2.0, description="least width of the way through")

    @property
    def share_filled(self) -> float:
        """The share of cells that are filled at first."""
        if not isinstance(self.fill, tuple):
            return self.fill
        return float(stream(self.layout, "obstacle course fill").uniform(*self.fill))

    @model_validator(mode="after")
    def _fills_rise(self) -> Self:
        if isinstance(self.fill, tuple) and self.fill[0] > self.fill[1]:
            raise ValueError(f"fill must be [least, most] (got {list(self.fill)})")
        return self


def build_obstacle_course(conf: ObstacleCourseConf) -> World:
    """A corridor along x, centred on y = 0, whose field of cylinders begins at x = 0."""
    half, end = conf.width_m / 2, conf.length_m + _END_M
    low, high = -_END_M - _MARGIN_M, end + _MARGIN_M
    columns = int(np.ceil((high - low) / _SPACING_M))
    rows = int(np.ceil((conf.width_m + 2 * _MARGIN_M) / _SPACING_M))
    terrain = HeightField(np.zeros((rows + 1, columns + 1)), _SPACING_M, (low, -rows * _SPACING_M / 2))
    centre_x, long = (end - _END_M) / 2, end + _END_M + 2 * _WALL_M
    walls = [
        upright_box((centre_x, side * (half + _WALL_M / 2)), 0.0, -0.1, _WALL_HEIGHT_M, long, _WALL_M)
        for side in (-1.0, 1.0)
    ]
    walls += [
        upright_box((x, 0.0), 0.0, -0.1, _WALL_HEIGHT_M, _WALL_M, conf.width_m)
        for x in (-_END_M - _WALL_M / 2, end + _WALL_M / 2)
    ]
    props = [Prop("wall", "wall", *mesh, colour=_WALL_COLOUR) for mesh in walls]
    return World(
        "obstacle_course",
        terrain,
        [*props, *_cylinders(draw_field(conf), conf)],
        region=(-_END_M, end, -half, half),
        friction=conf.friction,
        ground=GRAVEL,
    )


def draw_field(conf: ObstacleCourseConf) -> Flags:
    """Filled cells (columns along x, rows along y) of the field; raises WorldError if no draw is passable."""
    shape, share = (int(conf.length_m / _CELL_M), int(conf.width_m / _CELL_M)), conf.share_filled
    for attempt in range(_MOST_DRAWS):
        filled: Flags = stream(conf.layout, "obstacle course", attempt).uniform(size=shape) < share
        for _ in range(conf.smoothing):
            around = scipy.ndimage.convolve(filled.astype(int), _AROUND, mode="constant")
            filled = (filled | (around >= 5)) & (around > 1)
        if _is_passable(filled, conf.passage_m):
            return filled
    raise WorldError(
        f"world.fill={share:.3g} leaves no way of world.passage_m={conf.passage_m:g} m in {_MOST_DRAWS} "
        "draws: lower one of them"
    )


def _is_passable(filled: Flags, passage_m: float) -> bool:
    """Whether a disc gets from the first column to the last."""
    # The walls beside the field, and free ground before and behind it.
    walled = np.pad(filled, ((1, 1), (0, 0)))
    walled = np.pad(walled, ((0, 0), (1, 1)), constant_values=True)
    apart = scipy.ndimage.distance_transform_edt(~walled) * _CELL_M
    # From a cell's centre to the surface of a cylinder.
    parts, _ = scipy.ndimage.label(apart >= (passage_m + _CELL_M) / 2)
    ends = set(parts[0].tolist()) & set(parts[-1].tolist())
    return bool(ends - {0})


def _cylinders(filled: Flags, conf: ObstacleCourseConf) -> list[Prop]:
    """The cylinders of the filled cells; those that touch are one prop."""
    groups, count = scipy.ndimage.label(filled, structure=np.ones((3, 3)))
    origin = np.array([0.0, -conf.width_m / 2]) + _CELL_M / 2
    props = []
    for number in range(1, count + 1):
        places: Array = origin + _CELL_M * np.argwhere(groups == number)
        meshes = [tube([*xy, -0.1], [*xy, _HEIGHT_M], _CELL_M / 2, sides=10) for xy in places.tolist()]
        props.append(Prop("cylinders", "post", *merge_meshes(meshes), colour=_CYLINDER_COLOUR))
    return props
