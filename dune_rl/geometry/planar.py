"""Lengths in the plane, for compiled loops."""

import numpy as np

from dune_rl.geometry.compiled import compile_function


@compile_function
def length(x: float, y: float) -> float:
    """Length of a vector. `numpy.hypot`, which no number is too large for, takes several times as long."""
    found: float = np.sqrt(x * x + y * y)
    return found
