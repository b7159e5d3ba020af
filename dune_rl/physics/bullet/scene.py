"""The PyBullet backend."""

import weakref
from collections.abc import Mapping, Sequence
from dataclasses import replace

from dune_rl.core.errors import PhysicsError
from dune_rl.geometry.arrays import Array
from dune_rl.physics.bullet.client import (
    create_mesh_shape,
    open_client,
    pybullet,
    release_client,
    release_mesh_lists,
)
from dune_rl.physics.bullet.kinematics import BulletKinematics
from dune_rl.physics.bullet.loading import GEAR_ITERATIONS, GROUND, HULL, OBSTACLE, WHEEL
from dune_rl.physics.bullet.robot import ANY_BODY, BulletRobot
from dune_rl.physics.contact_gate import ContactGate, TyreActivation
from dune_rl.physics.engine_robot import take_forces
from dune_rl.physics.interface import SceneSpec
from dune_rl.physics.shapes import StaticBody, mesh_pieces

# Limits of a mesh in PyBullet's wheel (B3_MAX_NUM_VERTICES, B3_MAX_NUM_INDICES).
_MOST_VERTICES, _MOST_FACES = 131_072, 524_288 // 3

# With more bodies than these one question about all is faster than one about each.
_FEW_BODIES = 4


class BulletScene:
    """`PhysicsScene` in a PyBullet client of its own, in DIRECT mode."""

    def __init__(self, spec: SceneSpec) -> None:
        if not pybullet.isNumpyEnabled():
            raise PhysicsError(
                "this PyBullet was built without NumPy; install the wheel: pip install pybullet"
            )
        if spec.friction != "pyramid":
            raise PhysicsError(
                "PyBullet's friction cone turns robots at rates that depend on their heading; "
                "take physics.friction=pyramid, or physics=dart"
            )
        self._spec = spec
        client = open_client()
        self._client: int | None = client
        # PyBullet keeps the memory of a client until it is disconnected.
        self._release_client = weakref.finalize(self, release_client, client)
        self._release_client.atexit = False
        iterations = spec.solver_iterations
        if any(robot.couplings for robot in spec.robots):
            iterations = max(iterations, GEAR_ITERATIONS)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=spec.timestep_s,
            numSolverIterations=iterations,
            # Both are needed for bit-identical runs: pairs in a fixed order, no mesh of another world.
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
            # The cone, which is the default, makes skid-steer turn at a rate that depends on the heading.
            enableConeFriction=0,
            physicsClientId=self._client,
        )
        pybullet.setGravity(0.0, 0.0, -spec.gravity_mps2, physicsClientId=self._client)
        self._body_numbers: dict[int, int] = {}
        self._static_handles: list[list[int]] = [[] for _ in spec.statics]
        for number, body in enumerate(spec.statics):
            for vertices, faces in mesh_pieces(body.vertices, body.faces, _MOST_VERTICES, _MOST_FACES):
                handle = self._add_static(client, replace(body, vertices=vertices, faces=faces))
                self._static_handles[number].append(handle)
                if not body.ground:
                    self._body_numbers[handle] = number
        self._kinematics = BulletKinematics(self._client, spec.kinematics, OBSTACLE, HULL)
        for index, handle in enumerate(self._kinematics.handles):
            self._body_numbers[handle] = spec.kinematic_number(index)
        self._gate = ContactGate(spec.statics, spec.kinematics, spec.robots)
        self._tyres = TyreActivation(len(spec.robots))
        # The mask of a lone robot has no HULL: it is part of what makes runs bit-identical over versions.
        hull_mask = GROUND | OBSTACLE | (HULL if len(spec.robots) > 1 else 0)
        self.robots = [
            BulletRobot(
                self._client,
                robot,
                spec.timestep_s,
                self._body_numbers,
                hull_mask,
                measures_work=spec.measures_work,
            )
            for robot in spec.robots
        ]
        self._loaded: list[int] = []
        # Physics steps, robots that can touch anything with handles of what, and external forces by robot.
        self._begun: tuple[int, Sequence[tuple[BulletRobot, Sequence[int]]], Mapping[int, Sequence[float]]]
        self._begun = 0, (), {}
        # What every physics step needs, so that its loops do not search the robots for it.
        motors = [robot.motors for robot in self.robots]
        self._stepwise_motors = [each for each in motors if not each.are_ideal]
        self._measured_motors = [each for each in motors if each.measures_work]

    def _add_static(self, client: int, body: StaticBody) -> int:
        shape = create_mesh_shape(body.vertices, body.faces, client)
        if shape < 0:
            raise PhysicsError(f"PyBullet refused the mesh of {body.name!r} ({len(body.faces)} faces)")
        handle: int = pybullet.createMultiBody(0.0, shape, physicsClientId=self._client)
        group = GROUND if body.ground else OBSTACLE
        mask = WHEEL | HULL if body.ground else HULL
        pybullet.setCollisionFilterGroupMask(handle, -1, group, mask, physicsClientId=self._client)
        pybullet.changeDynamics(
            handle,
            -1,
            lateralFriction=body.friction,
            restitution=body.restitution,
            physicsClientId=self._client,
        )
        return handle

    def reset(self, kinematic_poses: Array) -> None:
        release_mesh_lists()
        # Setting poses and speeds back would keep the solver's warm-start
        # impulses (bullet3 #2442): a robot loaded anew has none.
        for handle, robot in zip(self._loaded, self.robots, strict=False):
            robot.remove()
            self._body_numbers.pop(handle, None)
        self._tyres.reset()
        self._loaded = [robot.load() for robot in self.robots]
        for index, handle in enumerate(self._loaded):
            self._body_numbers[handle] = self._spec.robot_number(index)
        self._kinematics.reset(kinematic_poses)

    def move_kinematic(self, index: int, pose: Array) -> None:
        self._kinematics.place(index, pose)

    def begin_step(self, count: int, kinematic_poses: Array) -> None:
        robots = self.robots
        forces = take_forces(robots)
        duration_s = count * self._spec.timestep_s
        gate = self._gate
        near, exposed = gate.find_contacts(
            robots, duration_s, forces, self._kinematics.poses, kinematic_poses
        )
        for index in self._tyres.update(gate.needed_tyres):
            self._reload(index)
        for robot in robots:
            robot.begin_step(count)
        self._kinematics.begin_step(kinematic_poses, near)
        watched = [
            (robot, self._touchable(index, near))
            for index, (robot, is_exposed) in enumerate(zip(robots, exposed, strict=True))
            if is_exposed
        ]
        self._begun = count, watched, forces

    def finish_step(self) -> None:
        count, watched, forces = self._begun
        if watched or forces:
            self._step_watching(count, watched, forces)
        else:
            for _ in range(count):
                self._advance()
        for robot in self.robots:
            robot.end_step()
        self._kinematics.end_step()

    def _step_watching(
        self,
        substeps: int,
        watched: Sequence[tuple[BulletRobot, Sequence[int]]],
        forces: Mapping[int, Sequence[float]],
    ) -> None:
        """Advance by a control step and read the contacts of the watched robots after each physics step."""
        robots, kinematics = self.robots, self._kinematics
        for substep in range(1, substeps + 1):
            kinematics.move(substep / substeps)
            for index, force in forces.items():
                robots[index].act_force(force)
            self._advance()
            for robot, handles in watched:
                contacts = robot.record_contacts(handles)
                if contacts and kinematics.moves_any:
                    kinematics.record_contacts(contacts, robot)
            if kinematics.are_pushing:
                kinematics.yield_to_robots(1 / substeps, self._spec.timestep_s)

    def _touchable(self, robot: int, near: Sequence[int]) -> list[int]:
        """Handles of all bodies that a robot can touch in this control step, or that of any body.

        `near` are the kinematic bodies that robots can touch.
        """
        if len(self.robots) > 1:
            return [ANY_BODY]
        handles = [self._kinematics.handles[index] for index in near]
        for number in self._gate.statics_near(robot):
            handles += self._static_handles[number]
        return handles if len(handles) <= _FEW_BODIES else [ANY_BODY]

    def held_back_poses(self) -> Array | None:
        kinematics = self._kinematics
        return kinematics.poses.copy() if kinematics.any_held_back else None

    def _reload(self, index: int) -> None:
        """Give a robot the tyres that are active."""
        del self._body_numbers[self._loaded[index]]
        self._loaded[index] = handle = self.robots[index].reload(self._tyres.active[index])
        self._body_numbers[handle] = self._spec.robot_number(index)

    def step_passive(self, count: int) -> None:
        for _ in range(count):
            self._advance()
        for robot in self.robots:
            robot.mark_moved()

    def _advance(self) -> None:
        """Advance by a physics step."""
        for motors in self._stepwise_motors:
            motors.command_step()
        pybullet.stepSimulation(self._client)
        for motors in self._measured_motors:
            motors.add_work()

    def close(self) -> None:
        self._release_client()
        for robot in self.robots:
            robot.release()
        self._client = None
