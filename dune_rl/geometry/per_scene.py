"""What each of M scenes has, where several may have the same thing: work goes by things, not by scenes."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
U = TypeVar("U")
Rows = slice | NDArray[np.int64]
Groups = tuple[tuple[T, Rows], ...]

_ALL = slice(None)


class SharedPerScene(Generic[T]):
    """One thing for each of M scenes, compared by identity.

    `groups` are the different things, each with the scenes that have it, in the
    order of their first scenes: `slice(None)` where one serves all, which costs
    nothing, else their indices in rising order. They are the same object until
    a scene is given something else.
    """

    def __init__(self, things: Iterable[T]) -> None:
        self._things = list(things)
        self._groups: Groups[T] | None = None

    def __len__(self) -> int:
        return len(self._things)

    def __getitem__(self, scene: int) -> T:
        return self._things[scene]

    def put(self, scene: int, thing: T) -> None:
        """Give a scene something else."""
        if self._things[scene] is not thing:
            self._things[scene] = thing
            self._groups = None

    @property
    def groups(self) -> Groups[T]:
        """Each different thing and its scenes."""
        if self._groups is None:
            self._groups = _grouped(self._things)
        return self._groups

    def select_scenes(self, scenes: NDArray[np.int64]) -> Groups[T]:
        """As `groups`, of the scenes in `scenes` (m,) alone, which are counted from 0 in its order."""
        return _grouped([self._things[scene] for scene in scenes.tolist()])

    def map(self, make: Callable[[T], U]) -> "Made[T, U]":
        """What `make` makes of each thing, once for as long as a scene has it, when it is first asked for."""
        return DerivedCache(self, make)


class DerivedCache(Generic[T, U]):
    """Things made of those of a `SharedPerScene`, which it follows: see `PerScene.map`."""

    def __init__(self, source: SharedPerScene[T], make: Callable[[T], U]) -> None:
        self._source, self._make = source, make
        self._known: dict[int, tuple[T, U]] = {}
        self._followed: Groups[T] = ()
        self._groups: Groups[U] = ()

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, scene: int) -> U:
        self._forget()
        return self._of(self._source[scene])

    @property
    def groups(self) -> Groups[U]:
        """As those of a `SharedPerScene`."""
        if self._source.groups is not self._followed:
            self._forget()
            self._followed = self._source.groups
            self._groups = self._made(self._followed)
        return self._groups

    def select_scenes(self, scenes: NDArray[np.int64]) -> Groups[U]:
        """As those of a `SharedPerScene`."""
        return self._made(self._source.select_scenes(scenes))

    def _made(self, groups: Groups[T]) -> Groups[U]:
        return tuple((self._of(thing), rows) for thing, rows in groups)

    def _of(self, thing: T) -> U:
        # The thing is kept beside what is made of it, so that no other can take over its id.
        if id(thing) not in self._known:
            self._known[id(thing)] = (thing, self._make(thing))
        return self._known[id(thing)][1]

    def _forget(self) -> None:
        if self._source.groups is not self._followed:
            used = {id(thing) for thing, _ in self._source.groups}
            self._known = {key: value for key, value in self._known.items() if key in used}


def query_grouped(groups: Groups[T], ask: Callable[..., NDArray[Any]], *arrays: NDArray[Any]) -> NDArray[Any]:
    """`ask(thing, *parts)` of each group with its rows of the `arrays` (M, ...), put together: (M, ...)."""
    if len(groups) == 1:
        return ask(groups[0][0], *arrays)
    found: NDArray[Any] | None = None
    for thing, rows in groups:
        part = ask(thing, *(array[rows] for array in arrays))
        if found is None:
            found = np.empty((len(arrays[0]), *part.shape[1:]), part.dtype)
        found[rows] = part
    assert found is not None
    return found


def _grouped(things: Sequence[T]) -> Groups[T]:
    scenes: dict[int, list[int]] = {}
    for scene, thing in enumerate(things):
        scenes.setdefault(id(thing), []).append(scene)
    if len(scenes) == 1:
        return ((things[0], _ALL),)
    return tuple((things[rows[0]], np.array(rows)) for rows in scenes.values())
