"""The DART backend."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.physics.dart.bodies import Capsules, Surroundings, shared_meshes, terrain_friction
from dune_rl.physics.dart.collision_filter import Meetings
from dune_rl.physics.dart.corners import Corners
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.robot import DartRobot
from dune_rl.physics.first_robot import AnswersAsFirst
from dune_rl.physics.interface import SceneSpec

# A kinematic body farther than this from the robot is moved once per control
# step: it cannot touch the robot before the next one.
_NEAR_M = 2.0

# Finer takes more of the sweeps and changes no rate of turn by 1 %.
_CONE_TOLERANCE = 1e-3


class DartScene(AnswersAsFirst["_SceneRobot"]):
    """One DART world, with Bullet's collision detector and DART's own contact solvers."""

    def __init__(self, spec: SceneSpec) -> None:
        self._spec = spec
        self._meshes = shared_meshes(spec.statics)
        self._robots = [_SceneRobot(spec, number) for number in range(len(spec.robots))]
        self._first, self.others = self._robots[0], self._robots[1:]
        self._surroundings = Surroundings(spec.statics, self._meshes, self._robots)
        self._centre_heights = np.array([body.height_m / 2 for body in spec.kinematics])
        self._cone = _cone_solver(spec.solver_iterations) if spec.friction == "cone" else None
        self._world: Any = None

    def place(
        self, position_w: Sequence[float], quaternion: Sequence[float], kinematic_poses: NDArray[np.float64]
    ) -> None:
        # All that remembers is made anew: the robots, the kinematic bodies, and the world with the
        # collision detector's pairs and contacts. Meshes, which are slow to build, remember nothing.
        self.close()
        spec = self._spec
        self._first.stand(position_w, quaternion)
        skeletons = [robot.place() for robot in self._robots]
        self._surroundings.take_friction_back()
        self._capsules = Capsules(spec, self._robots)
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
        self._filter = solver.getCollisionOption().collisionFilter
        self._meetings = Meetings(
            self._robots, self._surroundings, self._capsules, spec.first_robot, self._filter
        )
        for robot in self._robots:
            robot.enter(world, self._surroundings, self._meetings)
        self._watches = False
        self._corners = Corners(self._robots, self._surroundings.for_hull)
        for skeleton in (self._surroundings.skeleton, self._capsules.skeleton, *skeletons):
            world.addSkeleton(skeleton)

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
        self._first.drive(commands)
        self._grow_corners()
        # A robot that falls on its back goes deep in the steps between.
        self._watches = self._corners.are_wanted and any(robot.falls() for robot in self._robots)
        pushes = []
        for robot in self._robots:
            push = robot.pushed()
            if push is not None:
                pushes.append((robot, push))
            robot.begin(count)
        if not len(kinematic_poses):
            self._advance(count, pushes)
            return
        centres = self._centres(kinematic_poses)
        places = np.array([robot.xy() for robot in self._robots])
        near = (np.abs(centres[:, None, :2] - places) < _NEAR_M).all(axis=2).any(axis=1)
        if not near.any():
            self._rest(centres)
            self._advance(count, pushes)
            return
        start = np.where(near[:, None], self._capsule_centres, centres)
        self._capsules.skeleton.setPositions(start.ravel())
        # They move at these speeds by themselves, and what they meet feels it.
        speeds = (centres - start).ravel() / (count * self._spec.timestep_s)
        self._capsules.skeleton.setCommands(speeds)
        self._advance(count, pushes)
        self._rest(centres)

    def _forget_contacts(self) -> None:
        """Have the detector find all contacts anew in the next physics step.

        It does so by itself whenever a body is made anywhere in the process: when another scene begins an
        episode, say. Contacts kept for longer than a step would depend on that in their last bits.
        """
        # Any change of the filter does it; that a body does not meet itself is none.
        base = self._first.skeleton.getBodyNode(0)
        self._filter.addBodyNodePairToBlackList(base, base)

    def coast(self, count: int) -> None:
        self._advance(count, ())

    def _advance(self, count: int, pushes: "Sequence[tuple[_SceneRobot, Sequence[float]]]") -> None:
        self._forget_contacts()
        advance = self._world.step
        before_each = [robot.before for robot in self._robots if robot.has_work_before]
        after_each = [robot.after for robot in self._robots if robot.has_work_after]
        for _ in range(count):
            for robot, push in pushes:
                robot.apply(push)
            for before in before_each:
                before()
            # False: joints keep their commands.
            advance(False)
            for after in after_each:
                after()
            if self._watches:
                self._grow_corners()
        for robot, _ in pushes:
            robot.let_go()

    def _grow_corners(self) -> None:
        if self._corners.are_wanted and self._corners.grow(self._world.getLastCollisionResult()):
            self._meetings.look_again()

    def close(self) -> None:
        # What the engine holds goes with the last reference to it.
        self._world = None
        for robot in self._robots:
            robot.forget()


class _SceneRobot(DartRobot):
    """Robot `number` of a scene, which it enters after each `place`."""

    def __init__(self, spec: SceneSpec, number: int) -> None:
        super().__init__(
            spec.robots[number],
            spec.timestep_s,
            measures_work=spec.measures_work,
            terrain_friction=terrain_friction(spec.statics),
        )
        self._number = number
        self._world: Any = None
        self._meetings: Any = None

    def enter(self, world: Any, surroundings: Surroundings, meetings: Meetings) -> None:
        self._world, self._surroundings, self._meetings = world, surroundings, meetings

    def forget(self) -> None:
        super().forget()
        self._world = self._meetings = None

    def set_wheel_contacts(
        self,
        friction: Sequence[float],
        restitution: Sequence[float],
        stiffness: Sequence[float] | None = None,
        damping: Sequence[float] | None = None,
    ) -> None:
        ground = self._surroundings.give_friction_to_feet(self._number)
        grip = [coefficient * ground for coefficient in friction]
        self.set_foot_contacts(grip, restitution, stiffness, damping)

    def touched(self) -> list[int]:
        return self._meetings.touched(self._number, self._world.getLastCollisionResult())


def _cone_solver(sweeps: int) -> Any:
    options = dartpy.constraint.NsgsFrictionSolver.Options()
    options.maxSweeps, options.tolerance = sweeps, _CONE_TOLERANCE
    return dartpy.constraint.NsgsFrictionSolver(options)
