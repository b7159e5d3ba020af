"""A model of a body that is driven by its speed and its heading."""

from dataclasses import dataclass


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
