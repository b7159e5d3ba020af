"""A rover on ground of given surfaces, in true physics, without an environment round it."""

import numpy as np
from scenes import Backend, plane_field
from states import joints_from, motion_of

from dune_rl.env.scene_spec import scene_spec, standing_pose
from dune_rl.env.traction import Traction
from dune_rl.physics.interface import PhysicsConf, step_scene
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf
from dune_rl.worlds.surfaces import SURFACES, Surface, SurfaceMap
from dune_rl.worlds.world import World

# The middle of one large triangle of `slope_world`: at edges a wheel that yields has two contacts.
MIDDLE = (-1.5, -3.5)


def slope_world(surface: Surface | None, slope_rad: float = 0.0, *, sinkage: bool = False) -> World:
    """A slope that rises along x, all of one surface; None: without a map."""
    terrain = plane_field(slope_rad, half=8, spacing_m=5.0)
    surfaces = None if surface is None else SurfaceMap([[0]], terrain.extent, [surface], sinkage=sinkage)
    return World("slope", terrain, region=(-1, 1, -1, 1), surfaces=surfaces)


def named(name: str) -> Surface:
    return next(surface for surface in SURFACES if surface.name == name)


class RoverOnGround:
    """One rover on a world of surfaces, driven by wheel speeds."""

    def __init__(
        self,
        backend: Backend,
        world: World,
        *,
        at: tuple[float, float] = MIDDLE,
        yaw: float = 0.0,
        drop_m: float = 0.0,
        conf: RoverZeroConf | None = None,
        factors: tuple[float, float] = (1.0, 1.0),
        tyres: float = 1.0,
        load: float = 1.0,
    ) -> None:
        self.world, self.physics = world, PhysicsConf()
        self.robot = RoverZero(conf or RoverZeroConf(), 1)
        self.scene = backend(scene_spec(world, (self.robot.body,), (), self.physics))
        self.engine = self.scene.robots[0]
        self.traction = Traction(self.robot, self.physics, 1)
        self.traction.friction_factor[:], self.traction.stiffness_factor[:] = factors
        self.traction.tyre_factor[:], self.traction.load_factor[:] = tyres, load
        position, quaternion = standing_pose(world, self.robot.description, *at, yaw)
        position[2] += drop_m
        self.engine.set_start_pose(position.tolist(), quaternion.tolist())
        self.scene.reset(np.zeros((0, 6)))
        self.traction.begin(0, world, self.engine, position, quaternion)
        self._read()

    def _read(self) -> None:
        joints = joints_from(np.array(self.engine.drive_state()))
        self.motion = motion_of(np.array(self.engine.body_state()), joints)

    def step(self, wheels: float = 0.0, count: int = 1, substeps: int | None = None) -> None:
        for _ in range(count):
            force = self.traction.update([self.engine], self.motion)
            if force is not None:
                self.engine.apply_force(force[0].tolist())
            self.engine.set_command([wheels] * 4)
            step_scene(self.scene, substeps or self.physics.substeps, np.zeros((0, 6)))
            self._read()

    @property
    def position(self) -> np.ndarray:
        return self.motion.position_w[0]

    @property
    def speed(self) -> float:
        """Along the nose [m/s]."""
        return float(self.motion.velocity_b[0, 0])

    @property
    def height(self) -> float:
        """Of the wheels' bottoms over the ground [m], as if the ground were hard."""
        bottoms = self.position + self.robot.description.contact_centres_b @ self.motion.rotation[0].T
        ground, normal = self.world.terrain.height_and_normal(bottoms[:, :2])
        return (
            float(((bottoms[:, 2] - ground) * normal[:, 2]).mean()) - self.robot.description.standing_height_m
        )
