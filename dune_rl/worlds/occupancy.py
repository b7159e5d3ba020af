"""Occupied areas of a layout, to keep props apart while they are placed."""

import numpy as np
from numpy.typing import ArrayLike

from dune_rl.geometry.arrays import Array
from dune_rl.worlds.props import unit_vector


class OccupiedRectangles:
    """Occupied rectangles, sampled by points `spacing_m` [m] apart."""

    def __init__(self, spacing_m: float = 0.2) -> None:
        self._spacing_m = spacing_m
        self._points: Array = np.empty((0, 2))

    def gap(self, xy: ArrayLike, yaw: float, length: float, width: float) -> float:
        """Distance [m] from a rectangle, `length` along `yaw`, to the nearest occupied point; 0 on one."""
        if not len(self._points):
            return np.inf
        axes = np.stack([unit_vector(yaw), unit_vector(yaw + np.pi / 2)], axis=-1)
        offset = (self._points - np.asarray(xy)) @ axes
        beyond = np.maximum(np.abs(offset) - [length / 2, width / 2], 0.0)
        return float(np.hypot(beyond[:, 0], beyond[:, 1]).min())

    def add(self, xy: ArrayLike, yaw: float, length: float, width: float) -> None:
        """Mark a rectangle as occupied."""
        u, v = (
            np.linspace(-side / 2, side / 2, 1 + int(np.ceil(side / self._spacing_m)))
            for side in (length, width)
        )
        local = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        axes = np.stack([unit_vector(yaw), unit_vector(yaw + np.pi / 2)])
        self.add_points(np.asarray(xy) + local @ axes)

    def add_points(self, points: Array) -> None:
        """Mark points (N, 2) [m] as occupied."""
        self._points = np.concatenate([self._points, points])


class OccupiedDiscs:
    """Occupied discs."""

    def __init__(self) -> None:
        self._centres: Array = np.empty((0, 2))
        self._radii: Array = np.empty(0)

    def gap(self, xy: ArrayLike, radius: float) -> float:
        """Distance [m] between a disc and the nearest occupied one; negative where they overlap."""
        if not len(self._radii):
            return np.inf
        away = np.hypot(*(self._centres - np.asarray(xy)).T)
        return float((away - self._radii).min()) - radius

    def add(self, xy: ArrayLike, radius: float) -> None:
        """Mark a disc as occupied."""
        self._centres = np.concatenate([self._centres, np.asarray(xy, dtype=np.float64)[None]])
        self._radii = np.append(self._radii, radius)
