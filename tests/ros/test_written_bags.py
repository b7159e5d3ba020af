"""Bags of episodes have what was observed and what is true, also for other people's readers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="no rosbags: pip install 'dune_rl[ros]'")

from bags import Recorded, read_with_mcap, read_with_rosbags, record
from scipy.spatial.transform import Rotation

from dune_rl.ros.transforms import TransformTree

STEP_S, STEPS = 0.05, 8
LIDAR_3D = "{n_rings: 4, n_beams: 16, outputs: [range, intensity, segmentation]}"
CAMERA = (
    "{width: 12, height: 8, pitch_deg: 10, range_m: 2, outputs: [rgb, grey, depth, segmentation, normals]}"
)
SENSORS = "sensors.enabled=[lidar,lidar_past,imu,goal,velocity,odometry,encoders,position,lidar_3d,camera]"

Messages = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    words = [SENSORS, f"+sensors.lidar_3d={LIDAR_3D}", f"+sensors.camera={CAMERA}"]
    return record(tmp_path_factory.mktemp("bags"), *words, scenes=2, episodes=2)


@pytest.fixture(params=["rosbags", "mcap"])
def messages(request: pytest.FixtureRequest, recorded: Recorded) -> Messages:
    if request.param == "mcap":
        pytest.importorskip("mcap_ros2", reason="no mcap-ros2-support: pip install 'dune_rl[clients]'")
    reader: Callable[[Path], Messages] = {"rosbags": read_with_rosbags, "mcap": read_with_mcap}[request.param]
    return reader(recorded.bag(1))


def stamp_s(message: Any) -> float:
    stamp = message.header.stamp
    return stamp.sec + 1e-9 * getattr(stamp, "nanosec", 0)


def vector(value: Any) -> np.ndarray:
    return np.array([value.x, value.y, value.z])


def quaternion(value: Any) -> Rotation:
    return Rotation.from_quat([value.x, value.y, value.z, value.w])


def test_every_step_has_a_time_and_each_topic_its_stamps(messages: Messages) -> None:
    expected = np.round(np.arange(STEPS + 1) * STEP_S, 9)
    clock = [message.clock.sec + 1e-9 * message.clock.nanosec for _, message in messages["/clock"]]
    np.testing.assert_allclose(clock, expected, atol=1e-9)
    for topic in ("/scan", "/imu", "/odom", "/ground_truth/odom", "/points", "/camera/rgb/image_raw"):
        np.testing.assert_allclose([stamp_s(each) for _, each in messages[topic]], expected, atol=1e-9)
        np.testing.assert_allclose([time * 1e-9 for time, _ in messages[topic]], expected, atol=1e-9)
    # An action is taken at the time of what it follows from.
    for topic in ("/action", "/cmd_vel"):
        np.testing.assert_allclose([time * 1e-9 for time, _ in messages[topic]], expected[:-1], atol=1e-9)


def test_messages_have_what_was_observed(messages: Messages, recorded: Recorded) -> None:
    row = 1
    for step, seen in enumerate(recorded.seen):
        readings = {name: each[row] for name, each in seen.readings["rover"].items()}

        def at(topic: str, number: int = step) -> Any:
            return messages[topic][number][1]

        scan = at("/scan")
        ranges = np.minimum(np.array(scan.ranges, np.float32), np.float32(12.0))
        assert len(ranges) == 128 and scan.header.frame_id == "lidar_link"
        assert (ranges < 12.0).any()
        np.testing.assert_array_equal(ranges.reshape(32, 4).min(axis=1), readings["lidar"])
        assert scan.angle_min == pytest.approx(-np.pi) and scan.range_max == pytest.approx(12.0)
        assert scan.angle_increment == pytest.approx(2 * np.pi / 128)
        imu = at("/imu")
        felt = [*vector(imu.linear_acceleration), *vector(imu.angular_velocity)]
        np.testing.assert_array_equal(np.array(felt, np.float32), readings["imu"][:6])
        angles = quaternion(imu.orientation).as_euler("xyz")
        np.testing.assert_allclose(angles, readings["imu"][6:], atol=1e-6)
        odom = at("/odom")
        assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
        yaw = quaternion(odom.pose.pose.orientation).as_euler("xyz")[2]
        place, twist = odom.pose.pose.position, odom.twist.twist
        known = [place.x, place.y, yaw, twist.linear.x, twist.angular.z]
        np.testing.assert_allclose(known, readings["odometry"], rtol=1e-6, atol=1e-7)
        speed = at("/velocity").twist
        np.testing.assert_array_equal(
            np.array([speed.linear.x, speed.angular.z], np.float32), readings["velocity"]
        )
        for name in ("lidar_past", "goal", "encoders", "position"):
            array = at(f"/observation/{name}")
            np.testing.assert_array_equal(np.array(array.data, np.float32), readings[name])
            assert [each.label for each in array.layout.dim] == [name]
        check_pictures(at, readings)
        check_cloud(at("/points"), readings)
        if step:
            action = np.array(at("/action", step - 1).data, np.float32)
            np.testing.assert_array_equal(action, seen.actions["rover"][row, 0])
            command = at("/cmd_vel", step - 1)
            assert np.float32(command.linear.x) == action[0]
            # The gain of the heading controller, and its limit.
            assert command.angular.z == pytest.approx(np.clip(2.0 * action[1], -2.0, 2.0))


def check_pictures(at: Callable[[str], Any], readings: dict[str, np.ndarray]) -> None:
    kinds = {
        "rgb": ("rgb8", np.uint8),
        "grey": ("mono8", np.uint8),
        "depth": ("32FC1", np.float32),
        "segmentation": ("mono8", np.uint8),
        "normals": ("32FC3", np.float32),
    }
    for output, (encoding, dtype) in kinds.items():
        image, info = at(f"/camera/{output}/image_raw"), at(f"/camera/{output}/camera_info")
        reading = readings[f"camera_{output}"]
        assert (image.encoding, image.header.frame_id) == (encoding, "camera_optical_frame")
        assert (image.width, image.height, info.width, info.height) == (12, 8, 12, 8)
        values = np.frombuffer(bytes(image.data), dtype).reshape(reading.shape)
        if output == "depth":
            assert np.isinf(values).any() and (reading[np.isinf(values)] == 2.0).all()
            values = np.minimum(values, np.float32(2.0))
        np.testing.assert_array_equal(values, reading)
        # 60 degrees over 12 pixels, whose first is at 0.
        k = np.array(info.k)
        assert k[0] == pytest.approx(6.0 / np.tan(np.deg2rad(30.0))) and k[2] == 5.5 and k[5] == 3.5


def check_cloud(cloud: Any, readings: dict[str, np.ndarray]) -> None:
    assert (cloud.height, cloud.width, cloud.header.frame_id) == (4, 16, "lidar_3d_link")
    formats = {7: "<f4", 2: "u1"}
    layout = np.dtype(
        {
            "names": [each.name for each in cloud.fields],
            "formats": [formats[each.datatype] for each in cloud.fields],
            "offsets": [each.offset for each in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    points = np.frombuffer(bytes(cloud.data), layout).reshape(4, 16)
    ranges = readings["lidar_3d_range"][..., 0]
    np.testing.assert_array_equal(np.minimum(points["range"], np.float32(30.0)), ranges)
    np.testing.assert_array_equal(points["intensity"], readings["lidar_3d_intensity"][..., 0])
    np.testing.assert_array_equal(points["segmentation"], readings["lidar_3d_segmentation"][..., 0])
    xyz = np.stack([points[axis] for axis in "xyz"], axis=-1)
    hit = ranges < 30.0
    assert hit.any() and not hit.all() and np.isnan(xyz[~hit]).all()
    np.testing.assert_allclose(np.linalg.norm(xyz[hit], axis=-1), ranges[hit], rtol=1e-6)
    # Rings from 15 degrees up to 15 down, beams from behind counter-clockwise.
    elevation, bearing = (
        np.broadcast_to(each, (4, 16))
        for each in np.meshgrid(
            np.deg2rad([15.0, 5.0, -5.0, -15.0]), -np.pi + np.arange(16) * np.pi / 8, indexing="ij"
        )
    )
    expected = [np.cos(elevation) * np.cos(bearing), np.cos(elevation) * np.sin(bearing), np.sin(elevation)]
    np.testing.assert_allclose(xyz[hit], (ranges * np.stack(expected)).transpose(1, 2, 0)[hit], atol=1e-5)


def test_messages_have_the_true_state(messages: Messages, recorded: Recorded) -> None:
    row = 1
    tree = TransformTree()
    for _, message in messages["/tf_static"]:
        tree.add(message)
    for step, seen in enumerate(recorded.seen):
        state = seen.states["rover"]
        tree.add(messages["/tf"][step][1])
        pose = tree.pose("base_link", "map")
        assert pose is not None
        np.testing.assert_allclose(pose[0], state.motion.position_w[row], atol=1e-9)
        np.testing.assert_allclose(pose[1], state.motion.rotation[row], atol=1e-9)
        odom = messages["/ground_truth/odom"][step][1]
        np.testing.assert_allclose(vector(odom.pose.pose.position), state.motion.position_w[row])
        np.testing.assert_allclose(vector(odom.twist.twist.linear), state.motion.velocity_b[row])
        np.testing.assert_allclose(vector(odom.twist.twist.angular), state.motion.angular_b[row])
        joints, expected = messages["/joint_states"][step][1], state.motion.joints
        assert expected is not None and len(joints.name) == 4 and "front_left_wheel_joint" in joints.name
        np.testing.assert_array_equal(joints.position, expected.angle[row])
        np.testing.assert_array_equal(joints.velocity, expected.speed[row])
        np.testing.assert_array_equal(joints.effort, expected.torque[row])
        assert messages["/in_contact"][step][1].data == state.contacts.touching[row]
        assert messages["/collisions"][step][1].data == state.contacts.total[row]
    (goal,) = (message for _, message in messages["/goal_pose"])
    np.testing.assert_array_equal(
        [goal.pose.position.x, goal.pose.position.y], recorded.seen[0].states["rover"].goal.position_w[row]
    )


def test_sensors_are_where_the_robot_carries_them(messages: Messages) -> None:
    tree = TransformTree()
    ((_, message),) = messages["/tf_static"]
    tree.add(message)
    lidar, camera = tree.pose("lidar_link", "base_link"), tree.pose("camera_optical_frame", "base_link")
    assert lidar is not None and camera is not None
    np.testing.assert_allclose(lidar[0], [0.174, 0.0, 0.196])
    # Forward of a picture is the optical frame's z, here 10 degrees down; to the right is its x.
    np.testing.assert_allclose(camera[1][:, 2], [np.cos(0.1745329), 0.0, -np.sin(0.1745329)], atol=1e-6)
    np.testing.assert_allclose(camera[1][:, 0], [0.0, -1.0, 0.0], atol=1e-12)


def test_a_bag_gives_the_observations_back(recorded: Recorded) -> None:
    for episode in (0, 1):
        found = recorded.read(episode)
        assert len(found) == STEPS
        for (_, readings), seen in zip(found, recorded.seen, strict=False):
            for name, expected in seen.readings["rover"].items():
                if name in ("imu", "odometry"):
                    np.testing.assert_allclose(readings[name], expected[episode], rtol=1e-6, atol=1e-7)
                else:
                    np.testing.assert_array_equal(readings[name], expected[episode], name)
                assert readings[name].dtype == expected.dtype


def test_bytes_depend_on_the_episode_alone(tmp_path: Path) -> None:
    first = record(tmp_path / "first", scenes=1, episodes=2)
    again = record(tmp_path / "again", scenes=1, episodes=2)
    together = record(tmp_path / "together", scenes=3, episodes=2)
    assert sorted(each.name for each in together.folder.iterdir()) == ["episode_0", "episode_1"]
    for path in sorted(first.folder.rglob("*")):
        if path.is_file():
            name = path.relative_to(first.folder)
            assert path.read_bytes() == (again.folder / name).read_bytes(), name
            assert path.read_bytes() == (together.folder / name).read_bytes(), name


REALISM = ("sensors.lidar.realism={rate_hz: 10, latency_s: 0.1, noise_m: 0.02}", "+sensors.odometry={}")


@pytest.mark.slow(all_but=["1-*"])
@pytest.mark.parametrize(("repeat", "scan"), [(1, "/scan"), (2, "/scan"), (3, "/observation/lidar")])
def test_readings_with_faults_come_when_the_robot_had_them(repeat: int, scan: str, tmp_path: Path) -> None:
    imu = "sensors.imu.realism={latency_s: 0.05}"
    recorded = record(tmp_path, *REALISM, imu, f"physics.action_repeat={repeat}")
    found = recorded.read(period_s=STEP_S * repeat)
    assert len(found) == -(-STEPS // repeat)
    for (_, readings), seen in zip(found, recorded.seen, strict=False):
        for name, expected in seen.readings["rover"].items():
            np.testing.assert_allclose(readings[name], expected[0], rtol=1e-6, atol=1e-7, err_msg=name)
    messages = read_with_rosbags(recorded.bag())
    assert scan in messages and ("/scan" in messages) == (scan == "/scan")
    if repeat == 1:
        times = [(time * 1e-9, stamp_s(message)) for time, message in messages["/scan"]]
        # Read at 10 Hz, and 0.1 s late; at first there is what was read at the start.
        np.testing.assert_allclose(times, [(0.0, 0.0), (0.2, 0.1), (0.3, 0.2), (0.4, 0.3)], atol=1e-9)


@pytest.mark.slow
def test_without_odometry_that_of_the_truth_begins_at_the_start(tmp_path: Path) -> None:
    recorded = record(tmp_path)
    messages = read_with_rosbags(recorded.bag())
    first, last = (messages["/odom"][index][1].pose.pose.position for index in (0, -1))
    np.testing.assert_allclose(vector(first), 0.0, atol=1e-12)
    states = [recorded.seen[index].states["rover"].motion for index in (0, -1)]
    moved = states[1].position_w[0] - states[0].position_w[0]
    assert np.linalg.norm(vector(last)) == pytest.approx(np.linalg.norm(moved))
    tree = TransformTree()
    tree.add(messages["/tf"][-1][1])
    pose = tree.pose("base_link", "map")
    assert pose is not None
    np.testing.assert_allclose(pose[0], states[1].position_w[0], atol=1e-9)


@pytest.mark.slow
def test_several_robots_have_namespaces(tmp_path: Path) -> None:
    recorded = record(tmp_path, "robots=[rover_zero,leo_rover]")
    messages = read_with_rosbags(recorded.bag())
    groups = list(recorded.sources)
    names = [f"{group}_0" for group in groups]
    for group, name in zip(groups, names, strict=True):
        assert {f"/{name}/{topic}" for topic in ("scan", "imu", "odom", "cmd_vel", "goal_pose")} <= {
            *messages
        }
        assert messages[f"/{name}/scan"][0][1].header.frame_id == f"{name}/lidar_link"
        found = recorded.read(group=group, robot=name)
        for (_, readings), seen in zip(found, recorded.seen, strict=False):
            np.testing.assert_array_equal(readings["lidar"], seen.readings[group]["lidar"][0])
    tree = TransformTree()
    for topic in ("/tf_static", "/tf"):
        for _, message in messages[topic]:
            tree.add(message)
    assert all(tree.pose(f"{name}/lidar_link", "map") is not None for name in names)


@pytest.mark.slow
def test_who_comes_and_goes_is_recorded_meanwhile(tmp_path: Path) -> None:
    presence = "+actors.walker.presence={arrive_s: [0.1, 0.2], stay_s: [0.1, 0.15]}"
    recorded = record(tmp_path, "actors=external_walkers", presence, policy="random")
    messages = read_with_rosbags(recorded.bag())
    states = [seen.states["walker"] for seen in recorded.seen]
    # Agents that have left are done; in the step in which they end they still see.
    expected = [round(step * STEP_S, 9) for step, state in enumerate(states) if not state.done[0]]
    times = [time * 1e-9 for time, _ in messages["/walker_0/ground_truth/odom"]]
    assert 2 <= len(times) < STEPS
    np.testing.assert_allclose(times, expected, atol=1e-9)
    assert [time * 1e-9 for time, _ in messages["/walker_0/action"]] == pytest.approx(times[:-1])
    for (_, message), step in zip(
        messages["/walker_0/ground_truth/odom"], np.rint(np.array(times) / STEP_S).astype(int), strict=True
    ):
        place = states[step].motion.position_w[0]
        np.testing.assert_allclose(vector(message.pose.pose.position), place)


@pytest.mark.slow
def test_joints_have_no_twist(tmp_path: Path) -> None:
    words = ["robot=hyperdog", "robot.action=joints", "+world=flat"]
    recorded = record(tmp_path, *words, policy="random")
    messages = read_with_rosbags(recorded.bag())
    assert "/cmd_vel" not in messages and len(messages["/action"][0][1].data) == 12
    assert len(messages["/joint_states"][0][1].name) == 12
