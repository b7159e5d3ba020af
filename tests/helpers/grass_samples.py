"""Grass for tests."""

import numpy as np

from dune_rl.geometry.heightfield import HeightField
from dune_rl.rendering.foliage import Foliage

PLAIN = HeightField(np.zeros((21, 21)), 1.0, (-10.0, -10.0))
FULL = np.ones((80, 80), np.float32)
TALL_M, EXTINCTION, BEAM_EXTINCTION = 0.6, 2.5, 2.0
EVERYWHERE = Foliage(PLAIN, FULL, TALL_M, EXTINCTION, BEAM_EXTINCTION)
SMALL = {"name": "flat", "size_m": 20.0, "region_size_m": 6.0}
