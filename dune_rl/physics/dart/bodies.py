"""What a robot meets in a DART scene: ground, obstacles, and capsules that move as they are told."""

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

from dune_rl.errors import PhysicsError
from dune_rl.physics.dart.files import is_open, write_meshes
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.robot import NEVER_THE_LESSER, DartRobot, parsed
from dune_rl.physics.interface import CAPSULE_FRICTION, SceneSpec, StaticBody

# Bullet's margin round the triangles of a mesh that is no solid, which spheres alone do not feel.
_TRIANGLE_MARGIN_M = 0.01


class Kind(NamedTuple):
    """Links that have one friction with all that they touch."""

    stands: bool
    friction: float


def kinds(robots: Sequence[DartRobot]) -> list[Kind]:
    """Those that meet obstacles, those that do not stand first."""
    hulls = [Kind(False, robot.spec.hull_friction) for robot in robots]
    feet = [
        Kind(True, robot.spec.ground_friction) for robot in robots if robot.spec.ground_links_meet_obstacles
    ]
    return list(dict.fromkeys([*hulls, *feet]))


class Surroundings:
    """Everything that never moves, in one skeleton.

    As each pair has a friction of its own, all of it is there more than once:
    the ground for the feet of each robot, and for hulls, and obstacles for
    each `Kind` of links that meets them.
    """

    def __init__(self, statics: Sequence[StaticBody], meshes: "Meshes", robots: Sequence[DartRobot]) -> None:
        self.skeleton = dartpy.dynamics.Skeleton("statics")
        self.for_feet = [self._body() for _ in robots]
        self._underfoot: list[list[tuple[Any, float]]] = [[] for _ in robots]
        self._given: set[int] = set()
        self._terrain_friction = terrain_friction(statics)
        hulls = [(robot.spec.hull_friction, _gap(robot.hull_is_balls)) for robot in robots]
        grounds = {hull: self._body() for hull in dict.fromkeys(hulls)}
        self.for_hull = [grounds[hull] for hull in hulls]
        self.obstacles = {kind: self._body() for kind in kinds(robots)}
        self.numbers: dict[Any, int] = {}
        for number, (static, shape) in enumerate(zip(statics, meshes.shapes, strict=True)):
            if static.ground:
                hollow = meshes.hollow[number]
                for robot, body, nodes in zip(robots, self.for_feet, self._underfoot, strict=True):
                    friction = static.friction * robot.spec.ground_friction
                    node = _add_shape(body, shape, friction, -_gap(robot.feet_are_balls) * hollow)
                    # Two coefficients multiply, and a robot's is 0 until it is set.
                    node.getDynamicsAspect().setRestitutionCoeff(static.restitution)
                    nodes.append((node, friction))
                for (friction, gap), body in grounds.items():
                    _add_shape(body, shape, static.friction * friction, -gap * hollow)
                continue
            for kind, body in self.obstacles.items():
                self.numbers[_add_shape(body, shape, static.friction * kind.friction)] = number
        self.skeleton.setMobile(False)

    def give_friction_to_feet(self, robot: int) -> float:
        """Let a robot's links that stand on the ground say what friction they have there.

        Returns the ground's own.
        """
        if robot not in self._given:
            self._given.add(robot)
            for node, _ in self._underfoot[robot]:
                node.getDynamicsAspect().setFrictionCoeff(NEVER_THE_LESSER)
        return self._terrain_friction

    def take_friction_back(self) -> None:
        """Undo `give_friction_to_feet`."""
        for robot in self._given:
            for node, friction in self._underfoot[robot]:
                node.getDynamicsAspect().setFrictionCoeff(friction)
        self._given.clear()

    def _body(self) -> Any:
        return self.skeleton.createWeldJointAndBodyNodePair()[1]


def _gap(balls: bool) -> float:
    """How far the detector holds links off triangles that are no solid [m]."""
    return 0.0 if balls else _TRIANGLE_MARGIN_M


def terrain_friction(statics: Iterable[StaticBody]) -> float:
    """The ground's friction coefficient, 1 where there is none."""
    return next((body.friction for body in statics if body.ground), 1.0)


class Capsules:
    """Bodies that move at the speed they are told, whatever they meet; they never turn.

    Each is there for each `Kind` of links that meets it.
    """

    def __init__(self, spec: SceneSpec, robots: Sequence[DartRobot]) -> None:
        self.skeleton = dartpy.dynamics.Skeleton("kinematics")
        self.bodies: dict[Kind, list[Any]] = {kind: [] for kind in kinds(robots)}
        self.numbers: dict[Any, int] = {}
        for number, capsule in enumerate(spec.kinematics, start=len(spec.statics)):
            joint, mover = self.skeleton.createTranslationalJointAndBodyNodePair()
            joint.setActuatorType(dartpy.dynamics.ActuatorType.VELOCITY)
            shape = dartpy.dynamics.CapsuleShape(capsule.radius_m, capsule.height_m - 2 * capsule.radius_m)
            for count, (kind, bodies) in enumerate(self.bodies.items()):
                body = self.skeleton.createWeldJointAndBodyNodePair(mover)[1] if count else mover
                self.numbers[_add_shape(body, shape, CAPSULE_FRICTION * kind.friction)] = number
                bodies.append(body)


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
