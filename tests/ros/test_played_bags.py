"""A bag plays into a policy: actions are those of the evaluation, and what is missing is named."""

import csv
import importlib.util
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="no rosbags: pip install 'dune_rl[ros]'")

from bags import read_with_rosbags, rewrite
from documents import ROOT

from dune_rl import drive, evaluate, export
from dune_rl.clients.bag_player import actions_from_bag
from dune_rl.clients.driven_policy import load_driven_policy
from dune_rl.clients.policy_interface import PolicyInterface
from dune_rl.core.errors import ConfigError, DuneWarning
from dune_rl.learning.checkpoint import read_policy_file
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.ros.library import message_types
from dune_rl.ros.transforms import MAP

Call = Callable[..., int]
POLICY = ROOT / "experiments" / "inspection" / "policy.pt"
SHORT = (
    "world=obstacle_course",
    "actors=none",
    "task.terminations.time_limit.max_steps=12",
    "scenes=2",
    "seed=4",
)
# Of a network, which sums in another order for one robot than for several.
CLOSE = {"rtol": 1e-5, "atol": 1e-5}


def evaluated_actions(results: Path, policy: str, episode: int, agent: str = "rover_0") -> np.ndarray:
    rows = csv.DictReader((results / "steps.csv").read_text().splitlines())
    return np.array(
        [
            [float(row["action_0"]), float(row["action_1"])]
            for row in rows
            if (row["policy"], row["episode"], row["agent"]) == (policy, str(episode), agent)
        ]
    )


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the results of an evaluation, and its bags."""
    folder = tmp_path_factory.mktemp("evaluated")
    words = [f"checkpoint={POLICY}", *SHORT, "episodes=2", "steps=true"]
    words += [f"out={folder / 'results'}", f"bag={folder / 'bags'}"]
    before, sys.argv = sys.argv, ["dune_rl", *words]
    try:
        with pytest.raises(SystemExit) as ended:
            evaluate.main()
    finally:
        sys.argv = before
    assert not ended.value.code
    return folder


@pytest.fixture
def bag(evaluated: Path) -> Path:
    return evaluated / "bags" / "inspection" / "episode_1"


def test_actions_are_those_of_the_evaluation(evaluated: Path) -> None:
    for episode in (0, 1):
        found = actions_from_bag(evaluated / "bags" / "inspection" / f"episode_{episode}", POLICY)
        expected = evaluated_actions(evaluated / "results", "inspection", episode)
        assert expected.shape == (12, 2) and np.ptp(expected, axis=0).min() > 0.0
        np.testing.assert_allclose(found.actions, expected, **CLOSE)
        np.testing.assert_allclose(found.times_s, np.arange(12) * 0.05, atol=1e-9)


def test_the_command_writes_and_prints_them(
    evaluated: Path, bag: Path, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [f"bag={bag}", f"checkpoint={POLICY}"]
    assert call(drive.main, *words) == 0
    printed = capsys.readouterr().out
    assert call(drive.main, *words, "out=new/actions.csv") == 0
    assert "12 actions" in capsys.readouterr().out
    assert (folder / "new" / "actions.csv").read_text().splitlines() == printed.splitlines()
    rows = list(csv.DictReader(printed.splitlines()))
    assert [float(row["time_s"]) for row in rows[:2]] == [0.0, 0.05]
    expected = evaluated_actions(evaluated / "results", "inspection", 1)
    np.testing.assert_allclose([float(row["action_1"]) for row in rows], expected[:, 1], **CLOSE)
    assert call(drive.main, *words, "out=new/actions.csv") == 2
    assert "overwrite=true" in capsys.readouterr().err
    assert call(drive.main, *words, "out=new/actions.csv", "overwrite=true") == 0


@pytest.mark.slow
def test_a_bag_plays_into_an_onnx_file(
    evaluated: Path, bag: Path, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    assert call(export.main, f"checkpoint={POLICY}", "out=policy.onnx") == 0
    capsys.readouterr()
    assert call(drive.main, f"bag={bag}", "policy=policy.onnx") == 0
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    expected = evaluated_actions(evaluated / "results", "inspection", 1)
    np.testing.assert_allclose([float(row["action_1"]) for row in rows], expected[:, 1], atol=1e-4)
    interface = PolicyInterface.of_run(*spec_and_config(POLICY))
    policy = load_driven_policy(onnx=folder / "policy.onnx")
    assert policy.interface == interface
    assert interface.vehicle is not None and interface.goal_m == 0.75


def spec_and_config(checkpoint: Path) -> tuple[PolicySpec, str, dict[str, Any]]:
    content = read_policy_file(checkpoint)[1]
    ((name, entry),) = content["groups"].items()
    return PolicySpec.from_plain(entry["spec"]), name, content["config"]


def other_robot(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
    """As a robot of others records: its own names, a goal as a pose, speeds of odometry, no past scans."""
    if topic == "/scan":
        message.header.frame_id = "laser"
        yield "/front/scan", message
    elif topic == "/tf_static":
        for each in message.transforms:
            each.child_frame_id = {"lidar_link": "laser"}.get(each.child_frame_id, each.child_frame_id)
        yield topic, message
    elif topic == "/imu":
        yield "/imu/data", message
    elif not topic.startswith("/observation") and topic not in ("/velocity", "/clock", "/action"):
        yield topic, message


def test_a_bag_of_another_robot_plays_by_its_topics(evaluated: Path, bag: Path, tmp_path: Path) -> None:
    other = rewrite(bag, tmp_path / "other", other_robot)
    topics = {"lidar": "/front/scan", "imu": "/imu/data", "goal": "/goal_pose", "velocity": "/odom"}
    found = actions_from_bag(other, POLICY, topics=topics)
    expected = evaluated_actions(evaluated / "results", "inspection", 1)
    # The odometry is the truth here, and so is the goal; the past scan follows from the scans.
    np.testing.assert_allclose(found.actions, expected, rtol=1e-4, atol=1e-4)


def test_a_turned_scanner_with_more_beams_sees_the_same(evaluated: Path, bag: Path, tmp_path: Path) -> None:
    def turned(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
        if topic == "/scan":
            # Backwards, and each beam twice.
            message.ranges = np.repeat(np.roll(message.ranges, 64), 2)
            message.angle_increment /= 2
            message.angle_min -= message.angle_increment / 2
        if topic == "/tf_static":
            for each in message.transforms:
                if each.child_frame_id == "lidar_link":
                    rotation = each.transform.rotation
                    rotation.z, rotation.w = 1.0, 0.0
        yield topic, message

    found = actions_from_bag(rewrite(bag, tmp_path / "turned", turned), POLICY)
    np.testing.assert_allclose(
        found.actions, evaluated_actions(evaluated / "results", "inspection", 1), **CLOSE
    )


def without(name: str) -> Any:
    def change(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
        return [] if topic == name else [(topic, message)]

    return change


def renamed(name: str, to: str) -> Any:
    def change(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
        return [(to if topic == name else topic, message)]

    return change


def halved(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
    if topic == "/scan":
        message.ranges = message.ranges[:64]
    yield topic, message


def of_another_frame(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
    if topic == "/scan":
        message.header.frame_id = "laser"
    yield topic, message


def without_orientation(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
    if topic == "/imu":
        message.orientation_covariance = np.full(9, -1.0)
    yield topic, message


def of_zeros(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
    if topic == "/imu":
        rotation = message.orientation
        rotation.x = rotation.y = rotation.z = rotation.w = 0.0
    yield topic, message


def without_turn(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
    if topic == "/tf_static":
        for each in message.transforms:
            each.transform.rotation.w = 0.0
    yield topic, message


def without_angles(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
    if topic == "/scan":
        message.angle_increment = np.nan
    yield topic, message


def of_another_map(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
    if topic == "/goal_pose":
        assert message.header.frame_id == MAP
        message.header.frame_id = "utm"
    yield topic, message


def as_text(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
    if topic == "/scan":
        message = message_types().make("std_msgs/String", data="12 m")
    yield topic, message


@pytest.mark.parametrize(
    ("change", "topics", "sentences"),
    [
        (
            renamed("/scan", "/front/scan"),
            {},
            ["there is no topic /scan for lidar; set topics.lidar=TOPIC, such as /front/scan"],
        ),
        (without("/imu"), {}, ["no topic /imu for imu, nor another of sensor_msgs/msg/Imu; record one"]),
        (
            without("/velocity"),
            {},
            ["there is no topic /velocity for velocity; set topics.velocity=TOPIC, such as", "/odom"],
        ),
        (as_text, {}, ["/scan is of std_msgs/msg/String, and lidar is read from sensor_msgs/msg/LaserScan"]),
        (without("/none"), {"lidar": "/imu"}, ["/imu is of sensor_msgs/msg/Imu, and lidar is read from"]),
        (without("/none"), {"lidar": "/front"}, ["there is no topic /front for lidar"]),
        (without("/none"), {"sonar": "/front"}, ["topics.sonar: the policy reads no sonar, but goal"]),
        (halved, {}, ["/scan at 0.000 s does not fit lidar: 16 of the 32 segments", "360 degrees"]),
        (of_another_frame, {}, ["its frame 'laser' has no transform to 'base_link' in /tf_static"]),
        (without_orientation, {}, ["/imu at 0.000 s does not fit imu: it has no orientation"]),
        (
            of_zeros,
            {},
            ["/imu at 0.000 s does not fit imu: its orientation (0, 0, 0, 0) is no unit quaternion"],
        ),
        (without_turn, {}, ["its frame 'lidar_link' has no transform to 'base_link' in /tf_static"]),
        (without_angles, {}, ["/scan at 0.000 s does not fit lidar: the angles of its beams are not finite"]),
        (of_another_map, {"goal": "/goal_pose"}, ["its frame 'utm' has no transform to 'base_link'"]),
    ],
)
def test_what_does_not_fit_is_named(
    change: Any, topics: dict[str, str], sentences: list[str], bag: Path, tmp_path: Path
) -> None:
    other = rewrite(bag, tmp_path / "other", change)
    with pytest.raises(ConfigError) as caught:
        actions_from_bag(other, POLICY, topics=topics)
    message = str(caught.value)
    assert all(sentence in message for sentence in sentences), message
    assert message.count("\n") <= 1


def test_a_topic_that_stops_is_named(bag: Path, tmp_path: Path) -> None:
    def first_alone(topic: str, message: Any) -> Iterable[tuple[str, Any]]:
        return [] if topic == "/scan" and message.header.stamp.nanosec else [(topic, message)]

    with pytest.warns(
        DuneWarning, match=r"/scan: no message for 0.55 s from 0.00 s on.* would stand"
    ) as warned:
        actions_from_bag(rewrite(bag, tmp_path / "stopped", first_alone), POLICY)
    assert len(warned) == 1


def test_what_is_no_bag_is_named(
    bag: Path, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "broken").mkdir()
    (folder / "broken" / "metadata.yaml").write_text("- nothing\n")
    content = bytearray((bag / f"{bag.name}.mcap").read_bytes())
    # The beginning of a compressed chunk.
    start = content.index(b"\x28\xb5\x2f\xfd")
    content[start : start + 4] = b"none"
    (folder / "damaged.mcap").write_bytes(content)
    (folder / "bare").mkdir()
    (folder / "bare" / "a.mcap").write_bytes(content)
    (folder / "cut.mcap").write_bytes((bag / f"{bag.name}.mcap").read_bytes()[:5000])
    for path, sentence in (
        ("absent", "bag=absent: there is no such bag"),
        ("broken", "bag=broken is no bag that can be read"),
        ("cut.mcap", "bag=cut.mcap is no bag that can be read"),
        ("damaged.mcap", "bag=damaged.mcap is damaged"),
        ("bare", "bag=bare has no metadata.yaml; give the file in it, bag=bare/a.mcap"),
        (bag.parent, f"is a folder of bags; give one, such as bag={bag.parent / 'episode_0'}"),
    ):
        assert call(drive.main, f"bag={path}", f"checkpoint={POLICY}") == 2
        error = capsys.readouterr().err
        assert sentence in error and "Traceback" not in error and error.count("\n") <= 2
    for words, sentence in (
        ([f"bag={bag}"], "give one policy, checkpoint=PATH or policy=FILE.onnx"),
        (["bag"], "write key=value"),
        ([f"bag={bag}", f"checkpoint={POLICY}", "perod_s=1"], "period_s"),
        ([f"bag={bag}", f"checkpoint={POLICY}", "period_s=0"], "period_s"),
        ([f"bag={bag}", f"checkpoint={POLICY}", "policy=a.onnx"], "give one policy"),
        ([f"bag={bag}", "checkpoint=p.onnx"], "checkpoint=p.onnx is an ONNX file: write policy=p.onnx"),
        ([f"bag={bag}", f"policy={POLICY}"], "must end in .onnx; a run's is checkpoint="),
        ([f"bag={bag}", f"checkpoint={POLICY}", "domain=3"], "domain is of live topics: leave bag out"),
        ([f"checkpoint={POLICY}", "out=a.csv"], "out is of bags: give bag=FOLDER"),
        ([f"checkpoint={POLICY}", "domain=233"], "domain"),
        ([f"bag={bag}", "checkpoint=absent.pt"], "absent.pt"),
    ):
        assert call(drive.main, *words) == 2
        assert sentence in capsys.readouterr().err


def test_the_file_alone_is_a_bag(bag: Path) -> None:
    found = actions_from_bag(bag / f"{bag.name}.mcap", POLICY)
    assert len(found.actions) == 12
    fewer = actions_from_bag(bag, POLICY, period_s=0.2)
    np.testing.assert_allclose(fewer.actions[0], found.actions[0], **CLOSE)
    assert len(fewer.actions) == 3


def test_bags_are_not_replaced_unasked(
    evaluated: Path, call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [f"checkpoint={POLICY}", *SHORT, "episodes=2", f"bag={evaluated / 'bags'}", "out=again"]
    assert call(evaluate.main, *words) == 2
    error = capsys.readouterr().err
    assert "episode_0 already; choose another folder, or replace its bags with overwrite=true" in error
    assert not (folder / "again").exists()
    for more, sentence in (
        (["protocol=paper"], "leave it out, or protocol"),
        (["cross_play=true", "populations=none"], "leave it out, or cross_play"),
        (["scenes=500"], "set scenes=256 or fewer"),
        (["bag=again/bags"], "bag=again/bags lies in out=again"),
    ):
        taken = [word for word in words if not word.startswith(("episodes", "scenes", more[0][:6]))]
        count = ["episodes=600"] if more[0].startswith("scenes") else []
        assert call(evaluate.main, *taken, *count, *more) == 2
        assert sentence in capsys.readouterr().err


FAILING = """
from pathlib import Path
import numpy as np
calls = []

def act(observation):
    calls.append(1)
    if len(calls) > int(Path("calls.txt").read_text()):
        raise ValueError("enough")
    return np.zeros((len(observation["goal"]), 2))
"""


def test_a_bag_appears_when_it_is_complete(
    call: Call, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "failing.py").write_text(FAILING)
    monkeypatch.syspath_prepend(folder)
    words = ["+world=flat", "actors=none", "task.terminations.time_limit.max_steps=12", "episodes=2"]
    words += ["policy=failing:act", "scenes=1", "bag=bags"]
    for calls, done in ((5, []), (20, ["episode_0"])):
        (folder / "calls.txt").write_text(str(calls))
        sys.modules.pop("failing", None)
        assert call(evaluate.main, *words, "out=results") == 2
        assert "enough" in capsys.readouterr().err
        assert [path.name for path in folder.glob("bags/act/*")] == done
        assert (folder / "bags").exists() == bool(done)
    first = (folder / "bags" / "act" / "episode_0" / "episode_0.mcap").read_bytes()
    (folder / "calls.txt").write_text("1000")
    assert call(evaluate.main, "resume=results", "policy=failing:act") == 0
    assert "Bags: bags\n" in capsys.readouterr().out
    assert sorted(path.name for path in folder.glob("bags/act/*")) == ["episode_0", "episode_1"]
    assert (folder / "bags" / "act" / "episode_0" / "episode_0.mcap").read_bytes() == first


@pytest.mark.slow
def test_parts_share_a_folder(call: Call, folder: Path) -> None:
    words = ["+world=flat", "actors=none", "task.terminations.time_limit.max_steps=12", "episodes=4"]
    words += ["policy=go_to_goal", "scenes=2", "bag=bags"]
    for part in (1, 2):
        assert call(evaluate.main, *words, f"part={part}/2", f"out=parts/{part}") == 0
    assert len(list(folder.glob("bags/go_to_goal/episode_*"))) == 4
    assert call(evaluate.main, "join=parts", "out=joined") == 0
    assert (folder / "joined" / "episodes.csv").exists()


@pytest.mark.slow
def test_every_policy_and_process_writes_the_same_bags(call: Call, folder: Path) -> None:
    words = [f"checkpoint={POLICY}", "against=go_to_goal", *SHORT, "episodes=5"]
    for name, more in (("one", []), ("two", ["processes=2"])):
        assert call(evaluate.main, *words, f"bag={name}", f"out=results_{name}", *more) == 0
    found = {path.relative_to("one"): path for path in Path("one").rglob("*") if path.is_file()}
    assert len(found) == 2 * 5 * 2
    assert {path.relative_to("two") for path in Path("two").rglob("*") if path.is_file()} == {*found}
    for name, path in found.items():
        assert path.read_bytes() == (Path("two") / name).read_bytes(), name
    assert call(evaluate.main, "verify=results_one", "sample=2") == 0
    assert call(evaluate.main, *words, "bag=one", "out=results_one", "overwrite=true") == 0
    assert not [path for path in Path("one").rglob("*") if path.name.startswith(".")]
    for name in found:
        assert (Path("one") / name).read_bytes() == (Path("two") / name).read_bytes(), name


@pytest.mark.slow
def test_robots_that_share_a_policy_play_one_by_one(call: Call, folder: Path) -> None:
    words = [f"checkpoint={POLICY}", *SHORT, "episodes=1", "steps=true", "agents.rover.count=2"]
    assert call(evaluate.main, *words, "bag=bags", "out=results") == 0
    bag = folder / "bags" / "inspection" / "episode_0"
    for robot in ("rover_0", "rover_1"):
        found = actions_from_bag(bag, POLICY, robot=robot)
        expected = evaluated_actions(folder / "results", "inspection", 0, robot)
        np.testing.assert_allclose(found.actions, expected, **CLOSE)
    with pytest.raises(ConfigError, match="set robot=rover_0 or topics"):
        actions_from_bag(bag, POLICY)
    assert {"/rover_0/scan", "/rover_1/scan"} <= {*read_with_rosbags(bag)}


def test_what_needs_rosbags_says_so(
    call: Call,
    folder: Path,
    bag: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in [*sys.modules]:
        if name.partition(".")[0] == "rosbags":
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    assert importlib.util.find_spec("dune_rl.ros.library") is not None
    for program, words in (
        (evaluate, ["policy=go_to_goal", "+world=flat", "bag=bags", "out=results"]),
        (drive, [f"bag={bag}", f"checkpoint={POLICY}"]),
    ):
        assert call(program.main, *words) == 2
        assert capsys.readouterr().err == "bag=FOLDER needs rosbags: pip install 'dune_rl[ros]'\n"
    assert not list(folder.iterdir())
