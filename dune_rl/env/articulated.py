"""Robots in physics: N = M * G of one kind, from actions to motor commands and from the engine to motion."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from dune_rl.env.body import Body, SceneBodies
from dune_rl.env.latency import Latency
from dune_rl.env.proximity import Outline
from dune_rl.env.randomised_properties import EpisodeVariation
from dune_rl.env.scene_spec import standing_pose
from dune_rl.env.traction import Traction, drag_forces
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import derive_motion
from dune_rl.physics.interface import PhysicsConf, PhysicsRobot, PhysicsScene
from dune_rl.rendering.moving_mesh import MovingMesh, PosedMesh
from dune_rl.robots.robot import BodyMotion, Robot
from dune_rl.robots.visual import RobotVisual, robot_mesh
from dune_rl.sensors.wheels import DriveGeometry
from dune_rl.state.body_description import BodyDescription
from dune_rl.state.sensor_carrier import SensorCarrier, WheelMotion
from dune_rl.state.state import EnergyState, JointState, Motion
from dune_rl.state.unicycle import Unicycle
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.world import World

# Limits of position, quaternion, velocity and angular velocity [SI] beyond which physics has diverged: robots
# are slower, worlds are smaller, and components of unit quaternions are at most 1.
_STATE_LIMITS = np.repeat([1e5, 1.01, 50.0, 200.0], [3, 4, 3, 3])


def vehicle_of(robot: Robot) -> Unicycle:
    """The model of a robot for behaviours that output a speed and a heading."""
    described = robot.description
    actions = described.actions
    steering = None if described.wheels is None else described.wheels.steering
    return Unicycle(
        float(np.float32(actions.low[0])),
        float(np.float32(actions.high[0])),
        described.max_yaw_rate_radps,
        described.heading_gain_per_s,
        described.length_m,
        described.width_m,
        described.footprint_radius_m,
        0.0 if steering is None else 1.0 / min(steering.max_curvatures()),
    )


def carrier_of(robot: Robot) -> SensorCarrier:
    """A robot as a carrier of sensors."""
    described = robot.description
    mounts, wheels = described.mounts, described.wheels
    drive: WheelMotion | None = None
    num_joints = len(robot.body.drive_joints)
    if wheels is not None:
        geometry = DriveGeometry(wheels.radius_m, wheels.track_m, wheels.left, wheels.right)
        drive, num_joints = wheels.steering or geometry, wheels.num_driven
    return SensorCarrier(
        scanner_b=mounts.scanner_b,
        camera_b=mounts.camera_b,
        imu_b=mounts.imu_b,
        camera_pitch_deg=mounts.camera_pitch_deg,
        standing_height_m=described.standing_height_m,
        max_speed_mps=described.max_speed_mps,
        num_joints=num_joints,
        drive=drive,
    )


class ArticulatedBody(Body):
    """The bodies of N robots of one kind, rows scene after scene: a `Body` that physics simulates.

    `latency` delays the commands, if it is not None. `engines` are the robots in physics, one per row.
    """

    def __init__(
        self,
        robot: Robot,
        physics: PhysicsConf,
        worlds: BatchedWorlds,
        count: int,
        *,
        first: int = 0,
        has_latency: bool = False,
        measures_work: bool = False,
    ) -> None:
        self.robot, self.first = robot, first
        self.footprint_radius_m = robot.description.footprint_radius_m
        rows = len(worlds) * count
        self.count = count
        self.traction = Traction(robot, physics, rows)
        self.latency = Latency(rows, robot.body.rest_commands(), physics.control_hz) if has_latency else None
        self.engines: list[PhysicsRobot] = []
        # Start poses by scene, until they are read: positions (G, 3) and quaternions (G, 4).
        self._placed: dict[int, list[tuple[Array, Array]]] = {}
        self.reads_joints = False
        self._measures_work = measures_work
        self._worlds = worlds
        self._states = np.zeros((rows, 13))
        self._states[:, 6] = 1.0
        self._drives: Array | None = None
        self._step_s = physics.control_step_s
        self.motion = self._derive(np.zeros(rows, bool), np.zeros((rows, 3)))
        self.work_j: Array | None = np.zeros(rows) if measures_work else None
        size = robot.description
        self.outline = Outline(size.outline(), size.half_size_m)
        # Robots turn by their own controllers, whatever heading they are told.
        self.description = BodyDescription(
            kind="robot",
            is_robot=True,
            radius_m=size.width_m / 2,
            half_length_m=size.length_m / 2,
            reach_m=self.outline.reach_m,
            height_m=size.height_m,
            wheel_radius_m=None if size.wheels is None else size.wheels.radius_m,
        )

    def action_bounds(self) -> tuple[Array, Array]:
        actions = self.robot.description.actions
        return actions.low, actions.high

    def rest_action(self) -> Array:
        return self.robot.description.actions.rest

    def vehicle(self) -> Unicycle:
        return vehicle_of(self.robot)

    def carrier(self) -> SensorCarrier:
        return carrier_of(self.robot)

    def mesh(self) -> MovingMesh:
        return robot_mesh(self.robot.body)

    @cached_property
    def _visual(self) -> RobotVisual:
        return RobotVisual(self.robot.body.look or self.robot.body.urdf)

    def pictures(self, row: int) -> list[PosedMesh]:
        """What pictures show of a robot now, its joints as they are."""
        motion = self.motion
        return self._visual.posed_meshes(motion.position_w[row], motion.rotation[row], self.joint_angles(row))

    def joint_angles(self, row: int) -> dict[str, float]:
        """Angles [rad] of the motors' and the passive joints of a robot, by name."""
        body = self.robot.body
        names = [*body.drive_joints, *(joint.joint for joint in body.passive)]
        return dict(zip(names, self.engines[row].joint_angles(names), strict=True))

    def shapes(self, names: tuple[str, ...]) -> SceneBodies:
        """A robot in physics for each of the agents' `names`."""
        return SceneBodies(robots=(self.robot.body,) * len(names))

    def outline_points(self, scene: int) -> Array:
        """The middles (G, 2) [m] of the robots of a scene."""
        if scene in self._placed:
            return np.array([position[:2] for position, _ in self._placed[scene]])
        return self.motion.position_w[scene * self.count : (scene + 1) * self.count, :2]

    @property
    def energy(self) -> EnergyState | None:
        return None if self.work_j is None else EnergyState(self.work_j, self.robot.description.battery)

    # -- a new episode ----------------------------------------------------------------------------

    def reset(self, mask: Flags) -> None:
        """Reset the controllers of the robots in `mask` (N,)."""
        self.robot.reset(mask)

    def bind(self, scene: int, physics: PhysicsScene) -> None:
        robots = list(physics.robots[self.first : self.first + self.count])
        self.engines[scene * self.count : (scene + 1) * self.count] = robots

    def place(self, scene: int, poses: Array) -> None:
        """Set the start poses of a scene's robots to `poses` (G, 4: x, y, z, yaw), standing on the ground."""
        world, first = self._worlds.worlds[scene], scene * self.count
        size = self.robot.description
        placed = [standing_pose(world, size, x, y, yaw) for x, y, _, yaw in poses.tolist()]
        for engine, (position, quaternion) in zip(
            self.engines[first : first + self.count], placed, strict=True
        ):
            engine.set_start_pose(position.tolist(), quaternion.tolist())
        self._placed[scene] = placed

    def touch_ground(self, scene: int, world: World, variation: EpisodeVariation) -> None:
        """Set wheel contacts and latency of a scene's robots by the episode's `variation`."""
        for agent, pose in enumerate(self._placed[scene]):
            row = scene * self.count + agent
            self.traction.set_factors(row, variation.contacts)
            if self.latency is not None:
                self.latency.set_delay(row, variation.latency_s or 0.0)
                self.latency.reset(row)
            self.traction.begin(row, world, self.engines[row], *pose)

    def read_start(self, mask: Flags) -> None:
        """Read the states of the robots in `mask` (N,) after they have settled."""
        self._placed.clear()
        engines = self.engines
        reads_joints = self._reads_joints
        # States that were handed out keep theirs.
        states = self._states.copy()
        drives = None if self._drives is None else self._drives.copy()
        for row in np.flatnonzero(mask).tolist():
            if self._measures_work:
                engines[row].work_j()
            states[row] = engines[row].body_state()
            if reads_joints:
                drive = engines[row].drive_state()
                if drives is None:
                    drives = np.zeros((len(states), len(drive)))
                drives[row] = drive
        self._states, self._drives = states, drives
        if self.work_j is not None:
            self.work_j = np.where(mask, 0.0, self.work_j)
        before = self.motion
        acceleration_b = np.where(mask[:, None], 0.0, before.acceleration_b)
        self.motion = self._derive(before.diverged & ~mask, acceleration_b)

    # -- a step -----------------------------------------------------------------------------------

    def command(self, actions: Array, known: BodyMotion) -> None:
        """Command the motors for `actions` (N, A), and apply the resistance of grass and soft ground.

        `known` is the motion that the robots' controllers measure; with realism it differs from the truth.
        """
        commands = self.robot.commands(actions, known, self._step_s)
        if self.latency is not None:
            commands = self.latency.delayed(commands)
        for engine, command in zip(self.engines, commands.tolist(), strict=True):
            engine.set_command(command)
        force = self._resistance(self.engines)
        if force is not None:
            for engine, force_w in zip(self.engines, force.tolist(), strict=True):
                engine.apply_force(force_w)

    def _resistance(self, engines: Sequence[PhysicsRobot]) -> Array | None:
        """Resistance [N] of grass and soft ground, (N, 3), world frame; None if there are neither."""
        rolling = self.traction.update(engines, self.motion)
        grass = drag_forces(self._worlds, self.motion, self.robot.description, self.count)
        if rolling is None or grass is None:
            return grass if rolling is None else rolling
        return rolling + grass

    def read(self) -> list[tuple[int, int]]:
        reads_joints = self._reads_joints
        states, drives, contacts = [], [], []
        engines = self.engines
        for row, engine in enumerate(engines):
            states.append(engine.body_state())
            if reads_joints:
                drives.append(engine.drive_state())
            bodies = engine.contacts()
            if bodies:
                contacts += [(row, body) for body in bodies]
        before = self._states[:, 7:10]
        diverged = self._store_valid(np.array(states), np.array(drives) if reads_joints else None)
        acceleration_w = (self._states[:, 7:10] - before) / self._step_s
        self.motion = self._derive(diverged, None, acceleration_w)
        if self._measures_work:
            work = np.array([engine.work_j() for engine in engines])
            # Work of diverged physics is meaningless.
            work[diverged] = 0.0
            self.work_j = work
        return contacts

    @property
    def _reads_joints(self) -> bool:
        return self.reads_joints or self.traction.needs_wheels

    def _store_valid(self, states: Array, drives: Array | None) -> Flags:
        """Store valid rows of `states` (N, 13) and `drives` (N, 3 J); returns flags (N,) of diverged rows."""
        # Written so that NaN, which compares false, counts as invalid.
        valid: Flags = np.logical_and.reduce(np.abs(states) < _STATE_LIMITS, axis=1)
        self._states = states if valid.all() else np.where(valid[:, None], states, self._states)
        if drives is not None:
            finite = valid & np.isfinite(drives).all(axis=1)
            before = np.zeros_like(drives) if self._drives is None else self._drives
            self._drives = drives if finite.all() else np.where(finite[:, None], drives, before)
        return ~valid

    def _derive(
        self, diverged: Flags, acceleration_b: Array | None, acceleration_w: Array | None = None
    ) -> Motion:
        states, rows = self._states, len(self._states)
        rotation, angles, vectors_b = np.empty((rows, 3, 3)), np.empty((rows, 3)), np.empty((3, rows, 3))
        if acceleration_w is None:
            acceleration_w = np.zeros((rows, 3))
        derive_motion(states, acceleration_w, rotation, angles, vectors_b)
        velocity_b, angular_b, found_acceleration_b = vectors_b
        if acceleration_b is None:
            acceleration_b = found_acceleration_b
        joints = None
        if self._drives is not None:
            joints = JointState(*np.split(self._drives, 3, axis=1))
        return Motion(
            states[:, 0:3],
            angles,
            states[:, 7:10],
            states[:, 10:13],
            diverged,
            joints,
            rotation=rotation,
            velocity_b=velocity_b,
            angular_b=angular_b,
            acceleration_b=acceleration_b,
        )

    @property
    def poses(self) -> Array:  # type: ignore[override]
        """Poses (N, 4: x, y, z, yaw) [m, rad] of the origins."""
        return np.column_stack([self.motion.position_w, self.motion.yaw])
