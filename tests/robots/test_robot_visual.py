"""A robot's links in pictures: where PyBullet has them."""

from pathlib import Path

import numpy as np
import pybullet
import pytest
from scenes import about

from dune_rl.core.errors import RobotError
from dune_rl.geometry.frames import rotation_matrices
from dune_rl.rendering.light import srgb_to_linear
from dune_rl.rendering.moving_mesh import PosedMesh
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf
from dune_rl.robots.visual import RobotVisual

ROVER_URDF = RoverZero(RoverZeroConf(), 1).body.urdf
# Two bent joints in a row, off their links' middles, and every shape that can be drawn.
CRANE = """<?xml version="1.0"?>
<robot name="crane">
  <material name="red"><color rgba="0.8 0.1 0.1 1"/></material>
  <link name="mast">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/><geometry><box size="0.2 0.4 0.6"/></geometry>
      <material name="red"/></visual>
  </link>
  <link name="arm">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><origin xyz="0 0 0.5"/><geometry><cylinder radius="0.1" length="1.0"/></geometry>
      <material name="green"><color rgba="0.1 0.7 0.2 1"/></material></visual>
  </link>
  <link name="hook">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><sphere radius="0.15"/></geometry></visual>
  </link>
  <joint name="elbow" type="revolute">
    <parent link="arm"/><child link="hook"/><origin xyz="0 0.1 1" rpy="0.3 0.2 -0.9"/><axis xyz="0.6 0 0.8"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <joint name="shoulder" type="continuous">
    <parent link="mast"/><child link="arm"/><origin xyz="0.2 0 0.6" rpy="1.1 -0.7 2.0"/><axis xyz="0 1 0"/>
  </joint>
</robot>
"""


@pytest.fixture(params=["rover", "crane"])
def urdf(request, tmp_path: Path) -> Path:
    if request.param == "rover":
        return ROVER_URDF
    path = tmp_path / "crane.urdf"
    path.write_text(CRANE)
    return path


def test_links_are_where_pybullet_has_them(urdf):
    rng = np.random.default_rng(0)
    quaternion = rng.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    position = np.array([1.0, -2.0, 0.5])
    client = pybullet.connect(pybullet.DIRECT)
    try:
        robot = pybullet.loadURDF(str(urdf), position.tolist(), quaternion.tolist(), physicsClientId=client)
        joints, poses = {}, {-1: (position, rotation_matrices(quaternion))}
        for index in range(pybullet.getNumJoints(robot, physicsClientId=client)):
            name = pybullet.getJointInfo(robot, index, physicsClientId=client)[1].decode()
            joints[name] = rng.uniform(-2.0, 2.0)
            pybullet.resetJointState(robot, index, joints[name], physicsClientId=client)
        for index in range(len(joints)):
            state = pybullet.getLinkState(robot, index, computeForwardKinematics=True, physicsClientId=client)
            poses[index] = np.array(state[4]), rotation_matrices(np.array(state[5]))
        shapes = pybullet.getVisualShapeData(robot, physicsClientId=client)
    finally:
        pybullet.disconnect(client)
    found = RobotVisual(urdf).posed_meshes(position, rotation_matrices(quaternion), joints)
    assert len(found) == len(poses)
    for where, turn in poses.values():
        nearest = min(found, key=lambda each: np.linalg.norm(each.position - where))
        np.testing.assert_allclose(nearest.position, where, atol=1e-5)
        np.testing.assert_allclose(nearest.rotation, turn, atol=1e-5)
        link = next(i for i, (at, _) in poses.items() if at is where)
        _same_shape(nearest, [shape for shape in shapes if shape[1] == link])


def _same_shape(drawn: PosedMesh, shapes: list[tuple]) -> None:
    """The drawn link is as large as PyBullet's visual shapes say, in its own frame, and of their colours."""
    if any(shape[2] == pybullet.GEOM_MESH for shape in shapes):
        # PyBullet tells the scale of a mesh, and no size.
        return
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for _, _, kind, size, _, at, turn, _, *_ in shapes:
        half = {
            pybullet.GEOM_BOX: np.array(size) / 2,
            pybullet.GEOM_CYLINDER: np.array([size[1], size[1], size[0] / 2]),
            pybullet.GEOM_SPHERE: np.full(3, size[0]),
        }[kind]
        axes = rotation_matrices(np.array(turn))
        if kind == pybullet.GEOM_BOX:
            reach = np.abs(axes) @ half
        elif kind == pybullet.GEOM_SPHERE:
            reach = half
        else:
            reach = np.hypot(*(np.abs(axes[:, k]) * half[k] for k in (0, 1))) + np.abs(axes[:, 2]) * half[2]
        low, high = np.minimum(low, np.array(at) - reach), np.maximum(high, np.array(at) + reach)
    vertices = drawn.shape.vertices
    # Round things are drawn with flat sides.
    np.testing.assert_allclose(vertices.min(axis=0), low, atol=2e-3)
    np.testing.assert_allclose(vertices.max(axis=0), high, atol=2e-3)
    # What has no colour is grey here and white there.
    colours = {tuple(np.round(srgb_to_linear(np.array(shape[7][:3])), 4)) for shape in shapes}
    drawn_in = {tuple(np.round(colour, 4)) for colour in drawn.shape.albedo.astype(float)}
    if (1.0, 1.0, 1.0) not in colours:
        np.testing.assert_allclose(sorted(drawn_in), sorted(colours), atol=2e-4)


def test_joint_angles_turn_the_wheels_and_nothing_else():
    visual = RobotVisual(ROVER_URDF)
    still = visual.posed_meshes(np.zeros(3), np.eye(3))
    turned_by = visual.posed_meshes(np.zeros(3), np.eye(3), {"front_left_wheel_joint": 0.7})
    moved = [not np.allclose(a.rotation, b.rotation) for a, b in zip(still, turned_by, strict=True)]
    assert sum(moved) == 1
    wheel = turned_by[moved.index(True)]
    np.testing.assert_allclose(wheel.position, [0.1415, 0.18, 0.0], atol=1e-12)
    np.testing.assert_allclose(wheel.rotation, rotation_matrices(about([0, 1, 0], 0.7)), atol=1e-9)
    for one, other in zip(still, turned_by, strict=True):
        np.testing.assert_allclose(one.position, other.position, atol=1e-12)


def test_shapes_that_cannot_be_drawn_are_refused_in_words(tmp_path: Path):
    path = tmp_path / "robot.urdf"
    path.write_text(CRANE.replace('<sphere radius="0.15"/>', '<capsule radius="0.1" length="1"/>'))
    with pytest.raises(
        RobotError, match=r"a <capsule> is no shape of a URDF; use box, cylinder, sphere or mesh"
    ):
        RobotVisual(path)
