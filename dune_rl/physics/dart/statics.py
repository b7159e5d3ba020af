"""Static bodies of a DART scene."""

import tempfile
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from hashlib import blake2b
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from dune_rl.core.errors import PhysicsError
from dune_rl.geometry.arrays import Array
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.loading import (
    ROBOT_FRICTION,
    add_shape,
    is_open_surface,
    mesh_corners,
    parse_skeleton,
    write_meshes,
)
from dune_rl.physics.dart.robot import DartRobot
from dune_rl.physics.process import return_free_memory, share_by_identity
from dune_rl.physics.shapes import StaticBody

# Bullet's collision margin of triangles of an open surface; spheres alone are not affected by it.
_TRIANGLE_MARGIN_M = 0.01


class LinkMaterial(NamedTuple):
    """Role and friction coefficient of a robot's link; links of equal material share collision bodies."""

    role: Literal["hull", "ground_link", "tyre"]
    friction: float


def obstacle_materials(robots: Sequence[DartRobot]) -> list[LinkMaterial]:
    """Materials of the links, without tyres, that collide with obstacles, hulls first, without duplicates."""
    hulls = [LinkMaterial("hull", robot.spec.hull_friction) for robot in robots]
    feet = [
        LinkMaterial("ground_link", robot.spec.ground_friction)
        for robot in robots
        if robot.spec.ground_links_meet_obstacles
    ]
    return list(dict.fromkeys([*hulls, *feet]))


def tyre_materials(robots: Sequence[DartRobot]) -> list[LinkMaterial]:
    """Materials of tyres, without duplicates."""
    tyres = [LinkMaterial("tyre", robot.spec.ground_friction) for robot in robots if robot.spec.tyres]
    return list(dict.fromkeys(tyres))


class StaticGeometry:
    """All static bodies, in one skeleton.

    DART has one friction coefficient per shape, not per pair. So each static body is present several times:
    ground once for the ground links of each robot and once for each hull friction, obstacles once for each
    `LinkMaterial` that collides with them; but those for tyres are present only while they are near, see
    `set_tyre_obstacles`.
    """

    def __init__(
        self, statics: Sequence[StaticBody], meshes: "SharedMeshes", robots: Sequence[DartRobot]
    ) -> None:
        self.skeleton = dartpy.dynamics.Skeleton("statics")
        self.foot_ground = [self._add_body() for _ in robots]
        self._foot_nodes: list[list[tuple[Any, float]]] = [[] for _ in robots]
        self._robots_with_foot_friction: set[int] = set()
        hulls = [(robot.spec.hull_friction, _margin_m(robot.has_spherical_hull)) for robot in robots]
        grounds = {hull: self._add_body() for hull in dict.fromkeys(hulls)}
        self.hull_ground = [grounds[hull] for hull in hulls]
        self.obstacles = {material: self._add_body() for material in obstacle_materials(robots)}
        obstacles = [*self.obstacles.items()]
        self._tyre_obstacles = {material: self._add_body() for material in tyre_materials(robots)}
        self.obstacles |= self._tyre_obstacles
        self._statics, self._shapes = statics, meshes.shapes
        self._near_tyres: frozenset[int] = frozenset()
        self._numbers: dict[Any, int] = {}
        self._tyre_numbers: dict[Any, int] = {}
        for number, (static, shape) in enumerate(zip(statics, meshes.shapes, strict=True)):
            if static.ground:
                is_open = meshes.is_open[number]
                for robot, body, nodes in zip(robots, self.foot_ground, self._foot_nodes, strict=True):
                    friction = static.friction * robot.spec.ground_friction
                    node = add_shape(body, shape, friction, -_margin_m(robot.has_spherical_feet) * is_open)
                    # DART multiplies the two coefficients, and a robot's is 0 until it is set.
                    node.getDynamicsAspect().setRestitutionCoeff(static.restitution)
                    nodes.append((node, friction))
                for (friction, margin), body in grounds.items():
                    add_shape(body, shape, static.friction * friction, -margin * is_open)
                continue
            for material, body in obstacles:
                self._numbers[add_shape(body, shape, static.friction * material.friction)] = number
        self.skeleton.setMobile(False)

    @property
    def numbers(self) -> dict[Any, int]:
        """Body numbers by shape, without ground."""
        return self._numbers | self._tyre_numbers

    @property
    def tyre_obstacles(self) -> frozenset[int]:
        """Numbers of the obstacles that collide with tyres."""
        return self._near_tyres

    def set_tyre_obstacles(self, numbers: frozenset[int]) -> None:
        """Make the obstacles with these numbers, and no others, collide with tyres.

        Each collision shape costs the engine time in every physics step, near or not. Python must not refer
        to shapes when they are removed.
        """
        if numbers == self._near_tyres:
            return
        self._near_tyres = numbers
        self._tyre_numbers.clear()
        for material, body in self._tyre_obstacles.items():
            # One call of DART 6.20 leaves some of them.
            while body.getNumShapeNodes():
                body.removeAllShapeNodes()
            for number in sorted(numbers):
                friction = self._statics[number].friction * material.friction
                self._tyre_numbers[add_shape(body, self._shapes[number], friction)] = number

    def use_foot_friction(self, robot: int) -> None:
        """Make the coefficients of a robot's ground links, not the ground's, decide their friction.

        The links' are to be multiplied with the ground's.
        """
        if robot not in self._robots_with_foot_friction:
            self._robots_with_foot_friction.add(robot)
            for node, _ in self._foot_nodes[robot]:
                node.getDynamicsAspect().setFrictionCoeff(ROBOT_FRICTION)

    def restore_friction(self) -> None:
        """Undo `use_foot_friction` for all robots."""
        for robot in self._robots_with_foot_friction:
            for node, friction in self._foot_nodes[robot]:
                node.getDynamicsAspect().setFrictionCoeff(friction)
        self._robots_with_foot_friction.clear()

    def _add_body(self) -> Any:
        return self.skeleton.createWeldJointAndBodyNodePair()[1]


def _margin_m(only_spheres: bool) -> float:
    """Distance [m] at which the detector keeps links off the triangles of an open surface."""
    return 0.0 if only_spheres else _TRIANGLE_MARGIN_M


def terrain_friction(statics: Iterable[StaticBody]) -> float:
    """Friction coefficient of the ground, 1 if there is none."""
    return next((body.friction for body in statics if body.ground), 1.0)


class CollisionMeshes:
    """Mesh shapes of static bodies, and the collision detector that holds their bounding volume trees.

    `meshes` are the corners (F, 3, 3) [m] of the triangles of each body.
    """

    def __init__(self, meshes: Sequence[Array]) -> None:
        self.detector = dartpy.collision.BulletCollisionDetector()
        self.shapes = _load_shapes(meshes) if meshes else []
        # The detector drops meshes that are in no collision group.
        self._holder = dartpy.dynamics.Skeleton("meshes")
        body = self._holder.createWeldJointAndBodyNodePair()[1]
        for shape in self.shapes:
            add_shape(body, shape, 0.0)
        self._group = self.detector.createCollisionGroup()
        self._group.addShapeFrames([*body.getShapeNodes()])
        # The text of the files, and meshes of the worlds before.
        return_free_memory()


def _load_shapes(meshes: Sequence[Array]) -> list[Any]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        skeleton = parse_skeleton(write_meshes(meshes, folder), folder)
        nodes = [] if skeleton is None else skeleton.getBodyNode(0).getShapeNodes()
        if len(nodes) != len(meshes):
            raise PhysicsError(
                f"DART read {len(nodes)} of {len(meshes)} meshes from {folder}; "
                "set TMPDIR to a folder with room"
            )
        return [node.getShape() for node in nodes]


# The last meshes that were loaded, by what is in them. DART 6.20 never deletes its copy of the triangles
# (`createMesh` in BulletCollisionDetector.cpp): 108 bytes of each stay for every world that a process enters,
# see `experiments/memory`, so that a world that is made anew had better find them.
_MOST_KEPT = 16
_kept: OrderedDict[bytes, CollisionMeshes] = OrderedDict()


class SharedMeshes:
    """The collision meshes of `statics`, and which of these are open surfaces."""

    def __init__(self, statics: tuple[StaticBody, ...]) -> None:
        # See `share_by_identity`.
        self.statics = statics
        self.is_open = [is_open_surface(body) for body in statics]
        meshes = [mesh_corners(body, is_open) for body, is_open in zip(statics, self.is_open, strict=True)]
        digest = blake2b()
        for mesh in meshes:
            digest.update(f"{mesh.shape}".encode() + np.ascontiguousarray(mesh).tobytes())
        key = digest.digest()
        if key not in _kept:
            _kept[key] = CollisionMeshes(meshes)
        _kept.move_to_end(key)
        self._loaded = _kept[key]
        while len(_kept) > _MOST_KEPT:
            _kept.popitem(last=False)

    @property
    def detector(self) -> Any:
        """The collision detector of all scenes with these meshes."""
        return self._loaded.detector

    @property
    def shapes(self) -> list[Any]:
        """The shape of each static body."""
        return self._loaded.shapes


# The meshes of a tuple of statics, found once for all scenes with the same tuple.
load_shared_meshes = share_by_identity(SharedMeshes)
