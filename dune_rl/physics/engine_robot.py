"""What the robots of both engines have in common: start pose, commands, external force and contacts."""

from collections.abc import Sequence

from dune_rl.physics.robot_body import RobotBody


class EngineRobot:
    """The part of a `PhysicsRobot` that needs no engine; `touched` are bodies, in the last control step."""

    def __init__(self, spec: RobotBody) -> None:
        self.spec = spec
        self.start_pose: tuple[Sequence[float], Sequence[float]] = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
        self.touched: set[int] = set()
        self.forget_episode()

    def forget_episode(self) -> None:
        """Set the commands that keep the joints at their start angles; drop force and contacts."""
        self.commands: Sequence[float] = self.spec.rest_commands()
        self._force: Sequence[float] | None = None
        self.touched.clear()

    def set_start_pose(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        self.start_pose = position_w, quaternion

    def set_command(self, commands: Sequence[float]) -> None:
        self.commands = commands

    def apply_force(self, force_w: Sequence[float]) -> None:
        self._force = force_w if any(force_w) else None

    def take_force(self) -> Sequence[float] | None:
        """The force (3) [N] set by `apply_force` since the last call, None if there is none."""
        force, self._force = self._force, None
        return force

    def contacts(self) -> list[int]:
        return sorted(self.touched)


def take_forces(robots: Sequence[EngineRobot]) -> dict[int, Sequence[float]]:
    """The external forces (3) [N] on robots in the next control step, by index."""
    forces = ((index, robot.take_force()) for index, robot in enumerate(robots))
    return {index: force for index, force in forces if force is not None}
