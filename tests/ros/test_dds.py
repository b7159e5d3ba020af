"""Topics over DDS are those of ROS 2: by another program's types, across processes, and with limits."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="no rosbags: pip install 'dune_rl[ros]'")
pytest.importorskip("cyclonedds", reason="no Cyclone DDS: pip install 'dune_rl[ros]'")

import ros2_idl
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from documents import ROOT
from live_topics import random_domain

from dune_rl.clients.driven_policy import load_driven_policy
from dune_rl.clients.live_driver import LiveDriver
from dune_rl.commands.drive import parse_words
from dune_rl.config.build import make_simulation
from dune_rl.config.commands import RosConf
from dune_rl.config.compose import compose
from dune_rl.config.endless import without_ends
from dune_rl.core.errors import ConfigError
from dune_rl.ros.dds import Participant
from dune_rl.ros.dds_types import dds_type, message_struct, ros_topic, ros_type
from dune_rl.ros.library import message_types
from dune_rl.ros.live_scene import LiveScene
from dune_rl.ros.settings import DrivingConf, NetworkConf
from dune_rl.ros.transforms import Pose

FLAT = ROOT / "experiments" / "flat" / "seed1" / "policy.pt"
# How long a test waits for something that comes at once on an idle machine [s].
PATIENCE_S = 60.0


@pytest.fixture
def network() -> NetworkConf:
    return NetworkConf(domain=random_domain())


@pytest.fixture
def participant(network: NetworkConf) -> Iterator[Participant]:
    found = Participant(network)
    yield found
    found.close()


def await_all(ready: Callable[[], bool]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not ready():
        assert time.monotonic() < until_s, "waited in vain"
        time.sleep(0.01)


def first_of(take: Callable[[], list[Any]], write: Callable[[], None] = lambda: None) -> Any:
    """The first message that arrives while it is written again and again."""
    found: list[Any] = []

    def arrives() -> bool:
        write()
        found.extend(take())
        return bool(found)

    await_all(arrives)
    return found[0]


def make_scan() -> Any:
    types = message_types()
    return types.make(
        "sensor_msgs/LaserScan",
        header=types.header(12_345_678_901, "lidar_link"),
        angle_min=-3.0,
        angle_max=3.0,
        angle_increment=0.5,
        time_increment=0.0,
        scan_time=0.05,
        range_min=0.25,
        range_max=12.0,
        ranges=np.array([1.5, np.inf, 3.25], np.float32),
        intensities=np.zeros(0, np.float32),
    )


# As RViz reads, and as sensor data are read.
@pytest.mark.parametrize("reliability", [Policy.Reliability.Reliable(0), Policy.Reliability.BestEffort])
def test_another_program_reads_what_is_published(
    reliability: Any, network: NetworkConf, participant: Participant
) -> None:
    other = DomainParticipant(network.domain_id)
    reader = DataReader(other, Topic(other, "rt/scan", ros2_idl.LaserScan), Qos(reliability))
    scan = first_of(lambda: reader.take(10), lambda: participant.write("/scan", make_scan(), 0))
    assert (scan.header.stamp.sec, scan.header.stamp.nanosec) == (12, 345_678_901)
    assert scan.header.frame_id == "lidar_link" and scan.range_min == 0.25
    assert list(scan.ranges) == [1.5, np.inf, 3.25] and list(scan.intensities) == []


def test_latched_messages_reach_those_who_come_later(network: NetworkConf, participant: Participant) -> None:
    types = participant.types
    pose = Pose(np.array([0.1, 0.2, 0.3]), np.eye(3))
    frame = types.transform(types.header(0, "base_link"), "lidar_link", pose)
    message = types.make("tf2_msgs/TFMessage", transforms=[frame])
    participant.write("/tf_static", message, 0, latched=True)
    other = DomainParticipant(network.domain_id)
    qos = Qos(Policy.Reliability.Reliable(0), Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
    reader = DataReader(other, Topic(other, "rt/tf_static", ros2_idl.TFMessage), qos)
    (transform,) = first_of(lambda: reader.take(10)).transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("base_link", "lidar_link")
    assert (transform.transform.translation.z, transform.transform.rotation.w) == (0.3, 1.0)


def test_what_another_program_publishes_is_read(network: NetworkConf, participant: Participant) -> None:
    subscription = participant.subscribe("/cmd_vel", "geometry_msgs/msg/Twist")
    twist = ros2_idl.Twist(ros2_idl.Vector3(0.5, 0.0, 0.0), ros2_idl.Vector3(0.0, 0.0, -0.25))

    def publish_and_leave() -> None:
        other = DomainParticipant(network.domain_id)
        writer = DataWriter(other, Topic(other, "rt/cmd_vel", ros2_idl.Twist))
        found = first_of(subscription.take, lambda: writer.write(twist))
        assert (found.message.linear.x, found.message.angular.z) == (0.5, -0.25) and found.sent_ns > 0
        (offer,) = participant.offers()["/cmd_vel"]
        assert offer.type == "geometry_msgs/msg/Twist" and not offer.latched
        subscription.take()

    publish_and_leave()
    await_all(lambda: "/cmd_vel" not in participant.offers())
    # That a program leaves is no message.
    assert not subscription.take()


class NotUtf8(str):
    """A text that is written as bytes that no text has."""

    def encode(self, *_: Any) -> bytes:
        return b"\xff\xfe"


def test_a_message_with_damaged_text_is_left_out(network: NetworkConf, participant: Participant) -> None:
    subscription = participant.subscribe("/scan", "sensor_msgs/msg/LaserScan")
    other = DomainParticipant(network.domain_id)
    writer = DataWriter(
        other, Topic(other, "rt/scan", ros2_idl.LaserScan), Qos(Policy.Reliability.Reliable(0))
    )
    header = ros2_idl.Header(ros2_idl.Time(1, 0), "lidar_link")
    damaged = ros2_idl.Header(ros2_idl.Time(1, 0), NotUtf8())
    scans = [ros2_idl.LaserScan(each, *[0.0] * 7, [], []) for each in (header, damaged)]

    def write() -> None:
        for scan in scans[::-1]:
            writer.write(scan)

    found = first_of(subscription.take, write)
    assert found.message.header.frame_id == "lidar_link" and subscription.damaged


def test_every_standard_message_has_a_type() -> None:
    store = message_types().store
    names = [
        name for name in store.fielddefs if name.split("/")[0] in ("sensor_msgs", "nav_msgs", "std_msgs")
    ]
    assert len(names) > 50
    for name in names:
        assert message_struct(name).__idl_typename__ == dds_type(name) and ros_type(dds_type(name)) == name
    assert ros_topic("rq/add/_service") is None and ros_topic("rt/rover_0/scan") == "/rover_0/scan"


def test_bad_networks_are_named(network: NetworkConf, monkeypatch: pytest.MonkeyPatch) -> None:
    for text in ("x", "-1", "233"):
        monkeypatch.setenv("ROS_DOMAIN_ID", text)
        with pytest.raises(ConfigError, match=f"ROS_DOMAIN_ID={text} must be a whole number from 0 to 232"):
            Participant(NetworkConf())
    with pytest.raises(ConfigError, match="network"):
        parse_words([f"checkpoint={FLAT}", "network=<x/>"])
    # Cyclone DDS would abort the process.
    for peer, fault in (("nohost.invalid", "no machine nohost.invalid is known"), ("::1", "no HOST or HOST")):
        with pytest.raises(ConfigError, match=f"peers: .*{fault}"):
            Participant(NetworkConf(domain=network.domain_id, peers=(peer,)))
    with pytest.raises(ConfigError, match="there is no such network, or its ports are taken"):
        Participant(NetworkConf(domain=network.domain_id, network="10.255.255.254"))
    first = Participant(network)
    with pytest.raises(ConfigError, match="in use in this process with another network"):
        Participant(NetworkConf(domain=network.domain_id, peers=("localhost",)))
    first.close()


def test_a_domain_whose_ports_are_taken_is_named(network: NetworkConf) -> None:
    taken = []
    for index in range(34):
        for offset in (10, 11):
            each = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            # One that is taken by somebody else serves as well.
            with suppress(OSError):
                each.bind(("0.0.0.0", 7400 + 250 * network.domain_id + offset + 2 * index))
            taken.append(each)
    try:
        with pytest.raises(ConfigError, match=f"domain {network.domain_id} on localhost cannot be used"):
            Participant(network)
    finally:
        for each in taken:
            each.close()


def test_a_policy_drives_a_scene_to_its_goal(network: NetworkConf) -> None:
    """Both in this process; see below for two."""
    conf = compose(RosConf, ["actors=none", "seed=3", "speed=8"], (), load_config(FLAT))
    policy = load_driven_policy(FLAT)
    simulation = make_simulation(without_ends(conf), 1, conf.seed)
    tasks = {group.name: group.task for group in conf.external_groups}
    lines: list[str] = []
    participants = Participant(network), Participant(network)
    scene = LiveScene(simulation, tasks, participants[0], conf, lines.append)
    stopped = threading.Event()
    running = threading.Thread(target=scene.run, args=(stopped.is_set,), daemon=True)
    running.start()
    said: list[str] = []
    driver = LiveDriver(
        policy,
        participants[1],
        DrivingConf(once=True, wait_s=PATIENCE_S),
        said.append,
        origin=network.where,
    )
    try:
        summary = driver.run(lambda: not running.is_alive())
        await_all(lambda: any("goal reached" in line for line in lines) or not running.is_alive())
    finally:
        stopped.set()
        running.join()
        simulation.close()
        del driver, scene
        for each in participants:
            each.close()
    assert summary.goals == 1 and summary.decisions > 10
    assert any("goal reached" in line for line in lines), lines
    assert "decisions in" in str(summary) and "(median)" in str(summary)


def load_config(checkpoint: Path) -> dict[str, Any]:
    from dune_rl.learning.checkpoint import read_policy_file

    return read_policy_file(checkpoint)[1]["config"]


@pytest.mark.slow
def test_an_episode_over_dds_alone(network: NetworkConf, tmp_path: Path) -> None:
    """The scene, the policy and a reader of others, each a process; prints rate and latency."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(network.domain_id), "PYTHONPATH": str(ROOT)}
    log = (tmp_path / "scene.txt").open("w+")
    scene = subprocess.Popen(
        [sys.executable, "-m", "dune_rl.ros", f"checkpoint={FLAT}", "actors=none", "seed=3", "speed=2"],
        env=environment,
        stdout=log,
        stderr=subprocess.STDOUT,
    )
    try:
        words = [f"checkpoint={FLAT}", "once=true", f"wait_s={PATIENCE_S:g}", "duration_s=200"]
        policy = subprocess.Popen(
            [sys.executable, "-m", "dune_rl.drive", *words],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        domain = Domain(network.domain_id, network.xml())
        other = DomainParticipant(network.domain_id)
        scans = DataReader(other, Topic(other, "rt/scan", ros2_idl.LaserScan))
        twists = DataReader(other, Topic(other, "rt/cmd_vel", ros2_idl.Twist))
        seen, commands = [], []
        until_s = time.monotonic() + 4 * PATIENCE_S
        while policy.poll() is None and time.monotonic() < until_s:
            seen += [each for each in scans.take(50) if each.sample_info.valid_data]
            commands += [each for each in twists.take(50) if hasattr(each, "linear")]
            time.sleep(0.02)
        said = policy.communicate(timeout=10)[0]
        scene.send_signal(signal.SIGTERM)
        assert scene.wait(timeout=PATIENCE_S) == 143
    finally:
        scene.kill()
    log.seek(0)
    text = log.read()
    log.close()
    del scans, twists, other, domain
    print(said, text)
    assert policy.returncode == 0, said
    assert "goal reached" in said and "goal reached" in text and "times real time" in text
    assert len(seen) > 10 and len(seen[0].ranges) == 128 and seen[0].header.frame_id == "lidar_link"
    stamps = [scan.header.stamp.sec + 1e-9 * scan.header.stamp.nanosec for scan in seen]
    assert (np.diff(stamps) > 0.0).all()
    assert max(twist.linear.x for twist in commands) > 0.3
    # It stands at the goal.
    assert (commands[-1].linear.x, commands[-1].angular.z) == (0.0, 0.0)
