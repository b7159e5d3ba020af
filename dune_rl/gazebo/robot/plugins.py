"""Systems of Gazebo that drive a robot's joints, and report where they are."""

from xml.etree.ElementTree import Element

import numpy as np

from dune_rl.gazebo.elements import add, make_system, words
from dune_rl.physics.motors import Motor
from dune_rl.robots.robot import Robot, RobotDescription, WheelLayout

_ODOMETRY_HZ = 20


def make_plugins(robot: Robot) -> list[Element]:
    """Systems that publish the joints' states and drive them.

    Wheels that skid have a differential drive, and all other motors a controller each.
    """
    description, motors = robot.description, robot.body.motors
    wheels = description.wheels
    states = make_system("JointStatePublisher", "joint-state-publisher")
    if wheels is not None and wheels.steering is None:
        return [_differential_drive(description, wheels, motors), states]
    return [*(_controller(motor) for motor in motors), states]


def _differential_drive(
    description: RobotDescription, wheels: WheelLayout, motors: tuple[Motor, ...]
) -> Element:
    element = make_system("DiffDrive", "diff-drive")
    for tag, side in (("left_joint", wheels.left), ("right_joint", wheels.right)):
        for index in side:
            add(element, tag, motors[index].joint)
    add(element, "wheel_separation", words([wheels.track_m]))
    add(element, "wheel_radius", words([wheels.radius_m]))
    limits = (
        ("linear_velocity", description.max_speed_mps),
        ("linear_acceleration", description.max_acceleration_mps2),
        ("angular_velocity", description.max_yaw_rate_radps),
        ("angular_acceleration", description.max_yaw_acceleration_radps2),
    )
    for tag, limit in limits:
        if np.isfinite(limit):
            add(element, f"max_{tag}", words([limit]))
            add(element, f"min_{tag}", words([-limit]))
    add(element, "odom_publish_frequency", _ODOMETRY_HZ)
    add(element, "frame_id", "odom")
    add(element, "child_frame_id", "base_link")
    return element


def _controller(motor: Motor) -> Element:
    """A controller of a joint's speed or angle, which begins with the motor's command at rest."""
    if motor.mode == "velocity":
        element = make_system("JointController", "joint-controller")
        add(element, "joint_name", motor.joint)
        add(element, "initial_velocity", words([motor.rest_command]))
        return element
    element = make_system("JointPositionController", "joint-position-controller")
    add(element, "joint_name", motor.joint)
    add(element, "initial_position", words([motor.rest_command]))
    add(element, "use_velocity_commands", True)
    add(element, "p_gain", words([motor.position_gain_per_s]))
    speed = min(motor.max_speed_radps, motor.no_load_speed_radps)
    if np.isfinite(speed):
        add(element, "cmd_max", words([speed]))
        add(element, "cmd_min", words([-speed]))
    return element
