"""A robot as rigid bodies with the shapes, frictions and joints that Gazebo gets."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from dune_rl.gazebo.mesh_folder import MeshFolder
from dune_rl.gazebo.painted_mesh import paint_mesh
from dune_rl.gazebo.world import GROUND_BIT, OBSTACLE_BIT
from dune_rl.geometry.arrays import Array
from dune_rl.physics.robot_body import RobotBody, Tyre
from dune_rl.robots.urdf.bodies import ConvexShape, RigidBody, merge_links
from dune_rl.robots.urdf.meshes import UrdfMeshes
from dune_rl.robots.urdf.model import Geometry, UrdfModel
from dune_rl.robots.urdf.reader import read_urdf


@dataclass(frozen=True)
class JointDynamics:
    """Largest torque [N·m] and speed [rad/s] of a joint's motor, and the joint's friction and damping.

    Without a motor, or a limit of it, they are None.
    """

    effort: float | None
    velocity: float | None
    friction: float
    damping: float


class RobotBodies:
    """The bodies of `body`, whose meshes are written into `meshes`; they collide as their convex hulls."""

    def __init__(self, body: RobotBody, meshes: MeshFolder) -> None:
        self.body = body
        model = read_urdf(body.urdf)
        if body.look is not None:
            look = read_urdf(body.look).links
            links = {
                name: replace(link, visuals=look[name].visuals if name in look else ())
                for name, link in model.links.items()
            }
            model = replace(model, links=links)
        self.model: UrdfModel = model
        self._sources, self._meshes = UrdfMeshes(model.path), meshes
        self._written: dict[object, Geometry] = {}
        self._tyres = {tyre.link: tyre for tyre in body.tyres}
        self._motors = {motor.joint: motor for motor in body.motors}
        self._passive = {joint.joint: joint for joint in body.passive}
        self.coupled = {joint for each in body.couplings for joint in (each.leader, each.follower)}

    def merge(self, fixed: Collection[str] = ()) -> list[RigidBody]:
        """The bodies, the base first, with joints called in `fixed` at zero for good.

        The last shape of a wheel that has a tyre is its tyre: see `RobotBody`.
        """
        moving = [
            name for name, joint in self.model.joints.items() if joint.kind != "fixed" and name not in fixed
        ]
        return [self._export_body(each) for each in merge_links(self.model, moving, self._sources)]

    def solid_shapes(self, body: RigidBody) -> tuple[ConvexShape, ...]:
        """The shapes of a body that are as wide as it is: of a wheel that has a tyre, that alone."""
        return body.shapes[-1:] if body.name in self._tyres else body.shapes

    def collision_bits(self, body: RigidBody) -> Sequence[int | None]:
        """What each shape of a body collides with: the ground, all but the ground, or everything (None)."""
        if body.name in self._tyres:
            return [GROUND_BIT] * (len(body.shapes) - 1) + [OBSTACLE_BIT]
        rolls = body.name in self.body.ground_links and not self.body.ground_links_meet_obstacles
        return [GROUND_BIT if rolls else None] * len(body.shapes)

    def friction(self, link: str) -> float:
        """The friction coefficient of a link."""
        return self.body.ground_friction if link in self.body.ground_links else self.body.hull_friction

    def friction_along_axle(self, link: str) -> float | None:
        """That of a wheel along its axle, where it differs from the friction in the other direction."""
        share = self.body.sideways_friction_share
        return self.friction(link) * share if link in self.body.ground_links and share != 1.0 else None

    def dynamics(self, joint: str) -> JointDynamics:
        """What drives and brakes a joint."""
        if joint in self._motors:
            motor = self._motors[joint]
            speed = min(motor.max_speed_radps, motor.no_load_speed_radps)
            limit = float(speed) if np.isfinite(speed) else None
            return JointDynamics(motor.max_torque_nm, limit, motor.gear_friction_nm, 0.0)
        if joint in self._passive:
            passive = self._passive[joint]
            return JointDynamics(None, None, passive.friction_nm, passive.damping_nms_per_rad)
        return JointDynamics(None, None, 0.0, 0.0)

    def _export_body(self, body: RigidBody) -> RigidBody:
        tyre = self._tyres.get(body.name)
        shapes = body.shapes if tyre is None else (*body.shapes, _tyre_shape(tyre))
        return replace(
            body,
            shapes=tuple(self._solid(body.name, shape) for shape in shapes),
            visuals=tuple(self._visual(visual) for visual in body.visuals),
        )

    def _solid(self, name: str, shape: ConvexShape) -> ConvexShape:
        if shape.geometry.mesh is None:
            return shape
        key = shape.points.tobytes()
        if key not in self._written:
            path = self._meshes.write_hull(f"{name} hull", shape.points)
            self._written[key] = Geometry("mesh", (1.0, 1.0, 1.0), np.eye(4), path, None)
        return replace(shape, geometry=self._written[key])

    def _visual(self, visual: Geometry) -> Geometry:
        if visual.mesh is None:
            return visual
        key = visual.mesh, visual.size, visual.colour
        if key not in self._written:
            vertices, faces, colours = self._sources.load(visual.mesh)
            if visual.colour is not None:
                colours = np.array([visual.colour], np.float32)
            if np.prod(visual.size) < 0.0:
                faces = faces[:, ::-1]
            mesh = paint_mesh(vertices * np.array(visual.size), faces, colours)
            path = self._meshes.write_obj(visual.mesh.rsplit("/", 1)[-1].rsplit(".", 1)[0], mesh)
            self._written[key] = Geometry("mesh", (1.0, 1.0, 1.0), np.eye(4), path, mesh.colour)
        return replace(self._written[key], pose=visual.pose)


def _tyre_shape(tyre: Tyre) -> ConvexShape:
    pose = np.array(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], tyre.axis))
    pose[:3, 3] = tyre.centre
    cylinder = Geometry("cylinder", (tyre.radius_m, tyre.width_m), pose, None, None)
    corners = np.asarray(trimesh.creation.cylinder(tyre.radius_m, tyre.width_m).vertices)
    return ConvexShape(cylinder, corners @ pose[:3, :3].T + pose[:3, 3])


def lowest_point(bodies: list[RigidBody]) -> float:
    """Height [m] of the lowest corner of all shapes in the base's frame, with all joints at zero."""
    points: Array = np.concatenate([body.points_b() for body in bodies])
    return float(points[:, 2].min(initial=0.0))
