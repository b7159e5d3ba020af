"""Loading of a robot into PyBullet, with the masses of a variation and with tyres."""

from collections.abc import Sequence

from dune_rl.core.errors import PhysicsError
from dune_rl.physics.bullet.body import LoadedBody
from dune_rl.physics.bullet.collision import set_up_links
from dune_rl.physics.bullet.joints import set_up_joints
from dune_rl.physics.bullet.urdf import RobotUrdfs, load_shared_urdfs, named_file
from dune_rl.physics.process import suppress_stderr
from dune_rl.physics.robot_body import RobotBody
from dune_rl.physics.varied_body import BodyVariation

with suppress_stderr():
    import pybullet


class BodyLoader:
    """Loads `body` from the URDF of `spec`, at the start pose, and sets up its links and joints.

    PyBullet can neither add links to a loaded body nor remove them, and its
    masses stay as loaded: for each such change the robot is loaded anew.
    """

    def __init__(self, body: LoadedBody, spec: RobotBody, hull_mask: int) -> None:
        self._body, self._spec, self._hull_mask = body, spec, hull_mask
        self._pose: tuple[Sequence[float], Sequence[float]] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        self._urdfs = load_shared_urdfs(spec)
        self._next_variation: BodyVariation | None = None
        self._variation: BodyVariation | None = None

    def set_variation(self, variation: BodyVariation) -> None:
        """Set the masses from the next `load` on."""
        self._next_variation = None if variation.keeps_masses else variation

    def set_start_pose(self, position_w: Sequence[float], quaternion: Sequence[float]) -> None:
        """Set the pose, (3) [m] and xyzw (4), from the next load on."""
        self._pose = (position_w, quaternion)

    def load(self) -> int:
        """Load the robot with its present masses and without tyres, and return PyBullet's handle."""
        if self._next_variation is not self._variation:
            self._variation = variation = self._next_variation
            shared = variation is None
            self._urdfs = load_shared_urdfs(self._spec) if shared else RobotUrdfs(self._spec, variation)
        return self._load(frozenset())

    def reload(self, tyres: frozenset[int]) -> int:
        """Replace the robot by one with the tyres of these indices, in the same state; return its handle."""
        body, client = self._body, self._body.client
        old = body.handle
        position, quaternion = pybullet.getBasePositionAndOrientation(old, physicsClientId=client)
        linear, angular = pybullet.getBaseVelocity(old, physicsClientId=client)
        joints = pybullet.getJointStates(old, body.movable, physicsClientId=client)
        body.remove()
        robot = self._load(tyres)
        pybullet.resetBasePositionAndOrientation(robot, position, quaternion, physicsClientId=client)
        pybullet.resetBaseVelocity(robot, linear, angular, physicsClientId=client)
        for joint, (angle, speed, _, _) in zip(body.movable, joints, strict=True):
            pybullet.resetJointState(robot, joint, angle, speed, physicsClientId=client)
        return robot

    def _load(self, tyres: frozenset[int]) -> int:
        # PyBullet loads a URDF only from a file.
        with named_file(self._urdfs.text(tyres)) as name:
            robot = self._load_file(name, has_tyres=bool(tyres))
        self._body.take(robot)
        set_up_links(self._body, self._spec, self._hull_mask)
        set_up_joints(self._body, self._spec)
        return robot

    def _load_file(self, name: str, *, has_tyres: bool) -> int:
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        if has_tyres:
            # Round, not prisms with 32 sides.
            flags |= pybullet.URDF_USE_IMPLICIT_CYLINDER
        position_w, quaternion = self._pose
        try:
            robot: int = pybullet.loadURDF(
                name,
                basePosition=list(position_w),
                baseOrientation=list(quaternion),
                flags=flags,
                physicsClientId=self._body.client,
            )
        except pybullet.error as error:
            raise PhysicsError(f"PyBullet cannot load {self._spec.urdf}: {error}") from error
        return robot
