"""Kinematic bodies: N = M * G agents that follow prescribed motions on the ground or in the air, without
dynamics.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from dune_rl.bodies.motion import MOTION_MODELS, Step, stopping_distance
from dune_rl.bodies.settings import BodySettings
from dune_rl.env.body import Body, SceneBodies
from dune_rl.env.heights import AltitudeController, Stance, turning_rates
from dune_rl.env.proximity import Outline
from dune_rl.env.room import Room
from dune_rl.geometry.arrays import Array, Counts, Flags
from dune_rl.geometry.compiled import compile_function
from dune_rl.geometry.frames import rotation_from_angles
from dune_rl.physics.interface import PhysicsScene
from dune_rl.rendering.moving_mesh import MovingMesh, PosedMesh, RayMesh
from dune_rl.robots.robot import BodyMotion, rectangle_outline
from dune_rl.state.body_description import BodyDescription
from dune_rl.state.sensor_carrier import SensorCarrier
from dune_rl.state.state import Motion
from dune_rl.state.unicycle import Unicycle
from dune_rl.worlds.batched_worlds import BatchedWorlds

Scenes = Counts

# x, y, z [m], yaw, roll, pitch [rad].
POSE_SIZE = 6
# Bodies that brake stop about this far in front of what they cannot pass [m].
_GAP_M = 0.1
# A vehicle that is stuck drives back this share of its turning radius.
_BACKING_SHARE = 0.8
_OUTLINE_SPACING_M = 0.25
# Members of a group begin their strides apart by this share of one.
_STRIDES_APART = 0.37
# Bodies that are not in their scenes are this far outside of the world, this deep and this far apart [m].
_PARKED_AWAY_M, _PARKED_DEEP_M, _PARKED_APART_M = 1e5, 1e3, 20.0


class KinematicBody(Body):
    """N equal bodies that go where they are told, rows scene after scene: a `Body` without physics.

    `poses` (N, 6) are x, y, z [m], yaw, roll and pitch [rad], from a command on those of the end of its
    control step; `motion` is derived from them by `read`. `blocked` (N,) marks bodies that stopped in the
    last step in front of an obstacle, ground that they cannot cross, or the world's edge. `parked` (N,) marks
    bodies that are not in their scenes: they stand still, far outside of the world.
    """

    def __init__(
        self,
        conf: BodySettings,
        worlds: BatchedWorlds,
        count: int,
        step_s: float,
        *,
        first: int = 0,
        first_place: int = 0,
        is_prescribed: bool = False,
    ) -> None:
        """Parked bodies stand in the places from number `first_place` on, which no other group may use.

        Actions are poses (N, 4: x, y, z, yaw) if the motion `is_prescribed`, whatever is in the way.
        """
        self.first, self._first_place, self._is_prescribed = first, first_place, is_prescribed
        self._scenes: dict[int, PhysicsScene] = {}
        self.conf, self.count = conf, count
        self.footprint_radius_m = conf.keep_out_radius_m
        self._worlds, self.step_s = worlds, step_s
        rows = len(worlds) * count
        self.poses = np.zeros((rows, POSE_SIZE))
        self.blocked = np.zeros(rows, bool)
        self._nobody = np.zeros(rows, bool)
        self._nobody.flags.writeable = False
        self.parked = np.zeros(rows, bool)
        self.limits = conf.limits()
        model = MOTION_MODELS.parse_motion(self.limits.model) if conf.motion is None else conf.motion
        self._advance = MOTION_MODELS.bind(model)
        # Bicycles drive back when they are stuck; a user's motion model does not.
        self._backs_off = model.name == "bicycle"
        self._goes_ahead = model.name in ("unicycle", "bicycle")
        self._room = Room(conf, worlds, count)
        self._stance = Stance(conf.supports_b, worlds, count)
        self._flight = None if conf.flight is None else AltitudeController(conf, conf.flight, worlds, count)
        # See `Step`; and how far each body is to drive backwards yet [m].
        self._velocity = np.zeros((rows, 2))
        self._backing_m = np.zeros(rows)
        self._num_frames = conf.num_frames
        # Of each body's look, the number of the first frame.
        self._first_frames = np.tile(np.arange(count) % conf.num_looks * conf.num_frames, len(worlds))
        self._travelled_m = np.zeros(rows)
        self._start_poses = self.poses
        self._rotation: Array | None = rotation_from_angles(np.zeros((rows, 3))) if self._leans else None
        still = np.zeros((rows, 3))
        self.motion = self._moving(still, still, still)
        length, width, height = conf.size_m
        self.outline = _outline(conf)
        self.description = BodyDescription(
            kind=conf.kind,
            radius_m=width / 2,
            half_length_m=length / 2,
            reach_m=self.outline.reach_m,
            height_m=height,
            turning_radius_m=self.limits.turning_radius_m,
            rear_axle_m=self.limits.rear_m,
            max_water_m=conf.max_water_m,
        )
        self.reads_joints = False

    @property
    def _leans(self) -> bool:
        return self._stance.leans

    def action_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds, each (2,), of speed [m/s] and relative heading [rad].

        Only vehicles go backwards. Those of flying bodies, (3,), have a rate of climb [m/s] as well.
        """
        limits = self.limits
        low, high = [-limits.max_reverse_mps, -np.pi], [limits.max_speed_mps, np.pi]
        if self._flight is not None:
            low, high = [*low, -limits.max_climb_mps], [*high, limits.max_climb_mps]
        # No zero has a sign.
        return np.array(low) + 0.0, np.array(high)

    def rest_action(self) -> Array:
        return np.zeros(2 if self._flight is None else 3)

    def vehicle(self) -> Unicycle:
        """The model of the body for behaviours that output a speed and a heading.

        It turns to the commanded heading within the step, as far as its limits let it.
        """
        length, width, _ = self.conf.size_m
        low, high = self.action_bounds()
        top_mps, radius = float(np.float32(high[0])), self.limits.turning_radius_m
        limit = self.limits.max_turn_radps
        fastest = top_mps / radius if radius else np.pi / self.step_s if limit is None else limit
        return Unicycle(
            float(np.float32(low[0])),
            top_mps,
            fastest,
            1.0 / self.step_s,
            length,
            width,
            self.conf.keep_out_radius_m,
            radius,
        )

    def carrier(self) -> SensorCarrier:
        return self.conf.carrier()

    def mesh(self) -> MovingMesh:
        return self.conf.mesh()

    @cached_property
    def _mesh(self) -> MovingMesh:
        return self.mesh()

    def pictures(self, row: int) -> list[PosedMesh]:
        """What pictures show of a body now."""
        motion = self.motion
        shape = self._mesh.frame(motion.frames[row])
        return [PosedMesh(shape, motion.position_w[row].copy(), motion.rotation[row].copy())]

    def looks(self, row: int) -> Sequence[RayMesh]:
        """The meshes of a body in all phases of its motion."""
        first = int(self._first_frames[row])
        return self._mesh.frames[first : first + self._num_frames]

    def shapes(self, names: tuple[str, ...]) -> SceneBodies:
        return SceneBodies(kinematics=tuple(self.conf.collision_shape(name) for name in names))

    # -- a new episode ----------------------------------------------------------------------------

    def bind(self, scene: int, physics: PhysicsScene) -> None:
        self._scenes[scene] = physics

    def place(self, scene: int, poses: Array) -> None:
        """Put the bodies of a scene at `poses` (G, 4 or more), at rest; `read_start` must follow."""
        rows = slice(scene * self.count, (scene + 1) * self.count)
        self.poses = self.poses.copy()
        self._put(rows, scene, self._standing(poses, np.array([scene])))
        self._travelled_m[rows] = self.conf.stride_m * (_STRIDES_APART * np.arange(self.count) % 1.0)

    def turned_to_free_way(self, scene: int, poses: Array) -> Array:
        """The start poses (G, 4: x, y, z [m], yaw [rad]) of a scene, turned so that vehicles can drive on."""
        way_m = self.limits.turning_radius_m
        if way_m == 0.0:
            return poses
        headings = self._room.headings_with_way(scene, poses, way_m)
        return np.column_stack([poses[:, :3], headings])

    def come(self, row: int, pose: Array) -> None:
        """Put a parked body at a `pose` (4), at rest; `read_start` must follow."""
        scene, agent = divmod(row, self.count)
        poses = self.poses[scene * self.count : (scene + 1) * self.count, :4].copy()
        poses[agent] = pose
        standing = self._standing(self.turned_to_free_way(scene, poses), np.array([scene]))
        self.poses = self.poses.copy()
        self._put(slice(row, row + 1), scene, standing[agent : agent + 1])

    def _put(self, rows: slice, scene: int, poses: Array) -> None:
        """Put the bodies in `rows`, all of one scene, at `poses` (K, 6), at rest."""
        self.poses[rows] = poses
        if self._flight is not None:
            self._flight.take_off(self.poses, rows, scene)
        self.parked[rows], self.blocked[rows] = False, False
        self._velocity[rows], self._backing_m[rows] = 0.0, 0.0

    def park(self, rows: Counts) -> None:
        extents, agents = self._worlds.extents[rows // self.count], rows % self.count
        self.poses = self.poses.copy()
        self.poses[rows] = 0.0
        self.poses[rows, 0] = extents[:, 1] + _PARKED_AWAY_M
        self.poses[rows, 1] = extents[:, 3] + _PARKED_AWAY_M + _PARKED_APART_M * (self._first_place + agents)
        self.poses[rows, 2] = -_PARKED_DEEP_M
        self.parked[rows], self.blocked[rows] = True, False
        self._velocity[rows], self._backing_m[rows] = 0.0, 0.0

    def teleport(self, rows: Counts) -> None:
        for row in rows.tolist():
            scene, agent = divmod(row, self.count)
            self._scenes[scene].move_kinematic(self.first + agent, self.poses[row])

    def read_start(self, mask: Flags) -> None:
        """Set the motion in the rows in `mask` (N,) to rest."""
        before = self.motion
        velocity, turning, acceleration = (
            np.where(mask[:, None], 0.0, values)
            for values in (before.velocity_w, before.angular_w, before.acceleration_b)
        )
        if self._leans:
            self._rotation = _rotation_of(self.poses)
        self.motion = self._moving(velocity, turning, acceleration)

    def outline_points(self, scene: int) -> Array:
        """Points (P, 2) [m] that sample the outlines of the bodies of a scene, world frame."""
        poses = self.poses[scene * self.count : (scene + 1) * self.count]
        cos, sin = np.cos(poses[:, 3]), np.sin(poses[:, 3])
        turn = np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=1)
        points: Array = poses[:, None, :2] + np.einsum("nij,pj->npi", turn, self.outline.points_b)
        return points.reshape(-1, 2)

    # -- a step -----------------------------------------------------------------------------------

    def move_to(self, poses: Array) -> None:
        """Move to `poses` (N, 4 or 6) by the end of the control step; those of 4 lean with the ground."""
        self._start_poses = self.poses
        reached = self._standing(poses) if poses.shape[1] < POSE_SIZE else poses
        self.poses = np.where(self.parked[:, None], self.poses, reached) if self.parked.any() else reached

    def command(self, actions: Array, known: BodyMotion) -> None:
        """Move for a control step by `actions` (N, 2): speed [m/s] and relative heading [rad].

        The speed is clipped to the body's, and it turns as far as it can in a step. Flying bodies may have
        a third number, their rate of climb [m/s]; without it they keep their height above the ground. A
        body in front of what it cannot pass stops or, if it can, turns in place; one that a robot has
        pushed into an obstacle may move where it is less deep in it. Vehicles drive back a little when they
        are stuck. It needs no measured motion (`known`). Where the motion is prescribed, `actions` are poses
        (N, 4).
        """
        if self._is_prescribed:
            self.move_to(actions)
            return
        poses = self.poses.copy()
        step, free, stopped = self._next(poses, actions)
        poses[:, :2] = np.where(free[:, None], step.xy, poses[:, :2])
        poses[:, 3] = (
            step.yaw if self.limits.turning_radius_m == 0.0 else np.where(free, step.yaw, poses[:, 3])
        )
        self._velocity = np.where(free[:, None], step.velocity, 0.0)
        if self._flight is None:
            self._stance.put(poses)
        self.move_to(poses)
        self.blocked = ~free | stopped
        if self.parked.any():
            self.blocked &= ~self.parked
            self._velocity = np.where(self.parked[:, None], 0.0, self._velocity)
        if self._backs_off:
            self._back_off(actions, step)

    def _next(self, poses: Array, actions: Array) -> tuple[Step, Flags, Flags]:
        """The step of the bodies, which of them (N,) have room for it, and which stand before an obstacle.

        Sets the heights of flying bodies in `poses` (N, 6).
        """
        limits, step_s = self.limits, self.step_s
        if self._backs_off:
            actions = self._with_backing(actions)
        step = self._advance(limits, poses, self._velocity, actions, step_s)
        stopped = self._nobody
        if limits.braking_mps2 is not None:
            way = self._way_ahead(step)
            clear = self._room.is_free(step.xy + way, step.yaw, poses, self.parked)
            if self._flight is not None:
                clear &= self._flight.can_pass(poses, step.xy + way)
            if not clear.all():
                braking = np.where(clear[:, None], actions, _braked(actions))
                step = self._advance(limits, poses, self._velocity, braking, step_s)
                stopped = ~clear & (np.abs(step.velocity).max(axis=1) < 1e-6)
        free = self._room.is_free(step.xy, step.yaw, poses, self.parked)
        if self._flight is not None:
            free &= self._flight.climb(poses, step.xy, actions, free, step_s)
        return step, free, stopped

    def _way_ahead(self, step: Step) -> Array:
        """From the end of a step to where bodies come to rest, (N, 2) [m], and the gap that they keep."""
        speed = np.hypot(step.velocity[:, 0], step.velocity[:, 1])
        reach = stopping_distance(self.limits, speed, self.step_s) + _GAP_M
        if self._goes_ahead:
            signed = np.where(step.velocity[:, 0] < 0.0, -reach, reach)
            return signed[:, None] * np.stack([np.cos(step.yaw), np.sin(step.yaw)], axis=-1)
        way: Array = step.velocity * (reach / np.maximum(speed, 1e-9))[:, None]
        return way

    def _with_backing(self, actions: Array) -> Array:
        """The actions, with full speed backwards for bodies that drive back to get free."""
        backing = (self._backing_m > 0.0) & (actions[:, 0] > 0.0)
        if not backing.any():
            return actions
        found = actions.copy()
        found[backing, 0] = -self.limits.max_reverse_mps
        return found

    def _back_off(self, actions: Array, step: Step) -> None:
        """Start to drive backwards where a vehicle cannot go on, and stop it where that is done."""
        backing = self._backing_m > 0.0
        left = np.maximum(self._backing_m - np.abs(step.velocity[:, 0]) * self.step_s, 0.0)
        wants = actions[:, 0] > 0.0
        starts = self.blocked & wants & ~backing
        self._backing_m = np.where(backing & wants & ~self.blocked, left, 0.0)
        self._backing_m[starts] = _BACKING_SHARE * self.limits.turning_radius_m

    def hold_back(self, scenes: Scenes, poses: Array) -> None:
        """Set x and y of the bodies of `scenes` (S,) to those of `poses` (S, G, ...), after robots blocked
        bodies.
        """
        reached = self.poses.copy()
        by_scene = reached.reshape(-1, self.count, POSE_SIZE)
        moved = (by_scene[scenes, :, :2] != poses[..., :2]).any(axis=2)
        by_scene[scenes, :, :2] = poses[..., :2]
        if self._flight is None:
            standing = by_scene[scenes]
            self._stance.put(standing.reshape(-1, POSE_SIZE), scenes)
            by_scene[scenes] = np.where(moved[..., None], standing, by_scene[scenes])
        held = np.zeros(by_scene.shape[:2], bool)
        held[scenes] = moved
        self._velocity = np.where(held.reshape(-1, 1), 0.0, self._velocity)
        self.poses = reached

    def read(self) -> list[tuple[int, int]]:
        """Derive the motion at the end of a control step: its mean velocities, and their change.

        Returns no contacts: these bodies have those that robots have with them.
        """
        found = np.zeros((3, len(self.poses), 3))
        _derive_motion(self.poses, self._start_poses, self.motion.velocity_w, self.step_s, found)
        velocity_w, angular_w, acceleration_b = found
        if self._leans:
            before, self._rotation = self.motion.rotation, _rotation_of(self.poses)
            turning_rates(self._rotation, before, self.step_s, angular_w)
            change = (velocity_w - self.motion.velocity_w) / self.step_s
            acceleration_b = np.einsum("nji,nj->ni", self._rotation, change)
        if self._num_frames > 1:
            self._travelled_m = self._travelled_m + self._way_of_parts(velocity_w)
        self.motion = self._moving(velocity_w, angular_w, acceleration_b)
        return []

    def _way_of_parts(self, velocity_w: Array) -> Array:
        """Way [m], (N,), by which legs moved on; propellers turn in the air, too, by a frame a step."""
        if self._flight is not None:
            return np.full(len(velocity_w), self.conf.stride_m / self._num_frames)
        way: Array = np.hypot(velocity_w[:, 0], velocity_w[:, 1]) * self.step_s
        return way

    def _standing(self, poses: Array, scenes: Scenes | None = None) -> Array:
        """`poses` (N, 4 or more) as poses (N, 6) that lean with the ground, as far above it as they were."""
        full = np.zeros((len(poses), POSE_SIZE))
        full[:, :4] = poses[:, :4]
        if self._leans:
            places = full[:, :2].reshape(-1, self.count, 2)
            above = poses[:, 2] - self._worlds.height(places, scenes).reshape(-1)
            self._stance.put(full, scenes)
            full[:, 2] += above
        return full

    def _moving(self, velocity_w: Array, angular_w: Array, acceleration_b: Array) -> Motion:
        attitude = np.zeros((len(self.poses), 3))
        attitude[:, 2] = self.poses[:, 3]
        place = self.poses[:, :3]
        derived: dict[str, Any] = {"acceleration_b": acceleration_b}
        if self._num_frames > 1:
            phase = self._travelled_m / self.conf.stride_m
            derived["frames"] = np.floor(self._num_frames * phase) % self._num_frames + self._first_frames
        if self._rotation is not None:
            attitude[:, :2] = self.poses[:, 4:]
            derived["rotation"] = self._rotation
        return Motion(place, attitude, velocity_w, angular_w, self._nobody, **derived)


def _outline(conf: BodySettings) -> Outline:
    length, width, _ = conf.size_m
    if conf.is_round:
        return Outline.disc(length / 2)
    return Outline(rectangle_outline(length, width, _OUTLINE_SPACING_M), np.array([length, width]) / 2)


def _rotation_of(poses: Array) -> Array:
    """Rotations (N, 3, 3) from body to world at `poses` (N, 6)."""
    return rotation_from_angles(poses[:, [4, 5, 3]])


def _braked(actions: Array) -> Array:
    """The actions (N, A) with a speed of 0."""
    found = actions.copy()
    found[:, 0] = 0.0
    return found


@compile_function
def _derive_motion(poses: Any, before: Any, velocity_before: Any, step_s: float, found: Any) -> None:
    """Velocities (N, 3), turning rates (N, 3) and, in the body frame, accelerations (N, 3), into `found`.

    Bodies went upright from `before` (N, 6) to `poses` (N, 6), and had the mean velocities `velocity_before`
    (N, 3).
    """
    velocity, turning, acceleration = found[0], found[1], found[2]
    for row in range(len(poses)):
        for axis in range(3):
            velocity[row, axis] = (poses[row, axis] - before[row, axis]) / step_s
        turn = (poses[row, 3] - before[row, 3] + np.pi) % (2 * np.pi) - np.pi
        turning[row, 2] = turn / step_s
        x = (velocity[row, 0] - velocity_before[row, 0]) / step_s
        y = (velocity[row, 1] - velocity_before[row, 1]) / step_s
        cos, sin = np.cos(poses[row, 3]), np.sin(poses[row, 3])
        acceleration[row, 0] = cos * x + sin * y
        acceleration[row, 1] = cos * y - sin * x
        acceleration[row, 2] = (velocity[row, 2] - velocity_before[row, 2]) / step_s
