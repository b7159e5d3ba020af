"""The tightest curve of a body that cannot turn on the spot."""

from typing import NamedTuple


class TurningCircle(NamedTuple):
    """The rear axle, `rear_m` behind the origin, runs on circles of at least `radius_m` [m]."""

    radius_m: float
    rear_m: float
