"""Search for regions of an imported world in which episodes may start: between its objects, if it has any.

A place is between objects if the directions in which objects are near leave no gap of about half a turn.
This holds inside walls, in the rooms of a building and between the rows of an orchard, but not on the ground
around them.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from dune_rl.geometry.arrays import Array, Flags
from dune_rl.worlds.passage import FreeSpace
from dune_rl.worlds.world import BETWEEN_OBJECTS, OPEN_GROUND, Rectangle, RegionCandidate, World

# Regions are searched for a robot of this size, since the world does not know its robots.
_ROBOT_RADIUS_M, _SLOPE_DEG, _EDGE_M = 0.5, 20.0, 1.5
_CELL_M, _MOST_CELLS = 0.1, 1_000_000
# An object is near up to this distance.
_NEAR_M, _COARSE_M = 10.0, 0.5
_SECTORS, _LARGEST_GAP = 8, 3
_CLOSING_M = 1.0
# A cell counts by half at this distance from the nearest object, and less beyond it.
_HALF_WEIGHT_M = 3.0
# Largest sides of a region, and the least free area and diagonal of one between objects.
_OPEN_M = 8.0
_SIDES_M = ((12.0, 12.0), (12.0, 8.0), (8.0, 12.0), (8.0, 8.0), (5.0, 5.0))
_LEAST_M2, _LEAST_DIAGONAL_M = 6.0, 4.0
# From this size on, where the paths of walkers fit too, a place between objects is preferred to open ground.
_LARGE_M2, _LARGE_DIAGONAL_M = 12.0, 8.0
# Weight of free cells in a region that are not part of its connected place.
_OUTSIDE_COST = 1.5
_MOST_PLACES, _MOST_WINDOWS, _MOST_CANDIDATES = 6, 24, 4
_LARGEST_OVERLAP = 0.3
# Score of an open square: its free share, up to this one beside objects, minus the cost of a distance of the
# world's width.
_FREE_ENOUGH, _DISTANCE_COST = 0.9, 0.4


def find_region_candidates(world: World, known: Flags | None = None) -> list[RegionCandidate]:
    """Regions for starts and goals, the preferred first: between objects, open ground, small places.

    `known` (rows, columns) marks terrain points that were not filled in; None: all. The list is empty if no
    ground is level and free enough.
    """
    grid = _Grid.of(world, known)
    between = _search_between_objects(grid)
    large = [each for each in between if _is_large(each)]
    opened = _find_open_square(grid)
    apart = opened is not None and all(_overlap(opened, other) < _LARGEST_OVERLAP for other in large)
    small = [each for each in between if not _is_large(each)]
    return [*large, *([opened] if opened is not None and apart else []), *small]


def _is_large(candidate: RegionCandidate) -> bool:
    xmin, xmax, ymin, ymax = candidate.rectangle
    return candidate.free_m2 >= _LARGE_M2 and np.hypot(xmax - xmin, ymax - ymin) >= _LARGE_DIAGONAL_M


class _Grid(NamedTuple):
    """Cells of a world: which a robot can occupy, which have an object, their weights and coordinates."""

    usable: Flags
    objects: Flags
    weight: Array
    x: Array
    y: Array
    cell_m: float

    @classmethod
    def of(cls, world: World, known: Flags | None) -> "_Grid":
        xmin, xmax, ymin, ymax = world.extent
        edge = min(_EDGE_M, 0.15 * min(xmax - xmin, ymax - ymin))
        cell_m = max(_CELL_M, float(np.sqrt((xmax - xmin) * (ymax - ymin) / _MOST_CELLS)))
        free = FreeSpace(world, _ROBOT_RADIUS_M, _SLOPE_DEG, cell_m=cell_m, edge_m=edge)
        usable = free.traversable
        if known is not None and not known.all():
            spacing = world.terrain.spacing_m
            row = np.clip(np.round((free.y - ymin) / spacing).astype(int), 0, known.shape[0] - 1)
            column = np.clip(np.round((free.x - xmin) / spacing).astype(int), 0, known.shape[1] - 1)
            usable = usable & known[np.ix_(row, column)]
        objects = free.clearance < 0.75 * free.cell_m
        weight = 1.0 / (1.0 + free.clearance / _HALF_WEIGHT_M)
        return cls(usable, objects, weight, free.x, free.y, free.cell_m)

    def rectangle(self, rows: slice, columns: slice) -> Rectangle:
        """The rectangle [m] of a range of cells."""
        half, x, y = self.cell_m / 2, self.x[columns], self.y[rows]
        xmin, xmax, ymin, ymax = (
            round(float(side), 6) for side in (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half)
        )
        return xmin, xmax, ymin, ymax


def _find_between_objects(grid: _Grid) -> Flags:
    """Mask of the cells with objects near in directions that leave no gap of about half a turn."""
    step = max(1, round(_COARSE_M / grid.cell_m))
    rows, columns = (-(-side // step) for side in grid.objects.shape)
    padded = np.zeros((rows * step, columns * step), bool)
    padded[: grid.objects.shape[0], : grid.objects.shape[1]] = grid.objects
    coarse = padded.reshape(rows, step, columns, step).any(axis=(1, 3)).astype(np.float32)
    reach = max(2, round(_NEAR_M / (step * grid.cell_m)))
    offset = np.arange(-reach, reach + 1)
    across, up = np.meshgrid(offset, offset)
    distance = np.hypot(across, up)
    sector = np.floor(np.arctan2(up, across) / (2 * np.pi / _SECTORS)).astype(int) % _SECTORS
    near = (distance > 0) & (distance <= reach)
    occupied = np.empty((_SECTORS, rows, columns), bool)
    # Correlations by FFT: scipy.signal, which has them, takes a second to import.
    shape = [fft.next_fast_len(side + 2 * reach, real=True) for side in (rows, columns)]
    spectrum = fft.rfft2(coarse, shape)
    for number in range(_SECTORS):
        kernel = (near & (sector == number))[::-1, ::-1].astype(np.float32)
        counts = fft.irfft2(spectrum * fft.rfft2(kernel, shape), shape)
        occupied[number] = counts[reach : reach + rows, reach : reach + columns] > 0.5
    # Some sector of each so many neighbours has an object.
    neighbours = [np.roll(occupied, -shift, axis=0) for shift in range(_LARGEST_GAP + 1)]
    between = np.logical_or.reduce(neighbours).all(axis=0)
    fine = between.repeat(step, axis=0).repeat(step, axis=1)
    fine = fine[: grid.objects.shape[0], : grid.objects.shape[1]]
    closed = fine | ndimage.binary_closing(fine, iterations=max(1, round(_CLOSING_M / grid.cell_m)))
    # Without the ground before doors, which is near to both sides of a wall.
    return ndimage.binary_erosion(closed, iterations=max(1, round(_COARSE_M / grid.cell_m)))


def _search_between_objects(grid: _Grid) -> list[RegionCandidate]:
    if not grid.objects.any():
        return []
    labels, count = ndimage.label(grid.usable & _find_between_objects(grid))
    sizes = np.bincount(labels.reshape(-1), minlength=count + 1)[1:]
    least = _LEAST_M2 / grid.cell_m**2
    places = np.argsort(-sizes, kind="stable")[:_MOST_PLACES]
    found: list[tuple[float, RegionCandidate]] = []
    for place in places[sizes[places] >= least].tolist():
        inside = labels == place + 1
        for _ in range(_MOST_CANDIDATES):
            window = _best_window(inside, grid)
            if window is None:
                break
            rectangle = grid.rectangle(window.rows, window.columns)
            candidate = RegionCandidate(rectangle, BETWEEN_OBJECTS, window.cells * grid.cell_m**2)
            if all(_overlap(candidate, other) < _LARGEST_OVERLAP for _, other in found):
                found.append((window.score, candidate))
            inside[window.rows, window.columns] = False
    found.sort(key=lambda each: -each[0])
    return [candidate for _, candidate in found[:_MOST_CANDIDATES]]


class _Window(NamedTuple):
    """A range of cells, the number of cells of its largest connected part, and its score."""

    rows: slice
    columns: slice
    cells: int
    score: float


def _best_window(inside: Flags, grid: _Grid) -> _Window | None:
    """The window with the largest connected part of a place (rows, columns), near objects.

    Free cells that do not belong to that part count against a window. None if every part is too small.
    """
    if not inside.any():
        return None
    (bounds,) = ndimage.find_objects(inside.astype(np.int8))
    low_row, low_column = bounds[0].start, bounds[1].start
    gain = inside[bounds] * (1.0 + _OUTSIDE_COST) - grid.usable[bounds] * _OUTSIDE_COST
    integral = _integrate(grid.weight[bounds] * gain)
    best: _Window | None = None
    for sides_m in _SIDES_M:
        for highest, rows, columns in _promising_windows(integral, sides_m, grid.cell_m):
            rows = slice(rows.start + low_row, rows.stop + low_row)
            columns = slice(columns.start + low_column, columns.stop + low_column)
            if best is not None and highest <= best.score:
                break
            parts, count = ndimage.label(inside[rows, columns])
            if not count:
                continue
            sizes = np.bincount(parts.reshape(-1))[1:]
            part = int(sizes.argmax())
            cells, own = int(sizes[part]), parts == part + 1
            low, high = ndimage.find_objects(parts)[part]
            diagonal = np.hypot(low.stop - low.start, high.stop - high.start) * grid.cell_m
            if cells * grid.cell_m**2 < _LEAST_M2 or diagonal < _LEAST_DIAGONAL_M:
                continue
            weight = grid.weight[rows, columns]
            others = weight[grid.usable[rows, columns] & ~own].sum()
            score = float(weight[own].sum() - _OUTSIDE_COST * others)
            if best is None or score > best.score:
                own_rows = slice(rows.start + low.start, rows.start + low.stop)
                own_columns = slice(columns.start + high.start, columns.start + high.stop)
                best = _Window(own_rows, own_columns, cells, score)
    return best


def _promising_windows(
    integral: Array, sides_m: tuple[float, float], cell_m: float
) -> Iterator[tuple[float, slice, slice]]:
    """The windows of `sides_m` with the largest sums, and these; see `_integrate`."""
    limits = zip(sides_m, integral.shape, strict=True)
    size = [max(1, min(int(side_m / cell_m), count - 1)) for side_m, count in limits]
    stride = max(1, min(size) // 6)
    sums = _window_sums(integral, size[0], size[1], stride)
    order = np.argsort(-sums.reshape(-1), kind="stable")[:_MOST_WINDOWS]
    for row, column in zip(*np.unravel_index(order, sums.shape), strict=True):
        first_row, first_column = int(row) * stride, int(column) * stride
        rows, columns = slice(first_row, first_row + size[0]), slice(first_column, first_column + size[1])
        yield float(sums[row, column]), rows, columns


def _find_open_square(grid: _Grid) -> RegionCandidate | None:
    """The square of up to 8 m with much free ground, near the objects or else the middle of the world."""
    labels, count = ndimage.label(grid.usable)
    if not count:
        return None
    part = labels == int(np.bincount(labels[labels > 0]).argmax())
    height, width = (side * grid.cell_m for side in part.shape)
    edge = min(_EDGE_M, 0.15 * min(height, width))
    wide = min(_OPEN_M, width - 2 * edge, height - 2 * edge)
    cells = max(1, min(int(wide / grid.cell_m), *part.shape))
    share = _window_sums(_integrate(part), cells, cells) / cells**2
    rows, columns = np.indices(share.shape).reshape(2, -1)
    middle_row, middle_column = (side / 2 for side in part.shape)
    if grid.objects.any():
        middle_row, middle_column = (float(np.median(index)) for index in np.nonzero(grid.objects))
    across, up = columns + cells / 2 - middle_column, rows + cells / 2 - middle_row
    away = np.hypot(across / part.shape[1], up / part.shape[0])
    enough = float(share.max()) * (_FREE_ENOUGH if grid.objects.any() else 1.0)
    score = np.minimum(share.reshape(-1), enough) / enough - _DISTANCE_COST * away
    best = int(score.argmax())
    row, column = int(rows[best]), int(columns[best])
    rectangle = grid.rectangle(slice(row, row + cells), slice(column, column + cells))
    area = float(share.reshape(-1)[best]) * (cells * grid.cell_m) ** 2
    return RegionCandidate(rectangle, OPEN_GROUND, area)


def _integrate(values: NDArray[np.generic]) -> Array:
    """Sums (rows + 1, columns + 1) of `values` (rows, columns) below and left of each corner of a cell."""
    integral = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    integral[1:, 1:] = values.astype(np.float64).cumsum(axis=0).cumsum(axis=1)
    return integral


def _window_sums(integral: Array, rows: int, columns: int, stride: int = 1) -> Array:
    """The sum of each window, or of every `stride`-th along both axes, by its lowest row and column."""
    bands = integral[rows::stride] - integral[:-rows:stride]
    return bands[:, columns::stride] - bands[:, :-columns:stride]


def _overlap(one: RegionCandidate, other: RegionCandidate) -> float:
    """Area that two candidates share, relative to the smaller one."""
    a, b = one.rectangle, other.rectangle
    width, height = min(a[1], b[1]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[2], b[2])
    areas = [(r[1] - r[0]) * (r[3] - r[2]) for r in (a, b)]
    return max(width, 0.0) * max(height, 0.0) / min(areas)
