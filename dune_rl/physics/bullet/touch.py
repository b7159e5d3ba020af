"""What a robot touches in PyBullet."""

from collections.abc import Mapping, Sequence
from typing import Any

from dune_rl.physics.bullet.body import LoadedBody
from dune_rl.physics.process import suppress_stderr

with suppress_stderr():
    import pybullet

# Contact points closer than this count as contacts.
_CONTACT_DISTANCE_M = 1e-3
# What `getContactPoints` takes for any other body, and any link.
ANY_BODY, _ANY_LINK = -1, -2


class TouchedBodies:
    """The bodies that `body` touched since the last `clear`, without ground.

    `numbers` maps PyBullet's handles of the bodies that are not ground to body
    numbers; the scene updates it.
    """

    def __init__(self, body: LoadedBody, numbers: Mapping[int, int]) -> None:
        self._body, self._numbers = body, numbers
        self._touched: set[int] = set()

    def clear(self) -> None:
        """Forget all contacts."""
        self._touched.clear()

    def record(self, handles: Sequence[int]) -> Sequence[tuple[Any, ...]]:
        """Add the bodies touched in the last physics step; returns all contact points with bodies that are
        not ground, as PyBullet lists them.

        `handles` are those of the bodies that the robot can have touched, or ANY_BODY.
        """
        found: list[tuple[Any, ...]] = []
        for handle in handles:
            # Names of arguments would take PyBullet a fifth of the call.
            points = pybullet.getContactPoints(
                self._body.handle, handle, _ANY_LINK, _ANY_LINK, self._body.client
            )
            if points:
                # Ground has no number: what remains is collisions.
                found += [point for point in points if point[2] in self._numbers]
        for point in found:
            if point[8] < _CONTACT_DISTANCE_M:
                self._touched.add(self._numbers[point[2]])
        return found

    def in_order(self) -> list[int]:
        """Body numbers in ascending order."""
        return sorted(self._touched)
