"""A robot as a model of Gazebo: SDF and URDF, with meshes, sensors and the systems that drive it."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Comment, Element

from dune_rl.core.version import VERSION
from dune_rl.gazebo.elements import SDF_VERSION, add, add_pose, document_text, make_sdf, words
from dune_rl.gazebo.mesh_folder import MeshFolder
from dune_rl.gazebo.robot.bodies import RobotBodies, lowest_point
from dune_rl.gazebo.robot.plugins import make_plugins
from dune_rl.gazebo.robot.sensors import MountedSensor, make_sensors
from dune_rl.gazebo.world import add_friction, add_material, add_surface
from dune_rl.robots.robot import Robot
from dune_rl.robots.urdf.bodies import RigidBody
from dune_rl.robots.urdf.elements import write_inertial, write_joint, write_origin, write_shape
from dune_rl.robots.urdf.model import Geometry, Inertial, Joint
from dune_rl.sensors.settings import SensorSettings

_DIFFERENTIAL = "The rockers' differential is no joint of SDF: the rockers are part of the base."


@dataclass(frozen=True)
class WrittenRobot:
    """A robot's folder `name`: how high [m] its origin is over level ground with all joints at zero, and the
    `others` of its sensors, which Gazebo does not have.
    """

    name: str
    height_m: float
    others: Sequence[str]


def write_robot(
    folder: Path, name: str, robot: Robot, sensors: Mapping[str, SensorSettings], step_s: float
) -> WrittenRobot:
    """Write a robot into the new folder `name` in `folder`; its controller steps every `step_s` [s]."""
    own = folder / name
    own.mkdir()
    bodies = RobotBodies(robot.body, MeshFolder(own))
    mounted, others = make_sensors(sensors, step_s)
    plugins = make_plugins(robot)
    parts = bodies.merge(bodies.coupled)
    model = _make_model(name, bodies, parts, mounted, plugins)
    root = make_sdf()
    root.append(model)
    (own / "model.sdf").write_text(document_text(root), encoding="utf-8")
    urdf = _make_urdf(name, bodies, mounted, plugins)
    (own / f"{name}.urdf").write_text(document_text(urdf), encoding="utf-8")
    (own / "model.config").write_text(document_text(_make_config(name)), encoding="utf-8")
    return WrittenRobot(name, -lowest_point(parts), others)


def _make_config(name: str) -> Element:
    root = Element("model")
    add(root, "name", name)
    add(root, "version", VERSION)
    add(root, "sdf", "model.sdf", version=SDF_VERSION)
    return root


def _make_model(
    name: str,
    bodies: RobotBodies,
    parts: Sequence[RigidBody],
    sensors: Sequence[MountedSensor],
    plugins: Sequence[Element],
) -> Element:
    """The <model>, with coupled joints at zero for good."""
    model = Element("model", name=name, canonical_link=parts[0].name)
    if bodies.coupled:
        model.append(Comment(f" {_DIFFERENTIAL} "))
    for body in parts:
        link = _add_link(model, body, bodies)
        if body.joint is None:
            for sensor in sensors:
                element = deepcopy(sensor.element)
                add_pose(element, sensor.pose[:3, 3], sensor.pose[:3, :3])
                link.append(element)
    for body in parts:
        if body.joint is not None:
            _add_joint(model, body.joint, bodies)
    model.extend(deepcopy(plugin) for plugin in plugins)
    return model


def _add_link(model: Element, body: RigidBody, bodies: RobotBodies) -> Element:
    link = add(model, "link", name=body.name)
    add_pose(link, body.pose_b[:3, 3], body.pose_b[:3, :3])
    _add_inertial(link, body.inertial)
    friction, along_axle = bodies.friction(body.name), bodies.friction_along_axle(body.name)
    for number, (shape, bit) in enumerate(zip(body.shapes, bodies.collision_bits(body), strict=True)):
        collision = _add_shape(link, "collision", number, shape.geometry)
        add_surface(collision, friction, along_axle=along_axle, bit=bit)
    for number, geometry in enumerate(body.visuals):
        visual = _add_shape(link, "visual", number, geometry)
        if geometry.colour is not None:
            red, green, blue = geometry.colour
            add_material(visual, (red, green, blue))
    return link


def _add_inertial(link: Element, inertial: Inertial) -> None:
    element = add(link, "inertial")
    add_pose(element, inertial.centre)
    add(element, "mass", words([inertial.mass]))
    inertia = add(element, "inertia")
    for row, first in enumerate("xyz"):
        for column in range(row, 3):
            add(inertia, f"i{first}{'xyz'[column]}", words([inertial.inertia[row, column]]))


def _add_shape(link: Element, kind: str, number: int, geometry: Geometry) -> Element:
    holder = add(link, kind, name=f"{kind}_{number}")
    add_pose(holder, geometry.pose[:3, 3], geometry.pose[:3, :3])
    shape = add(add(holder, "geometry"), geometry.kind)
    if geometry.mesh is not None:
        add(shape, "uri", geometry.mesh)
    elif geometry.kind == "box":
        add(shape, "size", words(geometry.size))
    else:
        for tag, value in zip(("radius", "length"), geometry.size, strict=False):
            add(shape, tag, words([value]))
    return holder


def _add_joint(model: Element, joint: Joint, bodies: RobotBodies) -> None:
    slides = joint.kind == "prismatic"
    element = add(model, "joint", name=joint.name, type="prismatic" if slides else "revolute")
    add(element, "parent", joint.parent)
    add(element, "child", joint.child)
    axis, dynamics = add(element, "axis"), bodies.dynamics(joint.name)
    add(axis, "xyz", words(joint.axis))
    limit = add(axis, "limit")
    if joint.is_limited:
        for tag, value in zip(("lower", "upper"), joint.limits, strict=True):
            add(limit, tag, words([value]))
    for tag, most in (("effort", dynamics.effort), ("velocity", dynamics.velocity)):
        if most is not None:
            add(limit, tag, words([most]))
    holder = add(axis, "dynamics")
    add(holder, "damping", words([dynamics.damping]))
    add(holder, "friction", words([dynamics.friction]))


def _make_urdf(
    name: str, bodies: RobotBodies, sensors: Sequence[MountedSensor], plugins: Sequence[Element]
) -> Element:
    """The <robot>, with a fixed link for each sensor, and what Gazebo needs beside."""
    root = Element("robot", name=name)
    parts = bodies.merge()
    for body in parts:
        link = add(root, "link", name=body.name)
        write_inertial(link, body.inertial)
        for kind, shapes in (
            ("visual", body.visuals),
            ("collision", [shape.geometry for shape in bodies.solid_shapes(body)]),
        ):
            for geometry in shapes:
                holder = write_shape(link, kind, geometry)
                if geometry.mesh is not None:
                    add(holder, "mesh", filename=f"package://{name}/{geometry.mesh}")
    for body in parts:
        if body.joint is not None:
            _write_joint(root, body.joint, bodies)
    base = parts[0].name
    taken = {body.name for body in parts}
    for sensor in sensors:
        link_name = f"{sensor.name}_link" if f"{sensor.name}_link" not in taken else f"{sensor.name}_sensor"
        add(root, "link", name=link_name)
        joint = add(root, "joint", name=f"{link_name}_joint", type="fixed")
        add(joint, "parent", link=base)
        add(joint, "child", link=link_name)
        write_origin(joint, sensor.pose)
        add(root, "gazebo", reference=link_name).append(deepcopy(sensor.element))
    for body in parts:
        friction, along_axle = bodies.friction(body.name), bodies.friction_along_axle(body.name)
        add_friction(add(root, "gazebo", reference=body.name), "mu1", friction, along_axle)
    gazebo = add(root, "gazebo")
    gazebo.extend(deepcopy(plugin) for plugin in plugins)
    return root


def _write_joint(root: Element, joint: Joint, bodies: RobotBodies) -> None:
    element, dynamics = write_joint(root, joint), bodies.dynamics(joint.name)
    limit = element.find("limit")
    values = {"effort": dynamics.effort, "velocity": dynamics.velocity}
    stated = {name: words([value]) for name, value in values.items() if value is not None}
    if limit is not None:
        limit.attrib.update(stated)
    elif len(stated) == len(values):
        add(element, "limit", **stated)
    add(element, "dynamics", damping=words([dynamics.damping]), friction=words([dynamics.friction]))
    for coupling in bodies.body.couplings:
        if joint.name == coupling.follower:
            add(element, "mimic", joint=coupling.leader, multiplier=words([coupling.ratio]))
