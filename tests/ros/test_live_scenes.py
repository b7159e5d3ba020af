"""A scene on live topics: commands and goals come in, episodes end, and messages are those of bags."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="no rosbags: pip install 'dune_rl[ros]'")

from bags import read_with_rosbags, record
from hypothesis import given
from hypothesis import strategies as st
from live_topics import TopicBoard

from dune_rl.config.build import make_simulation
from dune_rl.config.commands import RosConf
from dune_rl.config.compose import compose
from dune_rl.config.endless import without_ends
from dune_rl.core.errors import ConfigError
from dune_rl.ros.dds import Offer
from dune_rl.ros.live_scene import LiveScene, LiveSummary
from dune_rl.ros.transforms import Pose
from dune_rl.ros.velocity_commands import TWIST_STAMPED, VelocityCommands, action_of_twist, twist_of_action
from dune_rl.state.unicycle import Unicycle

ROVER = Unicycle(-1.0, 1.0, 2.0, 2.0, 0.5, 0.4, 0.3)


class Stage:
    """A live scene on a board of topics, which the test steps."""

    def __init__(self, *words: str) -> None:
        conf = compose(RosConf, ["+world=flat", "actors=none", "speed=0", *words])
        self.board, self.lines = TopicBoard(), list[str]()
        self.simulation = make_simulation(without_ends(conf), 1, conf.seed)
        tasks = {group.name: group.task for group in conf.external_groups}
        self.conf = conf
        self._make = lambda duration_s: LiveScene(
            self.simulation,
            tasks,
            self.board,  # type: ignore[arg-type]
            conf.model_copy(update={"duration_s": duration_s}),
            self.lines.append,
        )

    def run(self, duration_s: float, each_step: Callable[[int], None] | None = None) -> LiveSummary:
        """How a scene ran from its start; `each_step` is called before each control step."""
        scene = self._make(duration_s)
        await_turn, count = scene._await_turn, iter(range(10_000))

        def turn() -> None:
            if each_step is not None:
                each_step(next(count))
            await_turn()

        scene._await_turn = turn  # type: ignore[method-assign]
        return scene.run()

    def twist(self, speed: float, turn: float) -> Any:
        return self.board.types.planar_twist(speed, turn)

    def goal(self, x: float, y: float, frame: str = "map") -> Any:
        types = self.board.types
        pose = types.pose(Pose(np.array([x, y, 0.0]), np.eye(3)))
        return types.make("geometry_msgs/PoseStamped", header=types.header(0, frame), pose=pose)

    @property
    def truth(self) -> Any:
        return self.board.last("/ground_truth/odom")


@pytest.fixture
def stage() -> Iterator[Callable[..., Stage]]:
    made: list[Stage] = []

    def make(*words: str) -> Stage:
        made.append(Stage(*words))
        return made[-1]

    yield make
    for each in made:
        each.simulation.close()


@given(speed=st.floats(-1.0, 1.0), heading=st.floats(-1.0, 1.0))
def test_an_action_survives_the_way_over_a_twist(speed: float, heading: float) -> None:
    twist = twist_of_action(ROVER, np.array([speed, heading]))
    np.testing.assert_allclose(action_of_twist(ROVER, *twist), [speed, heading], atol=1e-12)


@given(speed=st.floats(-50.0, 50.0), turn=st.floats(-50.0, 50.0))
def test_commands_stay_within_what_the_robot_can_do(speed: float, turn: float) -> None:
    back = twist_of_action(ROVER, action_of_twist(ROVER, speed, turn))
    np.testing.assert_allclose(back, np.clip([speed, turn], [-1.0, -2.0], [1.0, 2.0]), atol=1e-12)


def test_a_robot_stands_without_fresh_commands_and_at_nan() -> None:
    lines: list[str] = []
    commands = VelocityCommands(ROVER, 0.5, "/cmd_vel", lines.append)
    twist = TopicBoard().types.planar_twist
    assert not commands.action(0).any()
    commands.take(twist(0.5, 0.0), 1_000_000_000)
    assert commands.action(1_500_000_000).tolist() == [0.5, 0.0] and not lines
    assert not commands.action(1_500_000_001).any()
    assert len(lines) == 1 and "/cmd_vel: no command for 0.5 s" in lines[0]
    for _ in range(2):
        commands.take(twist(0.5, np.nan), 2_000_000_000)
        assert not commands.action(2_000_000_000).any()
    assert len(lines) == 2 and "nan" in lines[1]
    commands.take(twist(0.2, 0.0), 3_000_000_000)
    assert commands.action(3_000_000_000).tolist() == [0.2, 0.0]


def test_a_robot_follows_twists_and_stops_without_them(stage: Any) -> None:
    driven = stage()

    def command(step: int) -> None:
        if step < 60:
            driven.board.put("/cmd_vel", driven.twist(0.4, 0.5))
        if step == 60:
            speeds.append(driven.truth.twist.twist)

    speeds: list[Any] = []
    summary = driven.run(5.0, command)
    assert speeds[0].linear.x == pytest.approx(0.4, abs=0.08)
    assert speeds[0].angular.z == pytest.approx(0.5, abs=0.08)
    assert abs(driven.truth.twist.twist.linear.x) < 0.05
    assert summary.commands == 60 and summary.steps == 100
    assert sum("no command for 0.5 s" in line for line in driven.lines) == 1
    stamps = [
        message.clock.sec * 20 + message.clock.nanosec // 50_000_000
        for message in driven.board.written["/clock"]
    ]
    assert stamps == list(range(101))
    # Drivers choose their time when they find the other topics.
    assert next(iter(driven.board.written)) == "/clock"


def test_stamped_commands_and_several_robots(stage: Any) -> None:
    pair = stage("stamped=true", "agents.rover.count=2")

    def command(step: int) -> None:
        header = pair.board.types.header(0, "")
        twist = pair.twist(0.5, 0.0)
        message = pair.board.types.make("geometry_msgs/TwistStamped", header=header, twist=twist)
        pair.board.put("/rover_1/cmd_vel", message)

    pair.run(2.0, command)
    speeds = [pair.board.last(f"/rover_{number}/ground_truth/odom").twist.twist.linear.x for number in (0, 1)]
    assert abs(speeds[0]) < 0.05 and speeds[1] == pytest.approx(0.5, abs=0.1)


def test_goals_are_taken_in_the_map_alone(stage: Any) -> None:
    given = stage()

    def send(step: int) -> None:
        if step == 5:
            given.board.put("/goal_pose", given.goal(1.5, -2.0, "odom"))
            given.board.put("/goal_pose", given.goal(np.nan, 0.0))
        if step == 10:
            given.board.put("/goal_pose", given.goal(1.5, -2.0))

    given.run(1.0, send)
    goals = [(each.pose.position.x, each.pose.position.y) for each in given.board.written["/goal_pose"]]
    assert len(goals) == 2 and goals[1] == (1.5, -2.0) and "/goal_pose" in given.board.latched
    at = given.truth.pose.pose.position
    seen = given.board.last("/observation/goal").data
    assert seen[0] == pytest.approx(np.hypot(1.5 - at.x, -2.0 - at.y), abs=1e-4)
    assert any("frame 'odom' is left out; send it in 'map'" in line for line in given.lines)
    assert any("a goal at nan" in line for line in given.lines)


@pytest.mark.parametrize("on_end", ["stay", "reset"])
def test_what_happens_at_an_end(stage: Any, on_end: str) -> None:
    ended = stage(f"on_end={on_end}", "task.terminations.time_limit.max_steps=20")
    places: list[tuple[float, float]] = []

    def look(step: int) -> None:
        at = ended.truth.pose.pose.position
        places.append((at.x, at.y))

    summary = ended.run(2.5, look)
    assert sum("time limit" in line for line in ended.lines) == (1 if on_end == "stay" else 2)
    assert summary.episodes == (1 if on_end == "stay" else 3)
    moved = np.hypot(*(np.array(places[45]) - places[0]))
    assert moved < 0.1 if on_end == "stay" else moved > 0.3
    # Time never goes back.
    times = [each.clock.sec + 1e-9 * each.clock.nanosec for each in ended.board.written["/clock"]]
    assert (np.diff(times) >= 0.0).all() and times[-1] == pytest.approx(2.5)


def test_a_message_begins_the_next_episode(stage: Any) -> None:
    told = stage()

    def send(step: int) -> None:
        if step == 10:
            told.board.put(
                "/reset", told.board.types.make("std_msgs/Empty", structure_needs_at_least_one_member=0)
            )

    assert told.run(1.0, send).episodes == 2
    assert [line for line in told.lines if "begins" in line] == [
        "episode 0 begins at 0.00 s",
        "episode 1 begins at 0.50 s",
    ]


def test_commands_of_another_type_are_named(stage: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dune_rl.ros.live_scene._CHECK_S", 0.0)
    wrong = stage()
    wrong.board.offered["/cmd_vel"] = [Offer(TWIST_STAMPED, True, False)]
    wrong.run(0.2)
    first, second, line = (line for line in wrong.lines if "/cmd_vel" in line or "/clock" in line)
    assert first.startswith("publishes /clock, ") and second == "waits for commands on /cmd_vel"
    kinds = (f"geometry_msgs/msg/{name}" for name in ("TwistStamped", "Twist"))
    assert line == "/cmd_vel is published as {}, and read as {}; set stamped=true".format(*kinds)


def test_joints_have_no_twist(stage: Any) -> None:
    legged = stage("robot=hyperdog", "robot.action=joints")
    with pytest.raises(ConfigError, match=r"has 12 components; leave robot\.action out"):
        legged.run(0.1)


def test_messages_are_those_of_bags(stage: Any, tmp_path: Any) -> None:
    """The same first moment: a bag of an evaluation and live topics have equal messages."""
    words = ("+world=flat", "actors=none", "seed=4")
    live = stage(*words[1:])
    live.run(0.01)
    recorded = record(tmp_path / "bags", *words, seed=4)
    bag = read_with_rosbags(recorded.bag())
    # Commands come from others, and are in the bag alone.
    assert {*bag} - {*live.board.written} == {"/cmd_vel"} and {*live.board.written} <= {*bag}
    serialize = live.board.types.serialize
    for topic in {*live.board.written} - {"/action"}:
        first = live.board.written[topic][0]
        assert bytes(serialize(first)) == bytes(serialize(bag[topic][0][1])), topic
