"""Contacts of wheels with the ground: friction, restitution, compliance and rolling resistance, by
surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.constants import GRAVITY_MPS2
from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.geometry.shared_per_scene import Rows, agent_rows
from dune_rl.physics.interface import PhysicsConf, PhysicsRobot
from dune_rl.robots.robot import Robot, RobotDescription
from dune_rl.state.state import Motion
from dune_rl.worlds.batched_worlds import BatchedWorlds
from dune_rl.worlds.grass import Grass
from dune_rl.worlds.surfaces import Surface, SurfaceMap, WheelLoad, contact_table
from dune_rl.worlds.world import World

# A wheel higher than this over what is below it bears no load.
_OFF_GROUND_M = 0.05
_NOWHERE = 255


@dataclass(frozen=True)
class ContactFactors:
    """Factors on all contacts of a robot's wheels.

    `friction` and `tyres` both multiply the friction, and `stiffness` that of the ground's surfaces. `load`
    multiplies the load on the wheels, and with it their rolling resistance; how far they sink stays that of
    the robot as described.
    """

    friction: float = 1.0
    tyres: float = 1.0
    stiffness: float = 1.0
    load: float = 1.0


UNCHANGED_CONTACTS = ContactFactors()


class Traction:
    """Contacts of the wheels of N robots with the ground, which follow the surfaces where a world has a map.

    Feet are wheels that do not roll, at the places where they are when the robot stands.

    `friction_factor`, `tyre_factor`, `stiffness_factor` and `load_factor` (N,) are the `ContactFactors` of
    the robots; set them before a robot's `begin`. In worlds without a map contacts are rigid, and only
    the factors of friction act.
    """

    def __init__(self, robot: Robot, physics: PhysicsConf, num_rows: int) -> None:
        self._robot, self._friction = robot.description, robot.body.ground_friction
        self._wheels_b = self._robot.contact_centres_b
        layout = self._robot.wheels
        self._rolls = layout is not None
        self._driven = 0 if layout is None else layout.num_driven
        wheels = len(self._wheels_b)
        self._share_n = self._robot.mass_kg * GRAVITY_MPS2 / wheels
        self._slowest = GRAVITY_MPS2 * physics.control_step_s
        self.friction_factor = np.ones(num_rows)
        self.tyre_factor = np.ones(num_rows)
        self.stiffness_factor = np.ones(num_rows)
        self.load_factor = np.ones(num_rows)
        self._worlds: list[World | None] = [None] * num_rows
        self._groups: list[tuple[World, NDArray[np.intp], Array]] | None = None
        self.surfaces = np.full((num_rows, wheels), _NOWHERE, np.uint8)

    def set_factors(self, row: int, factors: ContactFactors) -> None:
        """Set the factors of the robot `row` from its next `begin` on."""
        self.friction_factor[row], self.tyre_factor[row] = factors.friction, factors.tyres
        self.stiffness_factor[row], self.load_factor[row] = factors.stiffness, factors.load

    def begin(
        self, scene: int, world: World, engine: PhysicsRobot, position_w: Array, quaternion: Array
    ) -> None:
        """Set the contacts of a robot that was just placed in `world` at this pose; `scene` is its row."""
        if self._worlds[scene] is not world:
            self._worlds[scene], self._groups = world, None
        self.surfaces[scene] = _NOWHERE
        if world.surfaces is None:
            ground, tyres = float(self.friction_factor[scene]), float(self.tyre_factor[scene])
            friction = self._friction * (ground * tyres)
            if world.takes_smaller_friction:
                friction = min(self._friction * tyres, world.friction * ground)
            if friction != self._friction:
                wheels = len(self._wheels_b)
                engine.set_wheel_contacts([friction] * wheels, [0.0] * wheels)
            return
        rotation = rotation_matrices(quaternion)
        self.surfaces[scene], _ = world.surface_below(self._bottoms(position_w, rotation))
        self._set(scene, world, engine)

    @property
    def needs_wheels(self) -> bool:
        """Whether `update` needs the wheels' speeds."""
        return bool(self._mapped()) and self._rolls

    def update(self, engines: Sequence[PhysicsRobot], motion: Motion) -> Array | None:
        """Update the contacts by where the robots are; gives the rolling resistance (N, 3) [N], world frame.

        None where no world has a map, or nothing rolls. The force acts over one control step.
        """
        groups = self._mapped()
        if not groups:
            return None
        speeds = _wheel_speeds(motion, self._driven) if self.needs_wheels else None
        force = np.zeros((len(engines), 3))
        for world, scenes, rolling in groups:
            rotation = motion.rotation[scenes]
            bottoms = self._bottoms(motion.position_w[scenes], rotation)
            numbers, height = world.surface_below(bottoms)
            changed = (numbers != self.surfaces[scenes]).any(axis=1)
            self.surfaces[scenes] = numbers
            for scene in scenes[changed].tolist():
                self._set(scene, world, engines[scene])
            if speeds is None:
                continue
            coefficients = rolling[numbers] * (bottoms[..., 2] - height < _OFF_GROUND_M)
            yaw_rates = motion.angular_b[scenes, 2, None]
            ahead = motion.velocity_b[scenes, 0, None] - yaw_rates * self._wheels_b[:, 1]
            rims = speeds[scenes] * self._robot.contact_radius_m
            if rims.shape[1] < ahead.shape[1]:
                # Wheels without a motor roll as fast as they go.
                rims = np.concatenate([rims, ahead[:, rims.shape[1] :]], axis=1)
            held = self._held(coefficients, ahead, rims)
            load = self._share_n * self.load_factor[scenes] * np.maximum(rotation[:, 2, 2], 0.0)
            force[scenes] = (load * held)[:, None] * rotation[:, :, 0]
        return None if speeds is None else force

    def _held(self, coefficients: Array, ahead: Array, rims: Array) -> Array:
        """Resistance along each robot's x axis over a wheel's load, (N,), of wheels with `coefficients` (N,
        W).

        `ahead` (N, W) is how fast the wheels go [m/s] and `rims` how fast they
        turn; the lesser is how fast they roll: a locked wheel and one that
        spins on the spot do not. Below the speed that resistance takes away
        within a control step it goes with the speed, so that it stops a robot
        and never reverses it.
        """
        rolls = np.where(ahead * rims > 0.0, np.minimum(np.abs(ahead), np.abs(rims)), 0.0)
        held: Array = np.minimum(rolls / self._slowest, coefficients) * np.sign(ahead)
        return -held.sum(axis=1)

    def _bottoms(self, position_w: Array, rotation: Array) -> Array:
        """Lowest points (..., W, 3) [m] of the wheels."""
        centres = position_w[..., None, :] + self._wheels_b @ np.swapaxes(rotation, -1, -2)
        centres[..., 2] -= self._robot.contact_radius_m
        return centres

    def _set(self, scene: int, world: World, engine: PhysicsRobot) -> None:
        assert world.surfaces is not None
        contacts, _ = self._table(world.surfaces)
        rows = contacts[self.surfaces[scene]]
        factor = self.friction_factor[scene] * self.tyre_factor[scene]
        friction = rows[:, 0] * (self._friction * factor)
        stiffness = rows[:, 2] * self.stiffness_factor[scene]
        engine.set_wheel_contacts(
            friction.tolist(), rows[:, 1].tolist(), stiffness.tolist(), rows[:, 3].tolist()
        )

    def _table(self, surfaces: SurfaceMap) -> tuple[Array, Array]:
        wheel = WheelLoad(self._share_n, 2 * self._robot.contact_radius_m, self._robot.contact_width_m)
        return _table(surfaces.surfaces, wheel, surfaces.sinkage)

    def _mapped(self) -> list[tuple[World, NDArray[np.intp], Array]]:
        # The worlds with a map, the scenes that are in each, and the rolling resistance of its surfaces.
        if self._groups is None:
            self._groups = self._grouped()
        return self._groups

    def _grouped(self) -> list[tuple[World, NDArray[np.intp], Array]]:
        scenes: dict[int, list[int]] = {}
        for scene, world in enumerate(self._worlds):
            if world is not None and world.surfaces is not None:
                scenes.setdefault(id(world), []).append(scene)
        groups = []
        for members in scenes.values():
            world = self._worlds[members[0]]
            assert world is not None and world.surfaces is not None
            groups.append((world, np.array(members), self._table(world.surfaces)[1]))
        return groups


def _wheel_speeds(motion: Motion, driven: int) -> Array | None:
    return None if motion.joints is None else motion.joints.speed[:, :driven]


@lru_cache(maxsize=64)
def _table(surfaces: tuple[Surface, ...], wheel: WheelLoad, sinkage: bool) -> tuple[Array, Array]:
    return contact_table(surfaces, wheel, sinkage=sinkage, gravity_mps2=GRAVITY_MPS2)


_ALL = slice(None)


def drag_forces(
    sites: BatchedWorlds, motion: Motion, robot: RobotDescription, count: int = 1
) -> Array | None:
    """Force [N] of the grass on each robot, (M * `count`, 3), world frame; None where no grass grows."""
    groups = sites.worlds.groups
    if all(world.grass is None for world, _ in groups):
        return None
    force = np.zeros_like(motion.velocity_w)
    for world, rows in groups:
        if world.grass is not None:
            rows = agent_rows(rows, count)
            force[rows] = grass_force(world.grass, motion, robot, rows)
    return force


def grass_force(grass: Grass, motion: Motion, robot: RobotDescription, rows: Rows = _ALL) -> Array:
    """Force [N] on each robot of `rows`, world frame: against its velocity, and proportional to it.

    It is also proportional to the density of the grass at the robot's centre and
    to the share of the robot's height in the grass. It acts for one control
    step, which is too short to reverse the velocity.
    """
    bottom = motion.position_w[rows] - robot.standing_height_m * motion.rotation[rows, :, 2]
    force: Array = -grass.drag(bottom, robot.height_m)[:, None] * motion.velocity_w[rows]
    return force
