"""Forward speed and yaw rate, as a rover's own controller knows them."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.sensors.sensor import Bounds, Flags, Moment, Reading

MAX_SENSED_SPEED_MPS = 10.0
MAX_SENSED_TURN_RADPS = 34.9
_HIGHEST = np.array([MAX_SENSED_SPEED_MPS, MAX_SENSED_TURN_RADPS], np.float32)


class Speed:
    """The reading "velocity", (M, 2): forward speed [m/s] and yaw rate [rad/s], clipped to their ranges."""

    def __init__(self, num_scenes: int) -> None:
        self._reading: NDArray[np.float32] = np.zeros((num_scenes, 2), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """Both ways alike."""
        return {"velocity": (-_HIGHEST, _HIGHEST)}

    def begin(self, mask: Flags, now: Moment) -> None:
        """As `measure`: nothing is remembered."""
        self.measure(now)

    def measure(self, now: Moment) -> None:
        """Take the present motion."""
        motion = np.stack([now.velocity_b[:, 0], now.angular_b[:, 2]], axis=1).astype(np.float32)
        self._reading = np.minimum(np.maximum(motion, -_HIGHEST), _HIGHEST)

    def read(self) -> dict[str, Reading]:
        """The present motion."""
        return {"velocity": self._reading.copy()}
