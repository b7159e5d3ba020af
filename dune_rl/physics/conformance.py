"""Conformance check of a physics engine: the rules of `PhysicsScene` that hold for every engine."""

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import trimesh

from dune_rl.core.errors import PhysicsError
from dune_rl.core.registry import missing_members
from dune_rl.geometry.arrays import Array
from dune_rl.physics.interface import PhysicsRobot, PhysicsScene, SceneSpec, step_scene
from dune_rl.physics.motors import Motor
from dune_rl.physics.robot_body import AS_DESCRIBED, RobotBody
from dune_rl.physics.shapes import KinematicCapsule, StaticBody

_TIMESTEP_S, _SUBSTEPS = 0.005, 10
_RADIUS_M, _SPEED_RADPS = 0.1, 5.0
_WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
_ASIDE = np.array([[5.0, 5.0, 0.0, 0.0, 0.0, 0.0]])
_START = (0.0, 0.0, _RADIUS_M + 0.002)
_PARKED = (-5.0, 5.0, _RADIUS_M + 0.002)
# Ahead of the start, a robot drives into the post. Body numbers: ground, post, walker, robot, another robot.
_POST_M, _POST, _WALKER, _OTHER = 3.0, 1, 2, 4
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def check_engine(make_scene: Callable[[SceneSpec], PhysicsScene]) -> None:
    """Build a scene of two robots with four wheels, a post and a walker on level ground, and drive in it.

    Raises `PhysicsError` for the first rule of `PhysicsScene` or `PhysicsRobot` that does not hold. How exact
    the engine's physics is, is not checked.
    """
    with tempfile.TemporaryDirectory() as folder:
        scene = make_scene(_scene_spec(Path(folder)))
        _require_members(PhysicsScene, scene)
        _require(len(scene.robots) == 2, "`robots` has the robots of `SceneSpec.robots`")
        robot, other = scene.robots
        other.set_start_pose(_PARKED, _UPRIGHT)
        _require_members(PhysicsRobot, robot)
        _require(
            robot.joint_angles(["front_left"]) == (0.0,), "`joint_angles` are 0 before the first `reset`"
        )
        _check_start(scene, robot)
        first = _drive(scene, robot)
        _require(scene.robots[0] is robot, "`robots` stay the same objects over `reset`")
        _require(_drive(scene, robot) == first, "the same calls after `reset` give the same bytes")
        _check_contacts(scene, robot, other)
        _check_other_calls(scene, robot)
        scene.close()
        scene.close()
        _require(robot.joint_angles(["front_left"]) == (0.0,), "`joint_angles` are 0 after `close`")


def _check_start(scene: PhysicsScene, robot: PhysicsRobot) -> None:
    robot.set_start_pose(_START, _UPRIGHT)
    scene.reset(_ASIDE)
    state = np.array(robot.body_state())
    _require(state.shape == (13,), "`body_state` has 13 numbers")
    _require(
        np.allclose(state[:7], [*_START, *_UPRIGHT], atol=1e-6), "`reset` puts robots at their start pose"
    )
    _require(np.allclose(state[7:], 0.0), "`reset` puts robots at rest")
    drive = np.array(robot.drive_state())
    _require(drive.shape == (12,), "`drive_state` has angles, speeds and torques of all motors")
    _require(np.allclose(drive[:8], 0.0), "angles and speeds of the motors are 0 after `reset`")
    _require(list(robot.contacts()) == [], "`contacts` are empty after `reset`")


def _drive(scene: PhysicsScene, robot: PhysicsRobot) -> bytes:
    """The bytes of a drive straight ahead, from a reset on."""
    robot.set_start_pose(_START, _UPRIGHT)
    scene.reset(_ASIDE)
    robot.set_command([_SPEED_RADPS] * 4)
    rows: list[Sequence[float]] = []
    for _ in range(20):
        step_scene(scene, _SUBSTEPS, _ASIDE)
        rows.append((*robot.body_state(), *robot.drive_state()))
    states: Array = np.array(rows)
    _require(bool(np.isfinite(states).all()), "states are finite")
    _require(np.allclose(np.linalg.norm(states[:, 3:7], axis=1), 1.0), "quaternions have length 1")
    _require(states[-1, 0] > 0.05, "wheels that turn forward at 5 rad/s move the robot along its x axis")
    _require(bool((states[-1, 13:17] > 0.5).all()), "motors turn at the commanded speed")
    _require(scene.held_back_poses() is None, "`held_back_poses` is None where no robot is near a body")
    _require(list(robot.contacts()) == [], "ground is not among the `contacts`")
    return states.tobytes()


def _check_contacts(scene: PhysicsScene, robot: PhysicsRobot, other: PhysicsRobot) -> None:
    """Drive into each kind of body, whose number is told."""
    ahead = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    for name, number, x, walker, parked in (
        ("a static body", _POST, _POST_M - 0.5, _ASIDE, _PARKED),
        ("a kinematic body", _WALKER, 0.0, ahead, _PARKED),
        ("a robot", _OTHER, 0.0, _ASIDE, (1.0, *_START[1:])),
    ):
        robot.set_start_pose((x, *_START[1:]), _UPRIGHT)
        other.set_start_pose(parked, _UPRIGHT)
        scene.reset(walker)
        robot.set_command([_SPEED_RADPS] * 4)
        touched: list[int] = []
        for _ in range(60):
            step_scene(scene, _SUBSTEPS, walker)
            touched = list(robot.contacts())
            if touched:
                break
        _require(touched == [number], f"`contacts` has the number of {name} that a robot drives into")
    other.set_start_pose(_PARKED, _UPRIGHT)


def _check_other_calls(scene: PhysicsScene, robot: PhysicsRobot) -> None:
    robot.set_wheel_contacts([0.8] * 4, [0.0] * 4)
    robot.apply_force([1.0, 0.0, 0.0])
    scene.move_kinematic(0, _ASIDE[0] + 0.1)
    step_scene(scene, _SUBSTEPS, _ASIDE)
    scene.step_passive(_SUBSTEPS)
    _require(np.isfinite(robot.body_state()).all(), "states are finite after `step_passive`")
    _require(np.isfinite(robot.work_j()), "`work_j` is finite")
    _require(len(robot.joint_angles(_WHEELS)) == 4, "`joint_angles` has an angle for each name")
    robot.set_body(AS_DESCRIBED)
    scene.reset(_ASIDE)
    _require(robot.drive_state()[:4] == (0.0,) * 4, "`reset` sets the angles of wheels to 0")


def _scene_spec(folder: Path) -> SceneSpec:
    corners = np.array([[-20.0, -20.0, 0.0], [20.0, -20.0, 0.0], [20.0, 20.0, 0.0], [-20.0, 20.0, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    post = trimesh.creation.box((0.2, 0.6, 1.0))
    post.apply_translation((_POST_M, 0.0, 0.5))
    urdf = folder / "robot.urdf"
    urdf.write_text(_urdf())
    robot = RobotBody(
        urdf=urdf,
        motors=tuple(Motor(wheel, 5.0) for wheel in _WHEELS),
        ground_links=tuple(f"{wheel}_link" for wheel in _WHEELS),
        ground_friction=1.0,
    )
    return SceneSpec(
        statics=(
            StaticBody("ground", corners, faces, 1.0, ground=True),
            StaticBody(
                "post", np.asarray(post.vertices), np.asarray(post.faces, np.int32), 1.0, ground=False
            ),
        ),
        kinematics=(KinematicCapsule("walker", 0.3, 1.8),),
        robots=(robot, robot),
        timestep_s=_TIMESTEP_S,
        solver_iterations=10,
        measures_work=True,
    )


def _urdf() -> str:
    """A box of 10 kg on four wheels."""
    sizes = '<inertia ixx="{0}" iyy="{0}" izz="{0}" ixy="0" ixz="0" iyz="0"/>'
    body = (
        f'<link name="base"><inertial><mass value="10"/>{sizes.format(0.2)}</inertial>'
        '<collision><geometry><box size="0.5 0.3 0.1"/></geometry></collision></link>'
    )
    places = [(x, y) for x in (0.2, -0.2) for y in (0.2, -0.2)]
    wheels = [
        f'<link name="{name}_link"><inertial><mass value="0.5"/>{sizes.format(0.003)}</inertial>'
        f'<collision><geometry><sphere radius="{_RADIUS_M}"/></geometry></collision></link>'
        f'<joint name="{name}" type="continuous"><parent link="base"/><child link="{name}_link"/>'
        f'<origin xyz="{x} {y} 0"/><axis xyz="0 1 0"/></joint>'
        for name, (x, y) in zip(_WHEELS, places, strict=True)
    ]
    return f'<robot name="robot">{body}{"".join(wheels)}</robot>'


def _require_members(protocol: type, value: object) -> None:
    missing = missing_members(protocol, value) or []
    _require(not missing, f"a {protocol.__name__} has {', '.join(missing)}")


def _require(holds: object, rule: str) -> None:
    if not holds:
        raise PhysicsError(f"the engine does not conform: {rule}")
