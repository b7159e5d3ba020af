"""What a robot meets in a DART scene: ground, obstacles, and capsules that move as they are told."""

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

from dune_rl.errors import PhysicsError
from dune_rl.physics.dart_files import is_open, write_meshes
from dune_rl.physics.dart_library import dartpy
from dune_rl.physics.dart_robot import NEVER_THE_LESSER, DartRobot, parsed
from dune_rl.physics.interface import CAPSULE_FRICTION, SceneSpec, StaticBody

# Bullet's margin round the triangles of a mesh that is no solid, which spheres alone do not feel.
_TRIANGLE_MARGIN_M = 0.01


class Surroundings:
    """Everything that never moves, in one skeleton.

    The ground is there twice, for links that stand on it and for the hull, as
    each pair has a friction of its own; so are obstacles, where feet meet them.
    """

    def __init__(self, spec: SceneSpec, meshes: "Meshes", robot: DartRobot) -> None:
        self.skeleton = dartpy.dynamics.Skeleton("statics")
        self.for_feet, self.for_hull, self.obstacles = (self._body() for _ in range(3))
        self.obstacles_for_feet = [self._body()] if spec.robot.ground_links_meet_obstacles else []
        self._numbered: list[tuple[int, Any]] = []
        self._underfoot: list[tuple[Any, float]] = []
        self._given = False
        self._terrain_friction = terrain_friction(spec.statics)
        # How far the detector holds them off triangles that are no solid.
        gap_of_feet = 0.0 if robot.feet_are_balls else _TRIANGLE_MARGIN_M
        gap_of_hull = 0.0 if robot.hull_is_balls else _TRIANGLE_MARGIN_M
        for number, (body, shape) in enumerate(zip(spec.statics, meshes.shapes, strict=True)):
            feet_friction = body.friction * spec.robot.ground_friction
            hull_friction = body.friction * spec.robot.hull_friction
            if body.ground:
                hollow = meshes.hollow[number]
                raised = -gap_of_feet * hollow
                node = _add_shape(self.for_feet, shape, feet_friction, raised)
                # Two coefficients multiply, and a robot's is 0 until it is set.
                node.getDynamicsAspect().setRestitutionCoeff(body.restitution)
                self._underfoot.append((node, feet_friction))
                _add_shape(self.for_hull, shape, hull_friction, -gap_of_hull * hollow)
                continue
            self._numbered.append((number, _add_shape(self.obstacles, shape, hull_friction)))
            for other in self.obstacles_for_feet:
                self._numbered.append((number, _add_shape(other, shape, feet_friction)))
        self.skeleton.setMobile(False)

    def give_friction_to_feet(self) -> float:
        """Let links that stand on the ground say what friction they have there; returns the ground's own."""
        if not self._given:
            self._given = True
            for node, _ in self._underfoot:
                node.getDynamicsAspect().setFrictionCoeff(NEVER_THE_LESSER)
        return self._terrain_friction

    def take_friction_back(self) -> None:
        """Undo `give_friction_to_feet`."""
        if self._given:
            self._given = False
            for node, friction in self._underfoot:
                node.getDynamicsAspect().setFrictionCoeff(friction)

    def _body(self) -> Any:
        return self.skeleton.createWeldJointAndBodyNodePair()[1]

    def touched(self, met: Any) -> list[int]:
        """Numbers of the obstacles that are `met`."""
        if not any(met(body) for body in (self.obstacles, *self.obstacles_for_feet)):
            return []
        return [number for number, shape in self._numbered if met(shape)]


def terrain_friction(statics: Iterable[StaticBody]) -> float:
    """The ground's friction coefficient, 1 where there is none."""
    return next((body.friction for body in statics if body.ground), 1.0)


class Capsules:
    """Bodies that move at the speed they are told, whatever they meet; they never turn."""

    def __init__(self, spec: SceneSpec) -> None:
        self.skeleton = dartpy.dynamics.Skeleton("kinematics")
        self.for_hull: list[Any] = []
        self.for_feet: list[Any] = []
        self._first = len(spec.statics)
        for body in spec.kinematics:
            joint, node = self.skeleton.createTranslationalJointAndBodyNodePair()
            joint.setActuatorType(dartpy.dynamics.ActuatorType.VELOCITY)
            shape = dartpy.dynamics.CapsuleShape(body.radius_m, body.height_m - 2 * body.radius_m)
            _add_shape(node, shape, CAPSULE_FRICTION * spec.robot.hull_friction)
            self.for_hull.append(node)
            if spec.robot.ground_links_meet_obstacles:
                _, other = self.skeleton.createWeldJointAndBodyNodePair(node)
                _add_shape(other, shape, CAPSULE_FRICTION * spec.robot.ground_friction)
                self.for_feet.append(other)

    def touched(self, met: Any) -> list[int]:
        """Numbers of the bodies that are `met`."""
        return [
            self._first + number
            for bodies in (self.for_hull, self.for_feet)
            for number, body in enumerate(bodies)
            if met(body)
        ]


def _add_shape(body: Any, shape: Any, friction: float, raised_m: float = 0.0) -> Any:
    node = body.createShapeNode(shape)
    node.createCollisionAspect()
    node.createDynamicsAspect().setFrictionCoeff(friction)
    node.setRelativeTranslation([0.0, 0.0, raised_m])
    return node


class Meshes:
    """The shapes of static bodies, and the detector that has built its trees of them."""

    def __init__(self, statics: tuple[StaticBody, ...]) -> None:
        self.statics = statics
        self.detector = dartpy.collision.BulletCollisionDetector()
        self.hollow = [is_open(body) for body in statics]
        self.shapes = self._read()
        # The detector forgets a mesh that is in no group.
        self._holder = dartpy.dynamics.Skeleton("meshes")
        body = self._holder.createWeldJointAndBodyNodePair()[1]
        for shape in self.shapes:
            _add_shape(body, shape, 0.0)
        self._group = self.detector.createCollisionGroup()
        self._group.addShapeFrames([*body.getShapeNodes()])

    def _read(self) -> list[Any]:
        if not self.statics:
            return []
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            read = parsed(write_meshes(self.statics, self.hollow, folder), folder)
            nodes = [] if read is None else read.getBodyNode(0).getShapeNodes()
            if len(nodes) != len(self.statics):
                raise PhysicsError(
                    f"DART read {len(nodes)} of {len(self.statics)} meshes from {folder}; "
                    "set TMPDIR to a folder with room"
                )
            return [node.getShape() for node in nodes]


# Scenes of one batch have the same statics; each entry lives as long as one of them does, and holds
# the statics, so that no others can have their address.
_in_use: WeakValueDictionary[int, Meshes] = WeakValueDictionary()


def shared_meshes(statics: tuple[StaticBody, ...]) -> Meshes:
    meshes = _in_use.get(id(statics))
    if meshes is None:
        _in_use[id(statics)] = meshes = Meshes(statics)
    return meshes
