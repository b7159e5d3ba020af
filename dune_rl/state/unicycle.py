"""A model of a body that is driven by its speed and its heading."""

from dataclasses import dataclass

import numpy as np

from dune_rl.geometry.arrays import Array


@dataclass(frozen=True)
class Unicycle:
    """Model of a body with (speed, heading) actions, and its rectangle seen from above.

    A commanded heading e [rad] gives the yaw rate `heading_gain_per_s` * e, at most `max_yaw_rate_radps`.
    `turning_radius_m` is that of the smallest circle, 0 for a body that turns on the spot.
    """

    min_speed_mps: float
    max_speed_mps: float
    max_yaw_rate_radps: float
    heading_gain_per_s: float
    length_m: float
    width_m: float
    footprint_radius_m: float
    turning_radius_m: float = 0.0

    def yaw_rates(self, headings: Array) -> Array:
        """The yaw rates (N,) [rad/s] that commanded headings (N,) [rad] give."""
        most = self.max_yaw_rate_radps
        return np.clip(headings * self.heading_gain_per_s, -most, most)
