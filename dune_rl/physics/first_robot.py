"""What a scene of either engine answers as its first robot."""

from collections.abc import Sequence
from typing import Generic, TypeVar

from dune_rl.physics.interface import PhysicsRobot
from dune_rl.physics.varied_body import BodyVariation

RobotT = TypeVar("RobotT", bound=PhysicsRobot)


class AnswersAsFirst(Generic[RobotT]):
    """The part of a `PhysicsScene` that is a `PhysicsRobot`: that of its robot `_first`."""

    _first: RobotT

    def set_body(self, variation: BodyVariation) -> None:
        self._first.set_body(variation)

    def push(self, force_w: Sequence[float]) -> None:
        self._first.push(force_w)

    def set_wheel_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        self._first.set_wheel_contacts(friction, restitution, stiffness, damping)

    def work_j(self) -> float:
        return self._first.work_j()

    def body_state(self) -> tuple[float, ...]:
        return self._first.body_state()

    def drive_state(self) -> tuple[float, ...]:
        return self._first.drive_state()

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        return self._first.joint_angles(joints)

    def touched(self) -> Sequence[int]:
        return self._first.touched()
