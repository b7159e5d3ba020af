"""Sizes and outlines: they contain every collision shape of a robot, wheels and legs in motion included."""

from types import SimpleNamespace

import numpy as np
import pybullet
import pytest
from scenes import STEP_S

from dune_rl.geometry.frames import wrap_angle
from dune_rl.robots.hyperdog import HyperDog, HyperDogConf
from dune_rl.robots.leo_rover import LeoRover, LeoRoverConf
from dune_rl.robots.robot import Robot
from dune_rl.robots.rover_zero import RoverZero, RoverZeroConf

ROVERS = [lambda: RoverZero(RoverZeroConf(), 1), lambda: LeoRover(LeoRoverConf(), 1)]
# Actions and the yaw rates [rad/s] that they end in.
TWISTS = [(0.4, 0.0, 0.0), (-0.4, 0.0, 0.0), (0.0, 1.5, 1.0), (0.3, 1.5, 1.0)]


def shape_extent(robot: Robot, joint_angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest x and y (2,) [m], in the body frame, of the collision shapes and of the tyres.

    Spheres that stand for wheels on the ground do not count where tyres meet everything else.
    """
    client = pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(str(robot.body.urdf), physicsClientId=client)
    infos = [
        pybullet.getJointInfo(body, index, physicsClientId=client)
        for index in range(pybullet.getNumJoints(body, physicsClientId=client))
    ]
    for info in infos:
        if info[1].decode() in robot.body.drive_joints:
            angle = joint_angles[robot.body.drive_joints.index(info[1].decode())]
            pybullet.resetJointState(body, info[0], angle, physicsClientId=client)
    points = [tyre_corners(tyre) for tyre in robot.body.tyres]
    wheels = {tyre.link for tyre in robot.body.tyres}
    for link, name in [(-1, ""), *((info[0], info[12].decode()) for info in infos)]:
        if name not in wheels:
            points += [shape_points(client, body, link, shape) for shape in shapes_of(client, body, link)]
    pybullet.disconnect(client)
    every = np.concatenate(points)
    return every.min(axis=0)[:2], every.max(axis=0)[:2]


def shapes_of(client: int, body: int, link: int) -> list[tuple]:
    return list(pybullet.getCollisionShapeData(body, link, physicsClientId=client))


def shape_points(client: int, body: int, link: int, shape: tuple) -> np.ndarray:
    if link == -1:
        pose = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
    else:
        pose = pybullet.getLinkState(body, link, computeForwardKinematics=True, physicsClientId=client)[:2]
    kind, size, local, turn = shape[2], np.array(shape[3]), shape[5], shape[6]
    centre, rotation = pybullet.multiplyTransforms(*pose, local, turn)
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    if kind == pybullet.GEOM_SPHERE:
        return np.array(centre) + signs * size[0]
    assert kind == pybullet.GEOM_BOX
    rotation_matrix = np.reshape(pybullet.getMatrixFromQuaternion(rotation), (3, 3))
    return np.array(centre) + (signs * size / 2) @ rotation_matrix.T


def tyre_corners(tyre) -> np.ndarray:
    half = [tyre.radius_m, tyre.width_m / 2, tyre.radius_m]
    return np.array([np.array(tyre.position_b) + np.array(half) * sign for sign in (-1, 1)])


@pytest.mark.parametrize("make", ROVERS)
def test_the_size_is_that_of_hull_and_wheels(make):
    robot = make()
    low, high = shape_extent(robot, np.zeros(4))
    half = np.array([robot.description.length_m, robot.description.width_m]) / 2
    reach = np.maximum(-low, high)
    assert (reach <= half + 1e-9).all()
    # A hub's flange is wider than the tyre.
    np.testing.assert_allclose(reach, half, atol=0.012)


@pytest.mark.slow
def test_the_size_of_a_dog_is_that_of_its_legs_at_full_stride():
    reach = np.zeros(2)
    for speed, heading, yaw_rate in TWISTS:
        dog = HyperDog(HyperDogConf(), 1)
        rates = np.minimum(yaw_rate, 0.1 * np.arange(1, 81))
        for rate, yaw in zip(rates, np.cumsum(rates) * STEP_S, strict=True):
            motion = SimpleNamespace(
                velocity_b=np.array([[speed, 0.0, 0.0]]),
                angular_b=np.array([[0.0, 0.0, rate]]),
                roll_pitch_yaw=np.array([[0.0, 0.0, wrap_angle(yaw)]]),
            )
            angles = dog.commands(np.array([[speed, heading]]), motion, STEP_S)[0]
            low, high = shape_extent(dog, angles)
            reach = np.maximum(reach, np.maximum(-low, high))
    half = np.array([dog.description.length_m, dog.description.width_m]) / 2
    assert (reach <= half).all(), reach
    np.testing.assert_allclose(reach, half, atol=0.02)


@pytest.mark.parametrize("make", [*ROVERS, lambda: HyperDog(HyperDogConf(), 1)])
def test_the_outline_runs_round_the_whole_robot(make):
    robot = make()
    outline = robot.description.outline()
    half = [robot.description.length_m / 2, robot.description.width_m / 2]
    np.testing.assert_allclose(np.abs(outline).max(axis=0), half)
    assert np.isclose(np.abs(outline), half).any(axis=1).all()
    # Thin posts of 0.1 m must not fit between neighbours unseen by more than a few centimetres.
    bearing = np.arctan2(outline[:, 1], outline[:, 0])
    around = outline[np.argsort(bearing)]
    assert np.hypot(*(around - np.roll(around, 1, axis=0)).T).max() < 0.16
    assert np.hypot(*outline.T).max() <= robot.description.footprint_radius_m + 1e-9
