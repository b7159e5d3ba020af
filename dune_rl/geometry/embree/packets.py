"""Packets of 16 rays in Embree's layout, compiled."""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function

WIDTH = 16
# A packet has rows of 16 words: origin 0-2, tnear 3, direction 4-6, time 7, tfar 8, mask, id and flags 9-11;
# then the hit: normal 12-14, u and v 15-16, face 17, geometry 18, instance 19.
ROWS = 24
_TNEAR, _TIME, _MASK, _ID, _FLAGS = 3, 7, 9, 10, 11
DIRECTION, TFAR = 4, 8
NORMAL, FACE, GEOMETRY = 12, 17, 18
_INSTANCE = 19
NONE = np.uint32(0xFFFFFFFF)


@compile_function
def new_packet() -> Any:
    """A packet as words and as numbers, each (ROWS + 1, 16); its last row is the mask of valid rays."""
    # Embree requires packets, and the mask, at multiples of 64 bytes.
    room = np.empty((ROWS + 2) * WIDTH, np.uint32)
    start = (64 - room.ctypes.data % 64) // 4
    words = room[start : start + (ROWS + 1) * WIDTH].reshape(ROWS + 1, WIDTH)
    numbers = words.view(np.float32)
    for k in range(WIDTH):
        numbers[_TNEAR, k] = 0.0
        numbers[_TIME, k] = 0.0
        words[_MASK, k] = NONE
        words[_ID, k] = k
        words[_FLAGS, k] = 0
        words[_INSTANCE, k] = NONE
        words[ROWS, k] = NONE
    return words, numbers


@compile_function
def load_rays(words: Any, numbers: Any, origins: Any, directions: Any, per_origin: int, first: int) -> int:
    """Copy up to 16 rays from index `first` into the packet; returns their number."""
    count = min(WIDTH, len(directions) - first)
    for k in range(WIDTH):
        words[ROWS, k] = NONE if k < count else np.uint32(0)
    for k in range(count):
        ray = first + k
        origin = ray // per_origin
        for axis in range(3):
            numbers[axis, k] = origins[origin, axis]
            numbers[DIRECTION + axis, k] = directions[ray, axis]
    return count
