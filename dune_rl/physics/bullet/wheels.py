"""Contact parameters of a robot's wheels or feet in PyBullet."""

from collections.abc import Sequence

from dune_rl.physics.bullet.body import LoadedBody
from dune_rl.physics.process import suppress_stderr

with suppress_stderr():
    import pybullet


class WheelContacts:
    """Contact parameters of the W ground links of `body`, which PyBullet gets only when they change."""

    def __init__(self, body: LoadedBody) -> None:
        self._body = body
        # Friction, restitution, stiffness and damping of each wheel; empty as long as they are those loaded.
        self._rows: list[tuple[float, ...]] = []

    def reset(self) -> None:
        """Forget the parameters of a robot that was replaced by one at the start."""
        self._rows = [() for _ in self._body.ground_links]

    def set(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> None:
        """Set the parameters, (W) each; see `PhysicsRobot.set_wheel_contacts`."""
        # PyBullet ignores negative values.
        unchanged = [-1.0] * len(self._rows)
        rows = zip(friction, restitution, stiffness or unchanged, damping or unchanged, strict=True)
        for wheel, row in enumerate(rows):
            if row != self._rows[wheel]:
                self._rows[wheel] = row
                self._apply(wheel, row)

    def apply_again(self) -> None:
        """Give all parameters to a robot that was loaded anew in the same state."""
        for wheel, row in enumerate(self._rows):
            if row:
                self._apply(wheel, row)

    def _apply(self, wheel: int, row: Sequence[float]) -> None:
        body = self._body
        pybullet.changeDynamics(
            body.handle,
            body.ground_links[wheel],
            lateralFriction=row[0],
            restitution=row[1],
            contactStiffness=row[2],
            contactDamping=row[3],
            physicsClientId=body.client,
        )
