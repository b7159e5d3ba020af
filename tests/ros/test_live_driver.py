"""A policy on live topics: it acts on fresh messages that fit, and the robot stands otherwise."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="no rosbags: pip install 'dune_rl[ros]'")

from live_topics import TopicBoard

from dune_rl.clients.driven_policy import DrivenPolicy
from dune_rl.clients.live_driver import LiveDriver
from dune_rl.clients.policy_interface import PolicyInterface
from dune_rl.core.errors import ConfigError
from dune_rl.ros.live_readings import LiveReadings
from dune_rl.ros.settings import DrivingConf
from dune_rl.ros.transforms import ORIGIN, Pose

SECOND = 1_000_000_000
INTERFACE = PolicyInterface.model_validate(
    {
        "group": "rover",
        "observation": {
            "goal": {"shape": [2], "dtype": "float32"},
            "lidar": {"shape": [8], "dtype": "float32"},
            "velocity": {"shape": [2], "dtype": "float32"},
        },
        "action": [
            {"name": "speed_mps", "low": -1.0, "high": 1.0},
            {"name": "relative_heading_rad", "low": -3.1, "high": 3.1},
        ],
        "decision_s": 0.1,
        "control_step_s": 0.05,
        "sensors": {
            "goal": {"sensor": "goal"},
            "lidar": {"sensor": "lidar", "n_beams": 32, "n_segments": 8, "mount_b": [0.2, 0.0, 0.3]},
            "velocity": {"sensor": "velocity"},
        },
        "vehicle": {
            "min_speed_mps": -1.0,
            "max_speed_mps": 1.0,
            "max_yaw_rate_radps": 2.0,
            "heading_gain_per_s": 2.0,
            "length_m": 0.5,
            "width_m": 0.4,
            "footprint_radius_m": 0.3,
            "turning_radius_m": 0.0,
        },
        "goal_m": 0.75,
    }
)


def _at(x: float, y: float, z: float) -> Pose:
    return Pose(np.array([x, y, z]), np.eye(3))


class Rig:
    """A robot on a board of topics, in turns of 0.05 s by its clock, and a policy that drives it."""

    def __init__(self, **conf: Any) -> None:
        self.board, self.lines, self.turn = TopicBoard(), list[str](), 0
        self.seen: list[Mapping[str, Any]] = []
        self.begins: list[bool] = []
        self.action = np.array([0.8, 0.25], np.float32)
        self.conf = DrivingConf(**{"wait_s": 0.05, **conf})
        for topic, kind in (
            ("/clock", "rosgraph_msgs/Clock"),
            ("/scan", "sensor_msgs/LaserScan"),
            ("/odom", "nav_msgs/Odometry"),
            ("/goal_pose", "geometry_msgs/PoseStamped"),
            ("/tf", "tf2_msgs/TFMessage"),
            ("/tf_static", "tf2_msgs/TFMessage"),
        ):
            self.board.offer(topic, kind)
        self.topics = {"velocity": "/odom"}
        self.goal, self.mount, self.ranges = (
            (5.0, 0.0),
            np.array([0.2, 0.0, 0.3]),
            np.full(32, 4.0, np.float32),
        )
        self.silent: set[str] = set()
        self.late_s, self.ticks_last = 0.0, False

    def run(self, turns: int, each_turn: Callable[[int], None] | None = None, **more: Any) -> LiveDriver:
        policy = DrivenPolicy(self._act, more.pop("interface", INTERFACE), Path("policy.pt"))
        driver = LiveDriver(
            policy,
            self.board,  # type: ignore[arg-type]
            self.conf,
            self.lines.append,
            origin="domain 0",
            topics=self.topics,
            **more,
        )

        def wait(timeout_s: float) -> None:
            if self.turn == turns:
                raise KeyboardInterrupt
            if each_turn is not None:
                each_turn(self.turn)
            self._publish()
            self.turn += 1

        self.board.wait = wait  # type: ignore[method-assign]
        with suppress(KeyboardInterrupt):
            driver.run()
        return driver

    def _act(self, observation: Mapping[str, Any], begins: bool) -> np.ndarray:
        self.seen.append(observation)
        self.begins.append(begins)
        return self.action

    def _publish(self) -> None:
        types, now_ns = self.board.types, (self.turn + 1) * SECOND // 20
        stamp_ns = now_ns - round(self.late_s * SECOND)

        def put(topic: str, message: Any) -> None:
            if topic not in self.silent:
                self.board.put(topic, message)

        clock = types.make("rosgraph_msgs/Clock", clock=types.time(now_ns))
        if not self.ticks_last:
            put("/clock", clock)
        if self.turn == 0:
            mount = types.transform(types.header(0, "base_link"), "laser", _at(*self.mount))
            put("/tf_static", types.make("tf2_msgs/TFMessage", transforms=[mount]))
            pose = types.pose(_at(*self.goal, 0.0))
            header = types.header(0, "map")
            put("/goal_pose", types.make("geometry_msgs/PoseStamped", header=header, pose=pose))
        frames = [
            types.transform(types.header(now_ns, "map"), "odom", ORIGIN),
            types.transform(types.header(now_ns, "odom"), "base_link", _at(1.0, 0.0, 0.0)),
        ]
        put("/tf", types.make("tf2_msgs/TFMessage", transforms=frames))
        header = types.header(now_ns, "odom")
        put("/odom", types.odometry(header, "base_link", ORIGIN, types.planar_twist(0.3, 0.0)))
        put(
            "/scan",
            types.make(
                "sensor_msgs/LaserScan",
                header=types.header(stamp_ns, "laser"),
                angle_min=-np.pi,
                angle_max=np.pi * 15 / 16,
                angle_increment=np.pi / 16,
                time_increment=0.0,
                scan_time=0.05,
                range_min=0.1,
                range_max=12.0,
                ranges=self.ranges,
                intensities=np.zeros(0, np.float32),
            ),
        )
        if self.ticks_last:
            put("/clock", clock)

    @property
    def commands(self) -> list[tuple[float, float]]:
        return [(each.linear.x, each.angular.z) for each in self.board.written["/cmd_vel"]]

    @property
    def stops(self) -> list[str]:
        return [line for line in self.lines if line.startswith("stopped")]


def test_it_acts_every_period_on_what_the_topics_say() -> None:
    rig = Rig()
    driver = rig.run(41)
    assert driver.summary.decisions == len(rig.seen) == 21 and driver.summary.stops == 0
    assert rig.begins == [True] + [False] * 20
    observation = rig.seen[-1]
    np.testing.assert_allclose(observation["goal"], [4.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(observation["lidar"], np.full(8, 4.0))
    np.testing.assert_allclose(observation["velocity"], [0.3, 0.0], atol=1e-6)
    # A heading of 0.25 rad turns at the gain of 2 per second; the last command is a stop.
    np.testing.assert_allclose(rig.commands, [(0.8, 0.5)] * 21 + [(0.0, 0.0)], atol=1e-6)
    assert not [line for line in rig.lines if "warning" in line]


def test_limits_hold_and_a_dry_run_commands_nothing() -> None:
    rig = Rig(max_speed_mps=0.6, max_acceleration_mps2=2.0, max_yaw_rate_radps=0.3)
    rig.run(12)
    np.testing.assert_allclose(
        rig.commands,
        [(0.2, 0.3), (0.4, 0.3), (0.6, 0.3), (0.6, 0.3), (0.6, 0.3), (0.6, 0.3), (0, 0)],
        atol=1e-6,
    )
    dry = Rig(dry_run=True)
    dry.run(6)
    assert "/cmd_vel" not in dry.board.written
    assert dry.lines[1:] == [f"{time:.2f} s: 0.800 m/s, 0.500 rad/s" for time in (0.05, 0.15, 0.25)]


def test_stamped_commands_have_a_header() -> None:
    rig = Rig(stamped=True)
    rig.run(5)
    message = rig.board.written["/cmd_vel"][0]
    assert (
        message.__msgtype__ == "geometry_msgs/msg/TwistStamped"
        and message.header.stamp.nanosec == SECOND // 20
    )


@pytest.mark.parametrize(
    ("topic", "said"),
    [
        ("/scan", "stopped: /scan: no message for 0.5"),
        ("/odom", "stopped: /odom: no message for 0.5"),
        ("/tf", "stopped: /tf: the last pose of base_link in map is 0.5"),
    ],
)
def test_a_topic_that_stops_stops_the_robot_until_it_is_back(topic: str, said: str) -> None:
    rig = Rig()

    def cut(turn: int) -> None:
        rig.silent = {topic} if 20 <= turn < 60 else set()

    driver = rig.run(80, cut)
    assert len(rig.stops) == 1 and rig.stops[0].startswith(said), rig.lines
    assert driver.summary.stops == 1 and "driving again" in rig.lines
    assert (0.0, 0.0) in rig.commands[:-1] and rig.commands[-2] != (0.0, 0.0)


def test_a_goal_may_be_old() -> None:
    rig = Rig()
    rig.run(100)
    assert not rig.stops and len(rig.seen) == 50


def test_old_stamps_stop_the_robot() -> None:
    rig = Rig()

    def delay(turn: int) -> None:
        rig.late_s = 0.0 if turn < 20 else 0.8

    rig.run(40, delay)
    assert rig.stops == [
        "stopped: /scan: stamps are 0.80 s behind /clock; synchronise the clocks, or set max_age_s=S"
    ]
    assert rig.commands[-2] == (0.0, 0.0)


def test_stamps_of_a_clock_that_is_not_heeded_are_named() -> None:
    rig = Rig(sim_time=False)
    with pytest.raises(ConfigError, match="behind this machine's clock; there is a /clock: leave sim_time=f"):
        # It waits for what is missing, by this machine's time.
        rig.run(100_000)


@pytest.mark.parametrize(
    ("ranges", "said"),
    [
        (np.full(32, np.nan), "8 of the 8 segments of lidar have only NaN"),
        (np.where(np.arange(32) < 4, np.nan, 4.0), "1 of the 8 segments of lidar have only NaN"),
        (np.zeros(32), "8 of the 8 segments of lidar have only NaN or 0, no measurement"),
        (np.full(5, 4.0), "segments of lidar, which are of 360 degrees, have no beam"),
    ],
)
def test_a_scan_that_does_not_fit_stops_the_robot(ranges: np.ndarray, said: str) -> None:
    rig = Rig()

    def spoil(turn: int) -> None:
        rig.ranges = (np.full(32, 4.0) if turn < 20 else ranges).astype(np.float32)

    rig.run(40, spoil)
    assert len(rig.stops) == 1 and said in rig.stops[0] and "/scan" in rig.stops[0]
    assert rig.commands[-2] == (0.0, 0.0)


def test_an_action_that_is_no_number_stops_the_robot() -> None:
    rig = Rig()

    def spoil(turn: int) -> None:
        rig.action = np.array([np.nan if turn >= 20 else 0.5, 0.0], np.float32)

    rig.run(40, spoil)
    assert len(rig.stops) == 1 and "the policy's action is [nan, 0.0]" in rig.stops[0]
    assert rig.commands[-2] == (0.0, 0.0)
    # A recurrent policy forgets it.
    assert rig.begins[-1]


def test_the_robot_stands_at_the_goal_and_goes_to_the_next() -> None:
    rig = Rig()

    def send(turn: int) -> None:
        if turn in (10, 30):
            types = rig.board.types
            pose = types.pose(_at(1.5 if turn == 10 else 9.0, 0.0, 0.0))
            header = types.header(0, "map")
            rig.board.put("/goal_pose", types.make("geometry_msgs/PoseStamped", header=header, pose=pose))

    driver = rig.run(50, send)
    assert driver.summary.goals == 1 and "goal reached: 0.50 m away" in rig.lines
    assert rig.commands[8] == (0.0, 0.0) and rig.commands[-2] == pytest.approx((0.8, 0.5))
    assert rig.begins.count(True) > 1
    once = Rig(once=True)
    once.goal = (1.5, 0.0)
    assert once.run(50).summary.decisions == 1 and once.turn < 50


def test_a_policy_without_the_distance_stops_at_the_goal_too() -> None:
    parts = {name: part for name, part in INTERFACE.observation.items() if name != "goal"}
    sensors = {name: conf for name, conf in INTERFACE.sensors.items() if name != "goal"}
    rig = Rig(once=True)
    rig.goal = (1.5, 0.0)
    summary = rig.run(
        50, interface=INTERFACE.model_copy(update={"observation": parts, "sensors": sensors})
    ).summary
    assert (summary.decisions, summary.goals) == (1, 1) and rig.seen[0].keys() == {"lidar", "velocity"}


@pytest.mark.parametrize("ticks_last", [False, True])
def test_a_simulation_that_begins_anew_is_followed(ticks_last: bool) -> None:
    rig = Rig()
    rig.ticks_last = ticks_last
    restarted = iter([True])

    def restart(turn: int) -> None:
        if turn == 30 and next(restarted, False):
            rig.turn = 0

    rig.run(40, restart)
    assert len(rig.seen) == 15 + 20 and rig.begins.count(True) == 2 and not rig.stops


@pytest.mark.parametrize("first", [0, 20])
def test_a_clock_that_stands_stops_the_robot_until_it_ticks(
    first: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(wait_s=60.0)
    monkeypatch.setattr(LiveReadings, "clock_stands", property(lambda self: "/clock" in rig.silent))

    def hold_back(turn: int) -> None:
        rig.silent = {"/clock"} if first <= turn < 60 else set()

    rig.run(70, hold_back)
    waiting = ["waiting: /clock: no message yet", "driving"]
    stopping = ["driving", "stopped: /clock stands still", "driving again"]
    assert rig.lines == (stopping if first else waiting)
    assert rig.commands[-2] == pytest.approx((0.8, 0.5))


def test_another_driver_is_named() -> None:
    rig = Rig()
    rig.board.offer("/cmd_vel", "geometry_msgs/Twist")
    rig.run(10)
    assert rig.lines[0].startswith("warning: another program publishes /cmd_vel, too")


def test_another_mount_is_named() -> None:
    rig = Rig()
    rig.mount = np.array([0.5, 0.0, 0.3])
    rig.run(10)
    (line,) = (line for line in rig.lines if "warning" in line)
    assert line == (
        "warning: /scan: laser is at [0.5,0,0.3] m on base_link, and the policy learnt with lidar at "
        "[0.2,0,0.3]; mount it there, or train with sensors.lidar.mount_b=[0.5,0,0.3]"
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rig: rig.board.offered.pop("/scan"), "no topic /scan for lidar, nor another of sensor_msgs"),
        (
            lambda rig: rig.board.offer("/scan", "std_msgs/String"),
            "/scan is of std_msgs/msg/String, and lidar",
        ),
        (
            lambda rig: rig.topics.pop("velocity"),
            "no topic /velocity for velocity; set topics.velocity=TOPIC",
        ),
        (lambda rig: rig.board.offered.clear(), "domain 0: nobody publishes a topic; start the robot"),
        (
            lambda rig: rig.topics.update(sonar="/x"),
            "topics.sonar: the policy reads no sonar, but goal",
        ),
        (lambda rig: rig.silent.add("/scan"), "/scan: no message yet"),
        (lambda rig: rig.silent.add("/tf_static"), "its frame 'laser' has no transform to 'base_link'"),
        (lambda rig: rig.silent.add("/tf"), "its frame 'map' has no transform to 'base_link'"),
        (lambda rig: setattr(rig, "late_s", 3600.0), "/scan: stamps are 3600.00 s behind /clock"),
    ],
)
def test_what_never_fits_is_an_error(change: Callable[[Rig], Any], said: str) -> None:
    rig = Rig()
    change(rig)
    with pytest.raises(ConfigError) as caught:
        rig.run(100_000)
    assert said in str(caught.value) and str(caught.value).count("\n") <= 1
    assert not any(np.any(command) for command in rig.commands)


def test_a_policy_of_joints_cannot_drive() -> None:
    rig = Rig()
    with pytest.raises(ConfigError, match=r"policy.pt: the policy of rover commands no robot by a speed"):
        rig.run(10, interface=INTERFACE.model_copy(update={"vehicle": None}))
