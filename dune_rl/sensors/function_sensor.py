"""Sensors made of a free function of the state."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.sensors.sensor import Bounds, Flags, Reading
from dune_rl.state import GroupState, State

# f(state, group, *, params) -> (N, size) or, for a size of 1, (N,).
SensorFunction = Callable[..., NDArray[Any]]


class FunctionSensor:
    """The reading `name`, (N, size): what `function(state, group, **params)` returns, clipped to bounds.

    `low` and `high` are numbers or have one for each of the `size` entries. Raises ValueError where the
    function returns another shape or a value that is not a number.
    """

    def __init__(
        self,
        name: str,
        function: SensorFunction,
        num_rows: int,
        *,
        size: int,
        low: float | tuple[float, ...],
        high: float | tuple[float, ...],
        params: Mapping[str, Any] | None = None,
    ) -> None:
        self._name, self._function, self._params = name, function, dict(params or {})
        self._low, self._high = (
            np.broadcast_to(np.array(end, np.float32), (size,)).copy() for end in (low, high)
        )
        if not (self._low <= self._high).all():
            raise ValueError(f"sensor {name!r}: low {low} must be at most high {high}")
        self._reading: NDArray[np.float32] = np.zeros((num_rows, size), np.float32)

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
            raise ValueError(
                f"sensor {self._name!r}: its function returned an array of shape {values.shape}; "
                f"{shape} is needed: a row for each agent and {shape[1]} numbers in it"
            )
        if np.isnan(values).any():
            raise ValueError(f"sensor {self._name!r}: its function returned NaN")
        self._reading = np.minimum(np.maximum(values.reshape(shape), self._low), self._high)

    def read(self) -> dict[str, Reading]:
        """The latest values."""
        return {self._name: self._reading.copy()}
