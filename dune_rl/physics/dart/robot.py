"""A robot in a DART scene."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from dune_rl.physics.dart.differential import Differential, is_chained
from dune_rl.physics.dart.drives import Drives
from dune_rl.physics.dart.floating_base import FloatingBase
from dune_rl.physics.dart.foot_contacts import FootContacts
from dune_rl.physics.dart.gears import Gears, has_driven_coupling
from dune_rl.physics.dart.template import has_only_spheres, load_template, measure_reach_m, split_by_role
from dune_rl.physics.dart.tyre_bodies import TyreBodies
from dune_rl.physics.dart.work_meter import WorkMeter
from dune_rl.physics.robot_body import RobotBody
from dune_rl.physics.varied_body import BodyVariation, scale_motors, varied_urdf


class DartRobot:
    """A `PhysicsRobot` without its contacts: a skeleton that `load` creates anew.

    So are the objects that act on it: `base`, `tyres`, motors, couplings and the contacts of its feet.

    `terrain_friction` is the ground's coefficient, which holds until `set_foot_contacts` is called.
    `has_spherical_feet` is whether all collision shapes of ground links are spheres, `has_spherical_hull`
    whether all others are. For `reach_m` see `GatedRobot`.
    """

    skeleton: Any
    base: FloatingBase
    tyres: TyreBodies

    def __init__(
        self, spec: RobotBody, timestep_s: float, *, measures_work: bool, terrain_friction: float = 1.0
    ) -> None:
        self.spec, self._timestep_s = spec, timestep_s
        self._foot_friction = spec.ground_friction * terrain_friction
        self._measures_work = measures_work and bool(spec.motors)
        # Ideal motors take a command once a control step; others need the joint states in every physics step.
        self._has_ideal_motors = all(motor.is_ideal for motor in spec.motors) and not has_driven_coupling(
            spec
        )
        self._motors = spec.motors
        self._template = load_template(spec)
        feet, hull = split_by_role(self._template, spec)
        self.has_spherical_feet, self.has_spherical_hull = has_only_spheres(feet), has_only_spheres(hull)
        self.reach_m = measure_reach_m(self._template, spec.tyres)
        self._pose: tuple[Sequence[float], Sequence[float]] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        self._commands: Sequence[float] = spec.rest_commands()
        self._force: Sequence[float] | None = None
        self._work: WorkMeter | None = None
        self.skeleton = None

    def set_body(self, variation: BodyVariation) -> None:
        self._motors = scale_motors(self.spec.motors, variation.motor_strength)
        text = None if variation.keeps_masses else varied_urdf(self.spec.urdf, variation)
        self._template = load_template(replace(self.spec, motors=self._motors), text)

    def set_start_pose(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        self._pose = (position_w, quaternion)

    def load(self) -> Any:
        """Create the skeleton at the start pose, at rest and without tyres, and return it."""
        spec, step_s = self.spec, self._timestep_s
        self.skeleton = robot = self._template.clone()
        self.base = FloatingBase(robot)
        self.base.place(*self._pose)
        self.tyres = TyreBodies(robot, spec.tyres)
        chained = [coupling for coupling in spec.couplings if is_chained(robot, coupling)]
        geared = [coupling for coupling in spec.couplings if coupling not in chained]
        self._differentials = [Differential(robot, coupling, step_s) for coupling in chained]
        self._feet = FootContacts(robot, spec, self._foot_friction, step_s)
        self._gears = Gears(robot, geared, spec.drive_joints, step_s) if geared else None
        self._drives = Drives(robot, self._motors, self._gears, step_s, hold_commands=self._has_ideal_motors)
        self._work = WorkMeter(robot, self._drives, step_s) if self._measures_work else None
        self._impulse_users = self._find_impulse_users()
        self._commands, self._force = spec.rest_commands(), None
        return robot

    def _find_impulse_users(self) -> list[Callable[[Sequence[float]], None]]:
        """What takes the constraint impulses of all joints after each physics step."""
        users: list[Callable[[Sequence[float]], None]] = [
            differential.after for differential in self._differentials
        ]
        if self._feet.slip is not None:
            users.append(self._feet.slip.after)
        if self._drives.compensates_load:
            users.append(self._drives.note_impulses)
        return users

    def release(self) -> None:
        """Drop the skeleton; the objects that act on it go with the next `load`."""
        self.skeleton = None

    def set_command(self, commands: Sequence[float]) -> None:
        self._commands = commands

    def begin_step(self, count: int) -> None:
        """Pass the commands to the motors for the next `count` physics steps."""
        self._drives.begin_step(self._commands, count)

    def before_physics_steps(self) -> list[Callable[[], None]]:
        """What is to be called, in this order, before each physics step of the next control step."""
        calls: list[Callable[[], None]] = []
        if self._feet.ground is not None:
            calls.append(self._feet.ground.command_servos)
        if not self._drives.hold_commands:
            calls.append(self._drives.command_servos)
        return calls

    def after_physics_steps(self) -> list[Callable[[], None]]:
        """What is to be called, in this order, after each physics step of the next control step."""
        calls: list[Callable[[], None]] = []
        if self._gears is not None:
            calls.append(self._gears.after)
        if self._impulse_users:
            calls.append(self._pass_impulses)
        if self._work is not None:
            calls.append(self._work.add)
        return calls

    def _pass_impulses(self) -> None:
        impulses = self.skeleton.getJointConstraintImpulses().tolist()
        for use in self._impulse_users:
            use(impulses)

    def apply_force(self, force_w: Sequence[float]) -> None:
        self._force = force_w if any(force_w) else None

    def take_force(self) -> Sequence[float] | None:
        """The force set by `apply_force` since the last call, which is removed; None if there is none."""
        force, self._force = self._force, None
        return force

    def set_foot_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None,
        damping: Sequence[float] | None,
    ) -> None:
        """Set the contact parameters of each ground link; see `FootContacts.set`."""
        self._feet.set(friction, restitution, stiffness, damping)

    @property
    def base_mass_kg(self) -> float:
        """Mass of the base link."""
        return self.base.mass_kg

    def planar_motion(self) -> tuple[float, float, float]:
        """See `GatedRobot`; the position is that of the base link's origin."""
        return self.base.planar_motion()

    def body_state(self) -> tuple[float, ...]:
        return self.base.state()

    def drive_state(self) -> tuple[float, ...]:
        return self._drives.state()

    def work_j(self) -> float:
        return 0.0 if self._work is None else self._work.take_j()

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        robot = self.skeleton
        if robot is None:
            return (0.0,) * len(joints)
        positions = robot.getPositions().tolist()
        # The second arm of a differential is a child of the first.
        for differential in self._differentials:
            positions[differential.between] += positions[differential.body]
        return tuple(positions[robot.getJoint(joint).getIndexInSkeleton(0)] for joint in joints)
