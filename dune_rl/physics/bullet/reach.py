"""Largest extent of a robot in PyBullet."""

import math

from dune_rl.physics.base_frame import Triple
from dune_rl.physics.bullet.body import LoadedBody
from dune_rl.physics.process import suppress_stderr
from dune_rl.physics.robot_body import RobotBody

with suppress_stderr():
    import pybullet


def measure_reach_m(body: LoadedBody, spec: RobotBody) -> float:
    """Upper bound [m] of the distance of any point of a loaded robot from the base's centre of mass.

    Each link adds the distance of its joint from its parent's, whatever the angles of the joints are.
    """
    robot, client = body.handle, body.client
    start, _ = pybullet.getBasePositionAndOrientation(robot, physicsClientId=client)
    joints, distances = {-1: start}, {-1: 0.0}
    reach = _farthest_m(start, *pybullet.getAABB(robot, -1, physicsClientId=client))
    for link in range(pybullet.getNumJoints(robot, physicsClientId=client)):
        info = pybullet.getJointInfo(robot, link, physicsClientId=client)
        position = pybullet.getLinkState(robot, link, physicsClientId=client)[4]
        distance = distances[info[16]] + math.dist(position, joints[info[16]])
        if info[2] == pybullet.JOINT_PRISMATIC:
            low, high = info[8:10]
            distance += max(abs(low), abs(high)) if low <= high else math.inf
        joints[link], distances[link] = position, distance
        box = pybullet.getAABB(robot, link, physicsClientId=client)
        reach = max(reach, distance + _farthest_m(position, *box))
    tyres = (distances[body.links[tyre.link]] + tyre.reach_m for tyre in spec.tyres)
    return max([reach, *tyres])


def _farthest_m(point: Triple, low: Triple, high: Triple) -> float:
    """Distance of the corner of a box that is farthest from a point."""
    return math.hypot(*(max(abs(a - p), abs(b - p)) for p, a, b in zip(point, low, high, strict=True)))
