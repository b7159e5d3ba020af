"""The DART backend."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.physics.contact_gate import ContactGate, TyreActivation
from dune_rl.physics.dart.collision_filter import CollisionFilter
from dune_rl.physics.dart.kinematics import DartKinematics
from dune_rl.physics.dart.library import dartpy
from dune_rl.physics.dart.robot import CornerContacts, DartRobot
from dune_rl.physics.dart.statics import StaticGeometry, load_shared_meshes, terrain_friction
from dune_rl.physics.engine_robot import take_forces
from dune_rl.physics.interface import SceneSpec

# Obstacles farther than this from a robot's reach have no collision shapes for its tyres.
_TYRE_MARGIN_M = 0.5

# A smaller tolerance needs more sweeps and changes no yaw rate by 1 %.
_CONE_TOLERANCE = 1e-3


class DartScene:
    """`PhysicsScene` in a DART world, with Bullet's collision detector and DART's own contact solvers."""

    def __init__(self, spec: SceneSpec) -> None:
        self._spec = spec
        self._meshes = load_shared_meshes(spec.statics)
        ground = terrain_friction(spec.statics)
        self.robots = [
            DartRobot(robot, spec.timestep_s, measures_work=spec.measures_work, terrain_friction=ground)
            for robot in spec.robots
        ]
        self._static_geometry = StaticGeometry(spec.statics, self._meshes, self.robots)
        for index, robot in enumerate(self.robots):
            robot.use_own_friction = partial(self._static_geometry.use_foot_friction, index)
        self._gate = ContactGate(spec.statics, spec.kinematics, spec.robots)
        self._tyres = TyreActivation(len(spec.robots))
        self._cone = _cone_solver(spec.solver_iterations) if spec.friction == "cone" else None
        self._world: Any = None
        self._collision_filter: Any = None

    def reset(self, kinematic_poses: Array) -> None:
        # Everything with state is created anew: the robots, the kinematic bodies, and the world with the
        # collision detector's pairs and contacts. Meshes, which are slow to build, have no state.
        self.close()
        spec = self._spec
        skeletons = [robot.load() for robot in self.robots]
        self._static_geometry.restore_friction()
        if self._collision_filter is not None:
            self._collision_filter.refresh_shapes()
        self._static_geometry.set_tyre_obstacles(frozenset())
        self._tyres.reset()
        self._kinematics = DartKinematics(spec, self.robots)
        self._kinematics.place(kinematic_poses)
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
        self._engine_filter = solver.getCollisionOption().collisionFilter
        self._collision_filter = CollisionFilter(
            self.robots, self._static_geometry, self._kinematics, spec.robot_number(0), self._engine_filter
        )
        self._checks_corners_each_step = False
        # Physics steps, external forces, and which robots are exposed: what `_advance` takes.
        self._begun: tuple[int, Mapping[int, Sequence[float]], Sequence[bool]] = 0, {}, ()
        self._corners = CornerContacts(self.robots, self._static_geometry.hull_ground)
        self._skeletons = [self._static_geometry.skeleton, self._kinematics.skeleton, *skeletons]
        for skeleton in self._skeletons:
            world.addSkeleton(skeleton)

    def move_kinematic(self, index: int, pose: Array) -> None:
        self._kinematics.place_one(index, pose)

    def begin_step(self, count: int, kinematic_poses: Array) -> None:
        self._add_corners()
        # A robot that falls on its back penetrates deeply within the physics steps of one control step.
        self._checks_corners_each_step = self._corners.has_boxes_left and any(
            robot.is_falling() for robot in self.robots
        )
        forces = take_forces(self.robots)
        duration_s, kinematics = count * self._spec.timestep_s, self._kinematics
        gate = self._gate
        near, exposed = gate.find_contacts(self.robots, duration_s, forces, kinematics.poses, kinematic_poses)
        changed = self._tyres.update(gate.needed_tyres)
        if changed or any(self._tyres.active):
            self._update_tyres(changed, near)
        for robot in self.robots:
            robot.begin_step(count)
        kinematics.begin_step(kinematic_poses, near, duration_s)
        self._begun = count, forces, exposed

    def finish_step(self) -> None:
        self._advance(*self._begun)
        self._kinematics.end_step()

    def held_back_poses(self) -> Array | None:
        kinematics = self._kinematics
        return np.array(kinematics.poses) if kinematics.any_held_back else None

    def _update_tyres(self, changed: Sequence[int], near_kinematics: Sequence[int]) -> None:
        """Give robots the tyres that are active, and these the bodies that they may touch.

        `changed` are the robots with other tyres than before.
        """
        active = self._tyres.active
        obstacles: frozenset[int] = frozenset()
        for robot, tyres in zip(self.robots, active, strict=True):
            if tyres:
                x, y, _ = robot.planar_motion()
                obstacles |= {*self._gate.obstacles.bodies_near(x, y, robot.reach_m + _TYRE_MARGIN_M)}
        static_geometry, kinematics = self._static_geometry, self._kinematics
        adds_kinematics = any(active) and not kinematics.collide_with_tyres(near_kinematics)
        if not changed and obstacles == static_geometry.tyre_obstacles and not adds_kinematics:
            return
        with self._changed_shapes():
            static_geometry.set_tyre_obstacles(obstacles)
            for index in changed:
                self.robots[index].tyres.set_active(active[index])
            if not any(active):
                kinematics.remove_for_tyres()
            if adds_kinematics:
                kinematics.add_for_tyres(near_kinematics)
            if changed or adds_kinematics:
                self._collision_filter.rebuild()

    @contextmanager
    def _changed_shapes(self) -> Iterator[None]:
        """In the block, collision shapes may be added and removed.

        The detector takes shapes that come or go together in the order of their addresses, on which the
        last bits of contacts would depend. So it gets all of them again, in the order of the skeletons.
        """
        # The filter refers to shapes, which must not be when they are removed.
        self._collision_filter.refresh_shapes()
        for skeleton in self._skeletons:
            self._world.removeSkeleton(skeleton)
        # The last contacts refer to what the detector had.
        self._world.getConstraintSolver().clearLastCollisionResult()
        yield
        for skeleton in self._skeletons:
            self._world.addSkeleton(skeleton)

    def _clear_contact_cache(self) -> None:
        """Make the collision detector recompute all contacts in the next physics step.

        It does so by itself whenever a body is created anywhere in the process: when another scene is reset,
        for example. Contacts kept for longer than a control step would make the last bits depend on that.
        """
        if not self.robots:
            return
        # Any change of the filter has this effect; a body never collides with itself anyway.
        base = self.robots[0].skeleton.getBodyNode(0)
        self._engine_filter.addBodyNodePairToBlackList(base, base)

    def step_passive(self, count: int) -> None:
        self._advance(count, {}, ())

    def _advance(self, count: int, forces: Mapping[int, Sequence[float]], exposed: Sequence[bool]) -> None:
        self._clear_contact_cache()
        robots, world = self.robots, self._world
        advance = world.step
        before_each = [call for robot in robots for call in robot.before_physics_steps()]
        after_each = [call for robot in robots for call in robot.after_physics_steps()]
        pushes = [(robots[index], force) for index, force in forces.items()]
        watched = [index for index, is_exposed in enumerate(exposed) if is_exposed]
        for robot in robots:
            robot.mark_moved()
        for _ in range(count):
            for robot, force in pushes:
                robot.act_force(force)
            for before in before_each:
                before()
            # False: joints keep their commands.
            advance(False)
            for after in after_each:
                after()
            if watched:
                result = world.getLastCollisionResult()
                for index in watched:
                    robots[index].touched |= self._collision_filter.contacts(index, result)
            if self._checks_corners_each_step:
                self._add_corners()
        for robot, _ in pushes:
            robot.clear_force()

    def _add_corners(self) -> None:
        corners = self._corners
        if not corners.has_boxes_left:
            return
        boxes = corners.find_touching(self._world.getLastCollisionResult())
        if boxes:
            with self._changed_shapes():
                corners.add_to(boxes)

    def close(self) -> None:
        # The engine frees its memory with the last reference to the world.
        self._world = None
        for robot in self.robots:
            robot.release()


def _cone_solver(sweeps: int) -> Any:
    options = dartpy.constraint.NsgsFrictionSolver.Options()
    options.maxSweeps, options.tolerance = sweeps, _CONE_TOLERANCE
    return dartpy.constraint.NsgsFrictionSolver(options)
