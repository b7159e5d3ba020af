"""Collision filters and friction of a robot's links in PyBullet."""

from collections.abc import Sequence

from dune_rl.physics.bullet.body import LoadedBody
from dune_rl.physics.bullet.tyres import TYRE_AXIS
from dune_rl.physics.process import suppress_stderr
from dune_rl.physics.robot_body import RobotBody

with suppress_stderr():
    import pybullet

# Collision groups. WHEEL is for wheels that collide with the ground only: spheres, which are wider than their
# tyres. TYRE is for these, which collide with everything else. PyBullet lets two links collide if the group
# of one is in the mask of the other, either way.
GROUND, WHEEL, HULL, OBSTACLE, TYRE = 1, 2, 4, 8, 16


def set_up_links(body: LoadedBody, spec: RobotBody, hull_mask: int) -> None:
    """Set the contact parameters and collision filters of all links of a loaded robot, and its damping.

    `hull_mask` has the collision groups that the hull collides with.
    """
    for link in range(-1, len(body.links) - 1):
        _set_up_link(body, spec, hull_mask, link)
    # In a call of its own: together with one of these, PyBullet applies a link's friction to the base.
    pybullet.changeDynamics(
        body.handle,
        -1,
        linearDamping=0.0,
        angularDamping=0.0,
        activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
        physicsClientId=body.client,
    )


def _set_up_link(body: LoadedBody, spec: RobotBody, hull_mask: int, link: int) -> None:
    axle: Sequence[float] | None = None
    if link in body.tyre_links:
        # Other robots have tyres, too.
        mask = hull_mask & ~GROUND | (TYRE if hull_mask & HULL else 0)
        group, friction, axle = TYRE, spec.ground_friction, TYRE_AXIS
    elif link in body.ground_links:
        collides = spec.ground_links_meet_obstacles
        group, mask = (HULL, hull_mask) if collides else (WHEEL, GROUND)
        friction, axle = spec.ground_friction, body.axes.get(link)
    else:
        group, mask, friction = HULL, hull_mask, spec.hull_friction
    pybullet.setCollisionFilterGroupMask(body.handle, link, group, mask, physicsClientId=body.client)
    pybullet.changeDynamics(
        body.handle,
        link,
        lateralFriction=friction,
        restitution=0.0,
        jointDamping=0.0,
        physicsClientId=body.client,
    )
    if axle is not None and spec.sideways_friction_share != 1.0:
        less = 1.0 - spec.sideways_friction_share
        pybullet.changeDynamics(
            body.handle,
            link,
            anisotropicFriction=[1.0 - less * abs(part) for part in axle],
            physicsClientId=body.client,
        )
