"""The protocol of sensors, and the types that they share."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.state.state import GroupState, JointState, State

Reading = NDArray[Any]
# Forward, left and up of the body's origin [m]; None is where the body carries such a sensor.
Mount = tuple[float, float, float] | None
MOUNT: Any = Field(
    None, description="forward, left and up of the robot's origin [m]; null: where the robot carries it"
)
# Lowest and highest value of every entry of a reading, in its own shape and type.
Bounds = tuple[Reading, Reading]
MAX_SENSED_SPEED_MPS = 10.0
MAX_SENSED_TURN_RADPS = 34.9
# The smallest float32 that no angle in [-pi, pi] exceeds.
PI32 = np.nextafter(np.float32(np.pi), np.float32(4.0))


class Sensor(Protocol):
    """One sensor on each of the N agents of a group, with one or more readings by name.

    Calls come in this order: `begin` when episodes start, `measure` once after every control step, `read`
    at any time. `now` is the state of the sensor's own group, `state` that of all groups. Random draws use
    `now.episode.seed`, `streams` and `steps`, so that they depend on nothing else.

    A sensor that reads the joints' state (`now.motion.joints`) sets the attribute `needs_joints` to True.
    """

    def bounds(self) -> dict[str, Bounds]:
        """Lowest and highest values of each reading, for one agent."""
        ...

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Read at the start of the episodes in `mask` (N,), which have no past; the others read on."""
        ...

    def measure(self, now: GroupState, state: State) -> None:
        """Read at the end of a control step; call it once a step."""
        ...

    def read(self) -> dict[str, Reading]:
        """The latest readings, each (N, ...); repeated calls return equal arrays."""
        ...


class VectorSensor:
    """Base of sensors with one reading, `name`: (N, ...), of the shape of its bounds, float32.

    A subclass states the bounds of one agent's reading and sets `_reading` in `measure`, by `_store` where
    values may exceed the bounds. Episodes begin with a measurement, unless the subclass remembers something.
    """

    def __init__(self, name: str, num_rows: int, low: ArrayLike, high: ArrayLike) -> None:
        self._name, self._low, self._high = name, np.asarray(low, np.float32), np.asarray(high, np.float32)
        self._reading: Floats = np.zeros((num_rows, *self._low.shape), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """Lowest and highest values of the reading, copies."""
        return {self._name: (self._low.copy(), self._high.copy())}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """As `measure`: nothing is remembered."""
        self.measure(now, state)

    def measure(self, now: GroupState, state: State) -> None:
        """Set the reading of the present state."""
        raise NotImplementedError

    def read(self) -> dict[str, Reading]:
        """The latest reading."""
        return {self._name: self._reading.copy()}

    def _store(self, values: Array | Floats) -> None:
        """Set the reading (N, ...), limited to the bounds."""
        self._reading = np.minimum(np.maximum(values.astype(np.float32), self._low), self._high)


class PictureSensor:
    """Base of sensors with several readings `NAME_OUTPUT`, each (N, height, width, channels).

    `shape` is (height, width). `limits` are the channels, the lowest and the highest value and the type of
    each output. A subclass reads chosen rows in `_look`, and all rows in `measure`.
    """

    def __init__(
        self,
        name: str,
        num_rows: int,
        shape: tuple[int, int],
        limits: Mapping[str, tuple[int, float, float, type]],
    ) -> None:
        self._bounds: dict[str, Bounds] = {
            f"{name}_{output}": (np.full((*shape, size), low, kind), np.full((*shape, size), high, kind))
            for output, (size, low, high, kind) in limits.items()
        }
        self._name = name
        self._readings: dict[str, Reading] = {
            name: np.zeros((num_rows, *low.shape), low.dtype) for name, (low, _) in self._bounds.items()
        }

    def bounds(self) -> dict[str, Bounds]:
        """Lowest and highest values of each reading."""
        return dict(self._bounds)

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Read in the rows in `mask` (N,); the others keep their readings."""
        rows = np.flatnonzero(mask)
        if len(rows):
            for output, values in self._look(rows, now).items():
                self._readings[f"{self._name}_{output}"][rows] = values

    def measure(self, now: GroupState, state: State) -> None:
        """Read anew."""
        self._readings = {f"{self._name}_{output}": each for output, each in self._look(None, now).items()}

    def read(self) -> dict[str, Reading]:
        """The latest readings."""
        return {name: values.copy() for name, values in self._readings.items()}

    def _look(self, rows: NDArray[np.int64] | None, now: GroupState) -> dict[str, Reading]:
        """The outputs of `rows` (n,), or of all."""
        raise NotImplementedError


def mount_position(mount: Mount) -> Array:
    """Position of a sensor in the body frame [m], (3,); the origin where `mount` is None."""
    return np.zeros(3) if mount is None else np.asarray(mount, np.float64)


def joints_of(now: GroupState) -> JointState:
    """The joints' state; raises ValueError where the simulation did not read it."""
    if now.motion.joints is None:
        raise ValueError("the state has no joints; give the sensor the attribute `needs_joints = True`")
    return now.motion.joints
