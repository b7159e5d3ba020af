"""Bodies of a scene that physics does not move: static meshes, and shapes whose motion is prescribed."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Array

# Friction coefficient of kinematic bodies.
KINEMATIC_FRICTION = 0.5


@dataclass(frozen=True)
class StaticBody:
    """Triangle mesh that never moves: vertices (V, 3) [m] in the world frame, faces (F, 3).

    Contacts of robots with `ground` are not reported; a contact with any other body is a collision. Friction
    and restitution coefficients are multiplied with those of the other body of a contact.
    """

    name: str
    vertices: Array
    faces: NDArray[np.int32]
    friction: float
    ground: bool
    restitution: float = 0.0


@dataclass(frozen=True)
class KinematicCapsule:
    """Upright capsule whose motion is prescribed; its origin is on the ground below its centre.

    It pushes robots with at most `max_push_n` [N], horizontally, and is held back or pushed away by larger
    resistance. The default is the largest initial force for men in ISO 11228-2.
    """

    name: str
    radius_m: float
    height_m: float
    max_push_n: float = 250.0

    @property
    def centre_height_m(self) -> float:
        """Height of the centre above the origin."""
        return self.height_m / 2

    def reach_m(self, lean_rad: float) -> float:
        """Upper bound of the horizontal distance [m] of its points from its origin; it does not lean."""
        return self.radius_m


@dataclass(frozen=True)
class KinematicBox:
    """Box whose motion is prescribed; its origin is on the ground below its centre, and it leans about it.

    It is from `clearance_m`, such as a truck's underside, to `height_m` above the ground, `length_m` along
    its x axis and `width_m` along y. It pushes robots as a `KinematicCapsule` does: robots can hold back or
    push away its origin, but not its turns.
    """

    name: str
    length_m: float
    width_m: float
    height_m: float
    clearance_m: float = 0.0
    max_push_n: float = 250.0

    def __post_init__(self) -> None:
        if self.height_m <= self.clearance_m:
            raise ValueError(
                f"the box {self.name!r} has no height: it is from clearance_m ({self.clearance_m}) to "
                f"height_m ({self.height_m}) above the ground"
            )

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Length, width and height of the box itself [m]."""
        return self.length_m, self.width_m, self.height_m - self.clearance_m

    @property
    def centre_height_m(self) -> float:
        """Height of the centre above the origin."""
        return (self.clearance_m + self.height_m) / 2

    def reach_m(self, lean_rad: float) -> float:
        """Upper bound of the horizontal distance [m] of its points from its origin.

        It leans by at most `lean_rad`, the sum of the amounts of roll and pitch.
        """
        farthest = max(abs(self.clearance_m), abs(self.height_m))
        return math.hypot(self.length_m, self.width_m) / 2 + farthest * min(lean_rad, 1.0)


KinematicShape = KinematicCapsule | KinematicBox


Faces = NDArray[np.int32]


def mesh_pieces(
    vertices: Array, faces: Faces, most_vertices: int, most_faces: int
) -> Iterator[tuple[Array, Faces]]:
    """Split a mesh into pieces within both limits, along its longest axis; a mesh within them stays whole.

    Every triangle is in exactly one piece, unchanged; pieces repeat the vertices along their seams.
    """
    if len(vertices) <= most_vertices and len(faces) <= most_faces:
        yield vertices, faces
        return
    count = max(2, -(-len(faces) // most_faces), -(-len(vertices) // most_vertices))
    centres = vertices[faces].mean(axis=1)
    order = np.argsort(centres[:, int(np.ptp(centres, axis=0).argmax())], kind="stable")
    for chosen in np.array_split(order, count):
        used, index = np.unique(faces[chosen], return_inverse=True)
        piece = index.reshape(-1, 3).astype(np.int32)
        # Repeated vertices along the seams may exceed the limit: split again.
        yield from mesh_pieces(vertices[used], piece, most_vertices, most_faces)
