"""Beams of range sensors: their directions, and their ranges in the static world and to moving bodies."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.shared_per_scene import AnyRays
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.sensors.beam_loops import turn_beams
from dune_rl.sensors.sensor import Mount, mount_position

# Settings of all sensors that measure ranges.
LargestRange = Annotated[
    float, Field(gt=0.0, le=1_000.0, description="largest reading, and that where nothing returns [m]")
]
FieldOfView = Annotated[float, Field(gt=0.0, le=360.0, description="angle spanned, centred ahead [deg]")]
Elevation = Annotated[float, Field(ge=-90.0, le=90.0)]


def bearings(fov_rad: float, count: int) -> Array:
    """Bearings (count,) [rad] in the sensor frame, counter-clockwise from -fov/2.

    A full circle leaves out its last beam, which would repeat the first.
    """
    full_circle = np.isclose(fov_rad, 2 * np.pi)
    return np.linspace(-fov_rad / 2, fov_rad / 2, count, endpoint=not full_circle)


def fan(bearing: Array, elevation: Array) -> Array:
    """Unit vectors (E, B, 3) at bearings (B,) and elevations (E,) [rad].

    Sensor frame: x forward, y left, z up.
    """
    level, up = np.cos(elevation)[:, None], np.sin(elevation)[:, None]
    axes = [level * np.cos(bearing), level * np.sin(bearing), np.broadcast_to(up, (len(up), len(bearing)))]
    return np.stack(axes, axis=-1)


def check_elevations(lowest_deg: float, highest_deg: float, name: str, count: int) -> None:
    """Raise ValueError unless both can bound a fan of `count` elevations, which the setting `name` tells."""
    sound = lowest_deg < highest_deg if count > 1 else lowest_deg == highest_deg
    if not sound:
        rule = "must be less than" if count > 1 else "must equal"
        raise ValueError(
            f"lowest_elevation_deg ({lowest_deg:g}) {rule} highest_elevation_deg ({highest_deg:g}) "
            f"where {name}={count}"
        )


def columns_by_mesh(meshes: Sequence[MovingMesh]) -> list[tuple[MovingMesh, NDArray[np.int64]]]:
    """Each different mesh, with the columns of a group's neighbours that have it."""
    return [(mesh, np.flatnonzero([mesh is other for other in meshes])) for mesh in dict.fromkeys(meshes)]


class Beams:
    """Rays from a mount on N robots, cast at the static world and at the moving bodies of each scene.

    `directions_b` (P, 3) are unit vectors and `mount_b` (3,) [m] is where they start, both in the body frame.
    `meshes` are those of the other moving bodies, one for each column of `neighbours`.
    """

    def __init__(
        self,
        directions_b: Array,
        mount_b: Mount,
        range_m: float,
        static: AnyRays,
        meshes: Sequence[MovingMesh],
    ) -> None:
        self.directions_b = directions_b
        self._mount_b = mount_position(mount_b)
        self._range_m = range_m
        self._static, self._meshes = static, columns_by_mesh(meshes)

    def origin(self, position_w: Array, rotation: Array) -> Array:
        """Where the rays start [m], (N, 3), on robots at `position_w` (N, 3) turned by `rotation`."""
        return position_w + rotation @ self._mount_b

    def ranges(self, position_w: Array, rotation: Array, neighbours: Array) -> Floats:
        """Range along every ray [m], (N, P): `range_m` where nothing returns.

        `position_w` (N, 3) and `rotation` (N, 3, 3) are the robots' poses, `neighbours` (N, K, 7) the
        poses of the other moving bodies: see `GroupState.neighbours`.
        """
        rows, count = len(position_w), len(self.directions_b)
        origin = self.origin(position_w, rotation)
        directions = np.empty((rows, count, 3))
        directions32 = np.empty((rows, count, 3), np.float32)
        turn_beams(self.directions_b, rotation, directions, directions32)
        ranges = np.full((rows, count), self._range_m, np.float32)
        self._static.shorten_ranges(
            origin.astype(np.float32), directions32.reshape(-1, 3), ranges.reshape(-1)
        )
        for mesh, columns in self._meshes:
            poses = neighbours if len(self._meshes) == 1 else neighbours[:, columns]
            mesh.shorten_ranges(origin, directions, poses, self._range_m, ranges)
        return ranges
