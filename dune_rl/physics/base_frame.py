"""Conversion of a base link's state from its inertial frame, which engines report, to the link frame."""

from collections.abc import Sequence
from dataclasses import dataclass

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]


@dataclass(frozen=True)
class InertialFrame:
    """Pose of a link's inertial frame in its link frame: origin (3) [m] and quaternion xyzw (4)."""

    origin_b: Sequence[float]
    quaternion_b: Sequence[float]

    @property
    def is_identity(self) -> bool:
        """Whether the inertial frame is the link frame."""
        return not any(self.origin_b) and not any(self.quaternion_b[:3])

    def link_state(
        self,
        centre_w: Sequence[float],
        quaternion: Sequence[float],
        velocity_w: Sequence[float],
        angular_w: Sequence[float],
    ) -> tuple[Triple, Quadruple, Triple]:
        """Position [m], quaternion and velocity [m/s] of the link frame's origin.

        Arguments are the pose and the velocities of the inertial frame, all in the world frame.
        """
        x, y, z, w = self.quaternion_b
        link_quaternion = _multiply(quaternion, (-x, -y, -z, w))
        ax, ay, az = _rotate(link_quaternion, self.origin_b)
        ox, oy, oz = angular_w
        return (
            (centre_w[0] - ax, centre_w[1] - ay, centre_w[2] - az),
            link_quaternion,
            (
                velocity_w[0] - (oy * az - oz * ay),
                velocity_w[1] - (oz * ax - ox * az),
                velocity_w[2] - (ox * ay - oy * ax),
            ),
        )


def _multiply(first: Sequence[float], second: Sequence[float]) -> Quadruple:
    x1, y1, z1, w1 = first
    x2, y2, z2, w2 = second
    return (
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
    )


def _rotate(quaternion: Sequence[float], vector: Sequence[float]) -> Triple:
    x, y, z, w = quaternion
    a, b, c = vector
    # v + 2 q x (q x v + w v)
    i, j, k = y * c - z * b + w * a, z * a - x * c + w * b, x * b - y * a + w * c
    return a + 2 * (y * k - z * j), b + 2 * (z * i - x * k), c + 2 * (x * j - y * i)
