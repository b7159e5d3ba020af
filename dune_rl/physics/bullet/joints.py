"""Passive joints, start angles and couplings of a robot in PyBullet."""

from dune_rl.physics.bullet.body import LoadedBody
from dune_rl.physics.process import suppress_stderr
from dune_rl.physics.robot_body import Coupling, RobotBody

with suppress_stderr():
    import pybullet

# The force limit of a coupling is never reached. Its position error falls by the share _GEAR_ERP a second:
# above 10 it starts to oscillate. With 10 iterations Leo's rockers, on stones, have errors up to 1.2e-3 rad,
# with 20 half of that.
_GEAR_FORCE, _GEAR_ERP, GEAR_ITERATIONS = 1e4, 5.0, 20


def set_up_joints(body: LoadedBody, spec: RobotBody) -> None:
    """Disable PyBullet's default motors of passive joints, set start angles, and add couplings."""
    robot, client = body.handle, body.client
    friction = {body.joints[joint.joint]: joint.friction_nm for joint in spec.passive}
    for joint in body.movable:
        if joint not in body.drive_joints:
            pybullet.setJointMotorControl2(
                robot,
                joint,
                pybullet.VELOCITY_CONTROL,
                targetVelocity=0.0,
                force=friction.get(joint, 0.0),
                physicsClientId=client,
            )
    for passive in spec.passive:
        pybullet.changeDynamics(
            robot,
            body.joints[passive.joint],
            jointDamping=passive.damping_nms_per_rad,
            physicsClientId=client,
        )
    for motor in spec.motors:
        if motor.rest_rad:
            pybullet.resetJointState(robot, body.joints[motor.joint], motor.rest_rad, physicsClientId=client)
    for coupling in spec.couplings:
        _add_coupling(body, coupling)


def _add_coupling(body: LoadedBody, coupling: Coupling) -> None:
    gear = pybullet.createConstraint(
        body.handle,
        body.joints[coupling.leader],
        body.handle,
        body.joints[coupling.follower],
        pybullet.JOINT_GEAR,
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
        physicsClientId=body.client,
    )
    # Bullet's constraint: leader speed + gearRatio * follower speed = 0.
    ratio = -1.0 / coupling.ratio
    pybullet.changeConstraint(
        gear, gearRatio=ratio, maxForce=_GEAR_FORCE, erp=_GEAR_ERP, physicsClientId=body.client
    )
