"""Builds the physics engine's `SceneSpec` from a world, robots and kinematic bodies."""

from collections.abc import Sequence

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.geometry.frames import quaternion_on_slope, rotation_matrices
from dune_rl.physics.interface import PhysicsConf, SceneSpec
from dune_rl.physics.robot_body import RobotBody
from dune_rl.physics.shapes import KinematicShape, StaticBody
from dune_rl.robots.robot import RobotDescription
from dune_rl.worlds.props import Mesh, merge_meshes
from dune_rl.worlds.world import World

# Every static body costs time in each physics step: of more obstacles than this, those in a cell of a grid of
# _GRID cells along each side are one body, which then counts as one in collisions.
_MOST_OBSTACLES, _GRID = 160, 8
# Room under the wheels at the start, so that no contact begins with penetration.
_DROP_M = 0.005


def scene_spec(
    world: World,
    robots: tuple[RobotBody, ...],
    kinematics: tuple[KinematicShape, ...],
    physics: PhysicsConf,
    measures_work: bool = False,
) -> SceneSpec:
    """The bodies of one scene: terrain, solid props, kinematic bodies and robots."""
    vertices, faces = world.terrain.mesh()
    # Contact parameters that are set on the wheels multiply with the ground's.
    neutral = world.surfaces is not None or world.takes_smaller_friction
    friction, restitution = (1.0, 1.0) if neutral else (world.friction, 0.0)
    obstacle_friction = min(1.0, world.friction) if world.takes_smaller_friction else world.friction
    statics = [StaticBody("terrain", vertices, faces, friction, ground=True, restitution=restitution)]
    # Every static body costs a third of a microsecond per step, so all decks, whose contacts are not
    # reported, become one body.
    decks = [(prop.vertices, prop.faces) for prop in world.props if prop.solid and prop.drivable]
    if decks:
        deck = merge_meshes(decks)
        statics.append(StaticBody("drivable props", *deck, friction, ground=True, restitution=restitution))
    obstacles = [(prop.name, prop.mesh) for prop in world.props if prop.solid and not prop.drivable]
    if len(obstacles) > _MOST_OBSTACLES:
        obstacles = _merge_by_place(obstacles)
    statics += [StaticBody(name, *mesh, obstacle_friction, ground=False) for name, mesh in obstacles]
    return SceneSpec(
        statics=tuple(statics),
        kinematics=kinematics,
        robots=robots,
        timestep_s=1.0 / physics.physics_hz,
        solver_iterations=physics.solver_iterations,
        friction=physics.friction,
        measures_work=measures_work,
    )


def _merge_by_place(obstacles: Sequence[tuple[str, Mesh]]) -> list[tuple[str, Mesh]]:
    """The obstacles as one body for each cell of a grid over all of them, in which their middles are."""
    middles = np.array([mesh[0][:, :2].mean(axis=0) for _, mesh in obstacles])
    low, size = middles.min(axis=0), np.maximum(np.ptp(middles, axis=0), 1e-9)
    cells = np.minimum(_GRID * (middles - low) / size, _GRID - 1).astype(int) @ np.array([_GRID, 1])
    return [
        (
            f"obstacles {cell}",
            merge_meshes(mesh for (_, mesh), own in zip(obstacles, cells, strict=True) if own == cell),
        )
        for cell in np.unique(cells).tolist()
    ]


def standing_pose(
    world: World, robot: RobotDescription, x: float, y: float, yaw: float
) -> tuple[Array, Array]:
    """Position (3,) and quaternion (4,) of a robot that stands at (x, y), just above contact."""
    normal = world.terrain.normal(np.array([x, y]))
    quaternion = quaternion_on_slope(normal, np.asarray(yaw))
    wheels = robot.contact_centres_b @ rotation_matrices(quaternion).T
    ground, normals = world.terrain.height_and_normal(wheels[:, :2] + [x, y])
    # The lowest point of a round wheel or foot over sloping ground is radius / cos(slope) below its centre.
    lift = ground + robot.contact_radius_m / normals[:, 2] - wheels[:, 2]
    return np.array([x, y, lift.max() + _DROP_M]), quaternion
