"""Forward and inverse kinematics of a leg with three joints: hip roll, upper leg, lower leg."""

from dataclasses import dataclass

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import clip


@dataclass(frozen=True)
class Leg:
    """Lengths of a leg [m], and the range of its knee [rad].

    The hip turns about x and holds the leg `offset_m` outward. Upper leg, `upper_m` long, and lower leg,
    `lower_m` long, swing forward for positive angles (about -y). With all angles at zero the leg hangs
    straight down. `knee_rad` limits the knee angle, lowest and highest: the lower leg bends forward only,
    as in a dog's hind leg.
    """

    offset_m: float
    upper_m: float
    lower_m: float
    knee_rad: tuple[float, float]

    def foot(self, angles: Array, side: Array) -> Array:
        """Position of the foot (..., 3) [m] relative to the hip joint: x forward, y left, z up.

        `angles` (..., 3) [rad] are those of hip, upper and lower leg; `side` (...) is 1 for a left leg, -1
        for a right one.
        """
        hip, upper, lower = (angles[..., i] for i in range(3))
        ahead = self.upper_m * np.sin(upper) + self.lower_m * np.sin(upper + lower)
        down = self.upper_m * np.cos(upper) + self.lower_m * np.cos(upper + lower)
        out = side * self.offset_m
        across = out * np.cos(hip) + down * np.sin(hip)
        up = out * np.sin(hip) - down * np.cos(hip)
        return np.stack([ahead, across, up], axis=-1)

    def angles(self, foot: Array, side: Array) -> Array:
        """Joint angles (..., 3) [rad] for a foot at `foot` (..., 3) [m], or near it if out of reach."""
        ahead, across, up = (foot[..., i] for i in range(3))
        out = side * self.offset_m
        down = np.sqrt(np.maximum(across**2 + up**2 - self.offset_m**2, 1e-8))
        hip = np.arctan2(up, across) - np.arctan2(-down, out)
        hip = (hip + np.pi) % (2 * np.pi) - np.pi
        reach2 = ahead**2 + down**2
        bend = (reach2 - self.upper_m**2 - self.lower_m**2) / (2 * self.upper_m * self.lower_m)
        knee = clip(np.arccos(clip(bend, -1.0, 1.0)), *self.knee_rad)
        upper = np.arctan2(ahead, down) - np.arctan2(
            self.lower_m * np.sin(knee), self.upper_m + self.lower_m * np.cos(knee)
        )
        return np.stack([hip, upper, knee], axis=-1)
