"""A plan of the ground, on which things are kept apart."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dune_rl.worlds.props import unit_vector

Array = NDArray[np.float64]


class Plan:
    """The ground taken so far, as points that fill rectangles, `spacing_m` apart."""

    def __init__(self, spacing_m: float = 0.2) -> None:
        self._spacing_m = spacing_m
        self._taken: Array = np.empty((0, 2))

    def gap(self, xy: ArrayLike, yaw: float, length: float, width: float) -> float:
        """Distance [m] from a rectangle, `length` along `yaw`, to the nearest ground taken; 0 on it."""
        if not len(self._taken):
            return np.inf
        axes = np.stack([unit_vector(yaw), unit_vector(yaw + np.pi / 2)], axis=-1)
        offset = (self._taken - np.asarray(xy)) @ axes
        beyond = np.maximum(np.abs(offset) - [length / 2, width / 2], 0.0)
        return float(np.hypot(beyond[:, 0], beyond[:, 1]).min())

    def take(self, xy: ArrayLike, yaw: float, length: float, width: float) -> None:
        """Enter a rectangle."""
        u, v = (
            np.linspace(-side / 2, side / 2, 1 + int(np.ceil(side / self._spacing_m)))
            for side in (length, width)
        )
        local = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        axes = np.stack([unit_vector(yaw), unit_vector(yaw + np.pi / 2)])
        self.take_points(np.asarray(xy) + local @ axes)

    def take_points(self, points: Array) -> None:
        """Enter points (N, 2) [m]."""
        self._taken = np.concatenate([self._taken, points])


class Discs:
    """The ground taken so far, as discs."""

    def __init__(self) -> None:
        self._centres: Array = np.empty((0, 2))
        self._radii: Array = np.empty(0)

    def gap(self, xy: ArrayLike, radius: float) -> float:
        """Distance [m] between a disc and the nearest one taken; negative where they overlap."""
        if not len(self._radii):
            return np.inf
        away = np.hypot(*(self._centres - np.asarray(xy)).T)
        return float((away - self._radii).min()) - radius

    def take(self, xy: ArrayLike, radius: float) -> None:
        """Enter a disc."""
        self._centres = np.concatenate([self._centres, np.asarray(xy, dtype=np.float64)[None]])
        self._radii = np.append(self._radii, radius)
