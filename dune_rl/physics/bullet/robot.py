"""A robot in a PyBullet scene."""

import math
from collections.abc import Mapping, Sequence

from dune_rl.physics.bullet.base import BaseLink
from dune_rl.physics.bullet.body import LoadedBody
from dune_rl.physics.bullet.loading import BodyLoader
from dune_rl.physics.bullet.motors import BulletMotors
from dune_rl.physics.bullet.reach import measure_reach_m
from dune_rl.physics.bullet.touch import TouchedBodies
from dune_rl.physics.bullet.wheels import WheelContacts
from dune_rl.physics.robot_body import RobotBody
from dune_rl.physics.varied_body import BodyVariation


class BulletRobot:
    """A `PhysicsRobot` in the PyBullet `client`.

    `body_numbers` maps PyBullet's handles of the bodies that are not ground to
    body numbers; the scene updates it. `hull_mask` has the collision groups
    that the hull collides with.

    `base`, `motors` and `touched` are for the scene, which calls them in every
    physics step; they stay the same objects over `load` and `reload`.
    """

    def __init__(
        self,
        client: int,
        spec: RobotBody,
        timestep_s: float,
        body_numbers: Mapping[int, int],
        hull_mask: int,
        *,
        measures_work: bool,
    ) -> None:
        self._spec = spec
        self._body = LoadedBody(client, spec)
        self._loader = BodyLoader(self._body, spec, hull_mask)
        self._wheels = WheelContacts(self._body)
        self.base = BaseLink(self._body)
        self.motors = BulletMotors(self._body, spec, timestep_s, measures_work=measures_work)
        self.touched = TouchedBodies(self._body, body_numbers)
        # See `GatedRobot`; the position is that of the base's centre of mass. Infinite until it is measured.
        self.reach_m = math.inf
        self.base_mass_kg = 0.0

    def set_body(self, variation: BodyVariation) -> None:
        self.motors.set_strength(variation.motor_strength)
        self._loader.set_variation(variation)
        # The centre of mass, which the reach is about, may move.
        self.reach_m = math.inf

    def set_start_pose(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        self._loader.set_start_pose(position_w, quaternion)

    def load(self) -> int:
        """Load the robot at its start pose, without tyres, and return PyBullet's handle."""
        handle = self._loader.load()
        self.base_mass_kg = self.base.measure_mass_kg()
        self.base.reset()
        self.motors.reset()
        self.touched.clear()
        self._wheels.reset()
        if self.reach_m == math.inf:
            self.reach_m = measure_reach_m(self._body, self._spec)
        return handle

    def reload(self, tyres: frozenset[int]) -> int:
        """Replace the robot by one with other tyres, in the same state, and return its handle."""
        handle = self._loader.reload(tyres)
        self.base_mass_kg = self.base.measure_mass_kg()
        self._wheels.apply_again()
        return handle

    def remove(self) -> None:
        """Remove the robot from the scene."""
        self._body.remove()

    def release(self) -> None:
        """Drop the handle after the client was disconnected."""
        self._body.release()

    def begin_step(self, count: int) -> None:
        """Forget what was touched, and pass the commands to the motors for `count` physics steps."""
        self.touched.clear()
        self.motors.begin_step(count)

    def end_step(self) -> None:
        """Read the state after a control step at once, while the processor still has it in its cache."""
        self.mark_moved()
        self.base.read()
        self.motors.read_speeds()

    def mark_moved(self) -> None:
        """Drop what was read before a physics step."""
        self.base.mark_moved()
        self.motors.mark_moved()

    def set_command(self, commands: Sequence[float]) -> None:
        self.motors.commands = commands

    def apply_force(self, force_w: Sequence[float]) -> None:
        self.base.set_force(force_w)

    def set_wheel_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        self._wheels.set(friction, restitution, stiffness, damping)

    def planar_motion(self) -> tuple[float, float, float]:
        """See `GatedRobot`."""
        return self.base.planar_motion()

    def body_state(self) -> tuple[float, ...]:
        return self.base.link_state()

    def drive_state(self) -> tuple[float, ...]:
        return self.motors.joint_states()

    def work_j(self) -> float:
        return self.motors.take_work_j()

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        return self._body.joint_angles(joints)

    def contacts(self) -> list[int]:
        return self.touched.in_order()
