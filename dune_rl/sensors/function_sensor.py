"""Sensors made of a free function of the state."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import RegistryError
from dune_rl.geometry.arrays import Flags, Floats
from dune_rl.sensors.sensor import Bounds, Reading
from dune_rl.state.state import GroupState, State

# f(state, group, *, params) -> (N, size) or, for a size of 1, (N,).
SensorFunction = Callable[..., NDArray[Any]]


@dataclass(frozen=True)
class ReadingBounds:
    """What `dune_rl.sensor_bounds` states: a reading's size, and the lowest and highest of its entries."""

    low: float | tuple[float, ...]
    high: float | tuple[float, ...]
    size: int = 1


class FunctionSensor:
    """The reading `name`, (N, size): what `function(state, group, **params)` returns, clipped to `bounds`.

    Raises RegistryError, whose sentence opens with `origin`, where the function returns another shape or a
    value that is not a number.
    """

    def __init__(
        self,
        name: str,
        function: SensorFunction,
        num_rows: int,
        bounds: ReadingBounds,
        params: Mapping[str, Any],
        origin: str,
    ) -> None:
        self._name, self._function, self._params, self._origin = name, function, dict(params), origin
        ends = (np.array(end, np.float32) for end in (bounds.low, bounds.high))
        self._low, self._high = (np.broadcast_to(end, (bounds.size,)).copy() for end in ends)
        if not (self._low <= self._high).all():
            raise RegistryError(f"{origin}, whose low {bounds.low} must be at most its high {bounds.high}.")
        self._reading: Floats = np.zeros((num_rows, bounds.size), np.float32)

    def bounds(self) -> dict[str, Bounds]:
        """As given."""
        return {self._name: (self._low, self._high)}

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """As `measure`: nothing is remembered."""
        self.measure(now, state)

    def measure(self, now: GroupState, state: State) -> None:
        """Call the function."""
        values = np.asarray(self._function(state, now, **self._params), np.float32)
        shape = self._reading.shape
        if values.shape != shape and not (shape[1] == 1 and values.shape == shape[:1]):
            raise RegistryError(
                f"{self._origin}, which must return an array of shape {shape}, a row for each agent, "
                f"and returned one of shape {values.shape}."
            )
        if np.isnan(values).any():
            raise RegistryError(f"{self._origin}, which returned NaN.")
        self._reading = np.minimum(np.maximum(values.reshape(shape), self._low), self._high)

    def read(self) -> dict[str, Reading]:
        """The latest values."""
        return {self._name: self._reading.copy()}
