"""The DART backend."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.dart_bodies import Capsules, Surroundings, shared_meshes, terrain_friction
from dune_rl.physics.dart_library import dartpy
from dune_rl.physics.dart_robot import DartRobot
from dune_rl.physics.interface import SceneSpec
from dune_rl.physics.varied_body import BodyVariation

# A kinematic body farther than this from the robot is moved once per control
# step: it cannot touch the robot before the next one.
_NEAR_M = 2.0

# Finer takes more of the sweeps and changes no rate of turn by 1 %.
_CONE_TOLERANCE = 1e-3


class DartScene:
    """One DART world, with Bullet's collision detector and DART's own contact solvers."""

    def __init__(self, spec: SceneSpec) -> None:
        self._spec = spec
        self._meshes = shared_meshes(spec.statics)
        self._robot = DartRobot(
            spec.robot,
            spec.timestep_s,
            measures_work=spec.measures_work,
            terrain_friction=terrain_friction(spec.statics),
        )
        self._surroundings = Surroundings(spec, self._meshes, self._robot)
        self._centre_heights = np.array([body.height_m / 2 for body in spec.kinematics])
        self._cone = _cone_solver(spec.solver_iterations) if spec.friction == "cone" else None
        self._world: Any = None

    def set_body(self, variation: BodyVariation) -> None:
        self._robot.set_body(variation)

    def place(
        self, position_w: Sequence[float], quaternion: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        # All that remembers is made anew: the robot, the kinematic bodies, and the world with the
        # collision detector's pairs and contacts. Meshes, which are slow to build, remember nothing.
        spec = self._spec
        self._robot.stand(position_w, quaternion)
        robot = self._robot.place()
        self._surroundings.take_friction_back()
        self._capsules = Capsules(spec)
        self._rest(self._centres(kinematic_poses))
        self._world = world = dartpy.simulation.World()
        world.setTimeStep(spec.timestep_s)
        world.setGravity([0.0, 0.0, -spec.gravity_mps2])
        sleep = world.getDeactivationOptions()
        sleep.mEnabled = False
        world.setDeactivationOptions(sleep)
        solver = world.getConstraintSolver()
        solver.setCollisionDetector(self._meshes.detector)
        if self._cone is not None:
            solver.setBoxedLcpSolver(self._cone)
        self._part(solver.getCollisionOption().collisionFilter)
        for skeleton in (self._surroundings.skeleton, self._capsules.skeleton, robot):
            world.addSkeleton(skeleton)

    def _part(self, collision_filter: Any) -> None:
        """Say who does not meet whom."""
        for_feet = [self._surroundings.for_feet, *self._capsules.for_feet]
        for_hull = [self._surroundings.for_hull, self._surroundings.obstacles, *self._capsules.for_hull]
        for_feet += self._surroundings.obstacles_for_feet
        for body in self._robot.skeleton.getBodyNodes():
            stands = body.getName() in self._spec.robot.ground_links
            for stranger in for_hull if stands else for_feet:
                collision_filter.addBodyNodePairToBlackList(body, stranger)
        for capsule in (*self._capsules.for_hull, *self._capsules.for_feet):
            for stranger in self._surroundings.skeleton.getBodyNodes():
                collision_filter.addBodyNodePairToBlackList(capsule, stranger)

    def _centres(self, kinematic_poses: NDArray[np.float64]) -> NDArray[np.float64]:
        centres = kinematic_poses[:, :3].copy()
        centres[:, 2] += self._centre_heights
        return centres

    def _rest(self, centres: NDArray[np.float64]) -> None:
        capsules, still = self._capsules.skeleton, np.zeros(centres.size)
        self._capsule_centres = centres
        capsules.setPositions(centres.ravel())
        capsules.setVelocities(still)
        capsules.setCommands(still)

    def step(self, count: int, commands: Sequence[float], kinematic_poses: NDArray[np.float64]) -> None:
        push = self._robot.pushed()
        self._robot.drive(commands)
        self._robot.begin(count)
        if not len(kinematic_poses):
            self._advance(count, push)
            return
        centres = self._centres(kinematic_poses)
        near = np.abs(centres[:, :2] - self._robot.xy()).max(axis=1) < _NEAR_M
        start = np.where(near[:, None], self._capsule_centres, centres)
        self._capsules.skeleton.setPositions(start.ravel())
        # They move at these speeds by themselves, and what they meet feels it.
        speeds = (centres - start).ravel() / (count * self._spec.timestep_s)
        self._capsules.skeleton.setCommands(speeds)
        self._advance(count, push)
        self._rest(centres)

    def _advance(self, count: int, push: Sequence[float] | None) -> None:
        if push is None:
            self.coast(count)
            return
        for _ in range(count):
            self._robot.apply(push)
            self.coast(1)
        self._robot.let_go()

    def coast(self, count: int) -> None:
        advance, robot = self._world.step, self._robot
        has_work_before, has_work_after = robot.has_work_before, robot.has_work_after
        for _ in range(count):
            if has_work_before:
                robot.before()
            # False: joints keep their commands.
            advance(False)
            if has_work_after:
                robot.after()

    def push(self, force_w: Sequence[float]) -> None:
        self._robot.push(force_w)

    def set_wheel_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        ground = self._surroundings.give_friction_to_feet()
        grip = [coefficient * ground for coefficient in friction]
        self._robot.set_foot_contacts(grip, restitution, stiffness, damping)

    def work_j(self) -> float:
        return self._robot.work_j()

    def body_state(self) -> tuple[float, ...]:
        return self._robot.body_state()

    def drive_state(self) -> tuple[float, ...]:
        return self._robot.drive_state()

    def joint_angles(self, joints: Sequence[str]) -> tuple[float, ...]:
        return self._robot.joint_angles(joints)

    def touched(self) -> list[int]:
        met = self._world.getLastCollisionResult().inCollision
        return [*self._surroundings.touched(met), *self._capsules.touched(met)]

    def close(self) -> None:
        # What the engine holds goes with the last reference to it.
        self._world = None
        self._robot.forget()


def _cone_solver(sweeps: int) -> Any:
    options = dartpy.constraint.NsgsFrictionSolver.Options()
    options.maxSweeps, options.tolerance = sweeps, _CONE_TOLERANCE
    return dartpy.constraint.NsgsFrictionSolver(options)
