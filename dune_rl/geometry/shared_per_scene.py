"""Per-scene objects that several scenes may share: a query of M scenes runs once per distinct object."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Generic, Self, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.geometry.heightfield import HeightField
from dune_rl.geometry.rays import Hits, RayScene

T = TypeVar("T")
U = TypeVar("U")
Rows = slice | NDArray[np.int64]
Groups = tuple[tuple[T, Rows], ...]

_ALL = slice(None)


class SharedPerScene(Generic[T]):
    """One object for each of M scenes; objects are compared by identity.

    `groups` pairs each distinct object with the scenes that have it, in the order of the first such scene:
    `slice(None)` where all scenes share one object (indexing with it copies nothing), else their indices in
    rising order. The tuple stays the same object until `put` changes a scene.
    """

    def __init__(self, items: Iterable[T]) -> None:
        self._items = list(items)
        self._groups: Groups[T] | None = None

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, scene: int) -> T:
        return self._items[scene]

    def put(self, scene: int, item: T) -> None:
        """Replace the object of one scene."""
        if self._items[scene] is not item:
            self._items[scene] = item
            self._groups = None

    @property
    def groups(self) -> Groups[T]:
        """Each distinct object and the scenes that have it."""
        if self._groups is None:
            self._groups = _group_by_identity(self._items)
        return self._groups

    def select_groups(self, scenes: NDArray[np.int64]) -> Groups[T]:
        """`groups` of the scenes in `scenes` (m,) only, renumbered from 0 in its order."""
        if len(self.groups) == 1:
            return self.groups
        return _group_by_identity([self._items[scene] for scene in scenes.tolist()])

    def map(self, make: Callable[[T], U]) -> "DerivedCache[T, U]":
        """`make(item)` for every scene, computed on first use and kept while any scene has the item."""
        return DerivedCache(self, make)


class DerivedCache(Generic[T, U]):
    """Objects derived from those of a `SharedPerScene`, and updated with it: see `SharedPerScene.map`."""

    def __init__(self, source: SharedPerScene[T], make: Callable[[T], U]) -> None:
        self._source, self._make = source, make
        self._cache: dict[int, tuple[T, U]] = {}
        self._source_groups: Groups[T] = ()
        self._groups: Groups[U] = ()

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, scene: int) -> U:
        self._drop_unused()
        return self._derive(self._source[scene])

    @property
    def groups(self) -> Groups[U]:
        """As `SharedPerScene.groups`, of the derived objects."""
        if self._source.groups is not self._source_groups:
            self._drop_unused()
            self._source_groups = self._source.groups
            self._groups = self._derive_groups(self._source_groups)
        return self._groups

    def select_groups(self, scenes: NDArray[np.int64]) -> Groups[U]:
        """As `SharedPerScene.select_groups`, of the derived objects."""
        return self._derive_groups(self._source.select_groups(scenes))

    def _derive_groups(self, groups: Groups[T]) -> Groups[U]:
        return tuple((self._derive(item), rows) for item, rows in groups)

    def _derive(self, item: T) -> U:
        # The item is stored beside its derivative, so that its id stays taken.
        if id(item) not in self._cache:
            self._cache[id(item)] = (item, self._make(item))
        return self._cache[id(item)][1]

    def _drop_unused(self) -> None:
        if self._source.groups is not self._source_groups:
            used = {id(item) for item, _ in self._source.groups}
            self._cache = {key: value for key, value in self._cache.items() if key in used}


def agent_rows(scenes: Rows, count: int) -> Rows:
    """Row indices of the agents in `scenes`, for scene-major rows with `count` agents per scene."""
    if count == 1 or isinstance(scenes, slice):
        return scenes
    return (scenes[:, None] * count + np.arange(count)).ravel()


def query_grouped(
    groups: Groups[T], query: Callable[..., NDArray[Any]], *arrays: NDArray[Any]
) -> NDArray[Any]:
    """`query(item, *rows)` once per group, with its rows of `arrays` (M, ...); results joined as (M, ...)."""
    if len(groups) == 1:
        return query(groups[0][0], *arrays)
    joined: NDArray[Any] | None = None
    for item, rows in groups:
        result = query(item, *(array[rows] for array in arrays))
        if joined is None:
            joined = np.empty((len(arrays[0]), *result.shape[1:]), result.dtype)
        joined[rows] = result
    assert joined is not None
    return joined


def _group_by_identity(items: Sequence[T]) -> Groups[T]:
    scenes: dict[int, list[int]] = {}
    for scene, item in enumerate(items):
        scenes.setdefault(id(item), []).append(scene)
    if len(scenes) == 1:
        return ((items[0], _ALL),)
    return tuple((items[rows[0]], np.array(rows)) for rows in scenes.values())


class BatchedQueries(Generic[T]):
    """Objects of M scenes, queried together with scene-major arrays: each scene has an M-th of the rows."""

    def __init__(self, items: SharedPerScene[T] | DerivedCache[Any, T]) -> None:
        self._items = items

    def __len__(self) -> int:
        return len(self._items)

    def select_scenes(self, scenes: NDArray[np.int64]) -> Self:
        """The objects of `scenes` (m,) only, renumbered from 0 in that order."""
        return type(self)(SharedPerScene([self._items[scene] for scene in scenes.tolist()]))

    def _query(
        self, query: Callable[..., tuple[NDArray[Any], ...]], *arrays: NDArray[Any]
    ) -> tuple[NDArray[Any], ...]:
        """The arrays of `query(item, *rows)`, made once per group with its rows of `arrays`, and joined."""
        groups, count = self._items.groups, len(self._items)
        if len(groups) == 1:
            return query(groups[0][0], *arrays)
        by_scene = [
            (array.reshape(count, len(array) // count, *array.shape[1:]), (-1, *array.shape[1:]))
            for array in arrays
        ]
        joined: list[NDArray[Any]] = []
        for item, rows in groups:
            found = query(item, *[array[rows].reshape(shape) for array, shape in by_scene])
            assert not isinstance(rows, slice)
            joined = joined or [np.empty((count, len(p) // len(rows), *p.shape[1:]), p.dtype) for p in found]
            for whole, part in zip(joined, found, strict=True):
                whole[rows] = part.reshape(-1, *whole.shape[1:])
        return tuple(whole.reshape(-1, *whole.shape[2:]) for whole in joined)


class BatchedRayScenes(BatchedQueries[RayScene]):
    """A `RayScene` for each of M scenes; origins (S, 3) and rays (N, 3) are scene-major."""

    def shorten_ranges(self, origins: Floats, directions: Floats, ranges: Floats) -> None:
        """As `RayScene.shorten_ranges`."""
        groups, count = self._items.groups, len(self._items)
        if len(groups) == 1:
            groups[0][0].shorten_ranges(origins, directions, ranges)
            return
        by_scene = ranges.reshape(count, -1)
        origins, directions = origins.reshape(count, -1, 3), directions.reshape(count, -1, 3)
        for rays, rows in groups:
            own = by_scene[rows].ravel()
            rays.shorten_ranges(origins[rows].reshape(-1, 3), directions[rows].reshape(-1, 3), own)
            by_scene[rows] = own.reshape(-1, by_scene.shape[1])

    def hits(self, origins: Floats, directions: Floats, ranges: Floats) -> Hits:
        """As `RayScene.hits`; face indices refer to the triangles of the ray's own scene."""
        face, ranges[:], normal = self._query(RayScene.hits, origins, directions, ranges)
        return Hits(face, ranges, normal)

    def any_hit(self, origins: Floats, directions: Floats) -> Flags:
        """As `RayScene.any_hit`."""
        return self._query(lambda rays, *own: (rays.any_hit(*own),), origins, directions)[0]


class BatchedHeightFields(BatchedQueries[HeightField]):
    """A `HeightField` for each of M scenes; points (N, ..., 2) are scene-major."""

    def height(self, xy: Array) -> Array:
        """Height [m], (N, ...), at points (N, ..., 2)."""
        by_scene = xy.reshape(len(self._items), -1, 2)
        return query_grouped(self._items.groups, HeightField.height, by_scene).reshape(xy.shape[:-1])


AnyRays: TypeAlias = RayScene | BatchedRayScenes
