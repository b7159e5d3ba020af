"""Names of the array types: the shape stands in each docstring."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]

ArrayT = TypeVar("ArrayT", bound=NDArray[Any])


def freeze(array: ArrayT) -> ArrayT:
    """Make `array` read-only and return it; other views of its memory stay as they are."""
    array.setflags(write=False)
    return array
