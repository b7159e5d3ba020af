"""Robots exported for Gazebo: libsdformat finds no fault in them, and their URDFs are the same robots."""

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pytest
from libsdformat import assert_valid
from simulations import started_simulation
from urdf_files import write_cart
from vehicles import write_car

from dune_rl.gazebo.robot.sensors import make_sensors
from dune_rl.gazebo.scene import WORLD, write_robots, write_scene
from dune_rl.geometry.frames import rotation_from_angles
from dune_rl.robots.robot import Robot
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.robots.urdf.reader import read_urdf
from dune_rl.robots.urdf.robot import UrdfRobot
from dune_rl.sensors.conf import parse_sensors
from dune_rl.state.sensor_carrier import SensorCarrier

ROBOTS = ("rover_zero", "leo_rover", "hyperdog")


@dataclass(frozen=True)
class Exported:
    """A robot that was exported, its <model> in SDF and its URDF."""

    robot: Robot
    model: Element
    urdf: Path


def export(folder: Path, **settings: object) -> dict[str, Exported]:
    """The robots of a scene by name."""
    simulation = started_simulation("flat", **settings)
    written = write_robots(folder, simulation)
    simulation.close()
    found = {}
    for group in simulation.groups:
        name = written[group.name].name
        model = ElementTree.parse(folder / name / "model.sdf").find("model")
        found[name] = Exported(group.body.robot, model, folder / name / f"{name}.urdf")
    return found


@pytest.fixture(scope="module")
def robots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Exported]:
    return export(tmp_path_factory.mktemp("robots"), robots=list(ROBOTS), sensors="camera")


def numbers(element: Element, path: str) -> list[float]:
    return [float(word) for word in (element.findtext(path) or "").split()]


@pytest.mark.slow(all_but=["leo_rover"])
@pytest.mark.parametrize("name", ROBOTS)
def test_libsdformat_finds_no_fault(name: str, robots: dict[str, Exported]) -> None:
    folder = robots[name].urdf.parent
    assert_valid(folder / "model.sdf", folder.parent)
    assert_valid(robots[name].urdf, folder.parent)


@pytest.mark.parametrize("name", ROBOTS)
def test_masses_joints_and_shapes_are_the_robot_s(name: str, robots: dict[str, Exported]) -> None:
    robot, model = robots[name].robot, robots[name].model
    original, read = read_urdf(robot.body.urdf), read_urdf(robots[name].urdf)
    moving = {name for name, joint in original.joints.items() if joint.kind != "fixed"}
    assert {name for name, joint in read.joints.items() if joint.kind != "fixed"} == moving
    for name, link in original.links.items():
        own = read.links[name].inertial
        assert own.mass == pytest.approx(link.inertial.mass)
        np.testing.assert_allclose(own.inertia, link.inertial.inertia, atol=1e-9)
        np.testing.assert_allclose(own.centre, link.inertial.centre, atol=1e-9)
    for name in moving:
        np.testing.assert_allclose(read.joints[name].pose, original.joints[name].pose, atol=1e-9)
        np.testing.assert_allclose(read.joints[name].axis, original.joints[name].axis)
        assert read.joints[name].limits == original.joints[name].limits
    # In SDF the differential's rockers are part of the base.
    coupled = {joint for each in robot.body.couplings for joint in (each.leader, each.follower)}
    assert {joint.get("name") for joint in model.findall("joint")} == moving - coupled
    masses = [numbers(link, "inertial/mass")[0] for link in model.findall("link")]
    assert sum(masses) == pytest.approx(robot.description.mass_kg, abs=1e-4)
    # The links are where the joints have them, at zero.
    for link in model.findall("link"):
        x, y, z, *angles = numbers(link, "pose")
        pose = original.link_poses(np.eye(4), {})[link.get("name")]
        np.testing.assert_allclose(pose[:3, 3], [x, y, z], atol=1e-8)
        np.testing.assert_allclose(pose[:3, :3], rotation_from_angles(np.array(angles)), atol=1e-8)


@pytest.mark.parametrize("name", ["rover_zero", "leo_rover"])
def test_the_urdf_drives_as_a_robot_of_the_same_wheels(name: str, robots: dict[str, Exported]) -> None:
    described = robots[name].robot.description
    read = UrdfRobot(UrdfConf(path=str(robots[name].urdf)), 1)
    own = read.description
    assert own.mass_kg == pytest.approx(described.mass_kg)
    assert own.wheels.radius_m == pytest.approx(described.contact_radius_m)
    assert own.contact_width_m == pytest.approx(described.contact_width_m)
    assert own.standing_height_m == pytest.approx(described.standing_height_m, abs=1e-3)
    expected = sorted(described.contact_centres_b.tolist())
    np.testing.assert_allclose(sorted(own.contact_centres_b.tolist()), expected, atol=1e-9)
    assert set(read.body.drive_joints) == set(robots[name].robot.body.drive_joints)
    assert len(read.body.couplings) == (1 if name == "leo_rover" else 0)


@pytest.mark.slow
def test_a_urdf_of_a_user_is_exported_with_its_meshes(tmp_path: Path) -> None:
    path = write_cart(tmp_path)
    (tmp_path / "out").mkdir()
    cart = export(tmp_path / "out", robot={"name": "urdf", "path": str(path)})["cart"]
    assert_valid(cart.urdf.parent / "model.sdf", tmp_path / "out")
    first, again = (UrdfRobot(UrdfConf(path=str(each)), 1) for each in (path, cart.urdf))
    assert again.description.mass_kg == pytest.approx(first.description.mass_kg)
    np.testing.assert_allclose(again.description.contact_centres_b, first.description.contact_centres_b)
    assert again.description.half_size_m == pytest.approx(first.description.half_size_m)
    uris = [each.text for each in cart.model.iter("uri")]
    assert uris and all((cart.urdf.parent / uri).is_file() for uri in uris)
    assert all(".." not in uri and not uri.startswith("/") for uri in uris)
    assert [each.text for each in cart.model.iter("diffuse")] == ["0.8 0.1 0.1 1"]


@pytest.mark.slow
def test_cars_have_a_controller_for_each_motor(tmp_path: Path) -> None:
    path = write_car(tmp_path)
    (tmp_path / "out").mkdir()
    car = export(tmp_path / "out", robot={"name": "urdf", "path": str(path)})["car"]
    assert_valid(car.urdf.parent / "model.sdf", tmp_path / "out")
    kinds = {
        each.findtext("joint_name"): each.get("name").rsplit("::", 1)[-1]
        for each in car.model.findall("plugin")
        if each.find("joint_name") is not None
    }
    modes = {"velocity": "JointController", "position": "JointPositionController"}
    assert kinds == {motor.joint: modes[motor.mode] for motor in car.robot.body.motors}
    assert set(kinds.values()) == set(modes.values())


@pytest.mark.slow
def test_wheels_roll_on_spheres_and_meet_obstacles_with_their_tyres(tmp_path: Path) -> None:
    settings = {"name": "leo_rover", "wheel_friction": 0.8, "sideways_friction_share": 0.5}
    model = export(tmp_path, robot=settings)["leo_rover"].model
    (wheel,) = model.findall("link[@name='front_left_wheel']")
    ball, tyre = wheel.findall("collision")
    assert numbers(ball, "geometry/sphere/radius") == [0.0625]
    assert numbers(tyre, "geometry/cylinder/radius") == [0.0625]
    assert numbers(tyre, "geometry/cylinder/length") == [0.07]
    assert [each.findtext("surface/contact/collide_bitmask") for each in (ball, tyre)] == ["1", "2"]
    friction = ball.find("surface/friction/ode")
    assert [friction.findtext(tag) for tag in ("mu", "mu2", "fdir1")] == ["0.4", "0.8", "0 1 0"]
    (hull,) = {each.findtext("surface/friction/ode/mu") for each in model.find("link").findall("collision")}
    assert hull == "0.3"
    limit = model.find("joint[@name='front_left_wheel_joint']/axis/limit")
    assert (numbers(limit, "effort"), numbers(limit, "velocity")) == ([2.0], [9.4])


def test_drives_have_the_robot_s_limits(robots: dict[str, Exported]) -> None:
    model = robots["rover_zero"].model
    (drive,) = (each for each in model.findall("plugin") if "DiffDrive" in each.get("name"))
    assert [each.text for each in drive.findall("left_joint")] == [
        "front_left_wheel_joint", "rear_left_wheel_joint",
    ]  # fmt: skip
    for tag, value in (
        ("wheel_radius", 0.125), ("wheel_separation", 0.5), ("max_linear_velocity", 1.0),
        ("max_angular_velocity", 2.0), ("max_linear_acceleration", 5.0), ("min_angular_acceleration", -4.0),
    ):  # fmt: skip
        assert numbers(drive, tag) == [value]
    servos = [
        each
        for each in robots["hyperdog"].model.findall("plugin")
        if "JointPositionController" in each.get("name")
    ]
    assert len(servos) == 12
    assert any(numbers(each, "initial_position")[0] > 0.5 for each in servos)


def test_sensors_are_those_of_the_settings() -> None:
    sensors = {
        "lidar": {
            "n_beams": 90,
            "n_segments": 30,
            "fov_deg": 180.0,
            "range_m": 8.0,
            "realism": "rplidar_a2m8",
        },
        "rings": {"sensor": "lidar", "rings_deg": [-10, 0, 10], "mount_b": [0.1, 0.0, 0.3]},
        "lidar_3d": {"n_rings": 4, "n_beams": 60},
        "camera": {
            "width": 80,
            "height": 60,
            "fov_deg": 70.0,
            "pitch_deg": 20.0,
            "outputs": ["rgb", "depth"],
        },
        "imu": {"realism": {"rate_hz": 10.0, "gyroscope": {"noise": 0.02, "bias": 0.01}}},
        "eye": {"sensor": "camera", "projection": "fisheye", "fov_deg": 160.0},
        "goal": {},
    }
    carrier = SensorCarrier(scanner_b=(0.2, 0.0, 0.3), camera_b=(0.2, 0.0, 0.175), imu_b=(0.0, 0.0, 0.1))
    settings = {name: conf.mounted_on(carrier) for name, conf in parse_sensors(sensors).items()}
    mounted, others = make_sensors(settings, 0.05)
    assert others == ["eye", "goal"]
    found = {each.name: each.element for each in mounted}
    kinds = {name: each.get("type") for name, each in found.items()}
    lidars = dict.fromkeys(("lidar", "rings", "lidar_3d"), "gpu_lidar")
    assert kinds == {**lidars, "camera": "rgbd_camera", "imu": "imu"}
    lidar = found["lidar"]
    assert numbers(lidar, "update_rate") == [10.0]
    assert numbers(lidar, "lidar/scan/horizontal/samples") == [90]
    assert numbers(lidar, "lidar/scan/horizontal/min_angle") == pytest.approx([-np.pi / 2])
    assert numbers(lidar, "lidar/scan/horizontal/max_angle") == pytest.approx([np.pi / 2])
    assert numbers(lidar, "lidar/range/max") == [8.0]
    assert numbers(lidar, "lidar/noise/stddev")[0] > 0.0
    # Of a full circle the last beam is not the first.
    assert numbers(found["rings"], "lidar/scan/horizontal/max_angle") == pytest.approx([np.pi - np.pi / 64])
    assert numbers(found["rings"], "lidar/scan/vertical/samples") == [3]
    assert numbers(found["rings"], "lidar/scan/vertical/min_angle") == pytest.approx([np.deg2rad(-10.0)])
    assert numbers(found["lidar_3d"], "lidar/scan/vertical/samples") == [4]
    camera = found["camera"]
    assert numbers(camera, "camera/horizontal_fov") == pytest.approx([np.deg2rad(70.0)])
    assert (numbers(camera, "camera/image/width"), numbers(camera, "camera/image/height")) == ([80], [60])
    noise = found["imu"].find("imu/angular_velocity/x/noise")
    assert (numbers(noise, "stddev"), numbers(noise, "bias_stddev")) == ([0.02], [0.01])
    poses = {each.name: each.pose for each in mounted}
    np.testing.assert_allclose(poses["rings"][:3, 3], [0.1, 0.0, 0.3])
    np.testing.assert_allclose(poses["camera"][:3, 3], carrier.camera_b)
    # Downward.
    np.testing.assert_allclose(poses["camera"][:3, 0], [np.cos(np.deg2rad(20)), 0.0, -np.sin(np.deg2rad(20))])


def test_sensors_are_on_the_base_and_have_frames(robots: dict[str, Exported]) -> None:
    rover = robots["rover_zero"]
    poses = {each.get("name"): numbers(each, "pose") for each in rover.model.iter("sensor")}
    assert poses["lidar"] == [0.174, 0.0, 0.196, 0.0, 0.0, 0.0]
    joints = ElementTree.parse(rover.urdf).findall("joint")
    origins = {each.find("child").get("link"): each.find("origin").get("xyz") for each in joints}
    assert origins["lidar_link"] == "0.174 0.0 0.196"
    holders = {each.get("reference") for each in ElementTree.parse(rover.urdf).findall("gazebo[sensor]")}
    assert holders == {"camera_link", "lidar_link", "imu_link"}


@pytest.mark.slow
def test_robots_stand_in_the_world_where_the_episode_starts(tmp_path: Path) -> None:
    simulation = started_simulation("island", robots=["leo_rover", "leo_rover", "hyperdog"])
    write_scene(tmp_path, "site", simulation, 1.0, with_robots=True)
    includes = ElementTree.parse(tmp_path / WORLD).findall("world/include")
    assert_valid(tmp_path / WORLD, tmp_path)
    uris = [include.findtext("uri") for include in includes]
    assert uris == ["model://leo_rover", "model://leo_rover", "model://hyperdog"]
    states = [group.body.motion.position_w for group in simulation.groups]
    simulation.close()
    for include, position in zip(includes, np.concatenate(states), strict=True):
        x, y, z, *_ = numbers(include, "pose")
        np.testing.assert_allclose([x, y], position[:2], atol=1e-6)
        # The dog's legs are straight at first, and not in the ground.
        lift = 0.075 if include.findtext("uri") == "model://hyperdog" else 0.0
        assert z - position[2] == pytest.approx(lift, abs=1e-3)
