"""Files of trajectories: what is written is read back, and libsdformat finds no fault in it."""

import json
import shutil
import subprocess
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_worlds import wavy_world

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.trajectories.files import Appearance, sdf_text, write_trajectory
from dune_rl.trajectories.plan import plan_on_ground
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.importing.actor_files import read_actor_file

BEND = np.array([[-3.0, -2.0], [0.0, 1.5], [4.0, 0.5]])
ON_GROUND = Appearance("mine.dae", "mine.dae", 0.0)
# Half a unit of the last printed digit, and the rounding of the numbers themselves.
PRINTED = 0.51e-6


@pytest.fixture(scope="module")
def guard() -> ActorTrajectory:
    return plan_on_ground(
        wavy_world(), BEND, pauses_s=np.array([1.0, 0.0, 2.0]), delay_s=0.5, velocity=0.7, name="guard"
    )


def assert_equal(read: ActorTrajectory, written: ActorTrajectory) -> None:
    assert (read.name, read.loop) == (written.name, written.loop)
    assert read.delay_s == pytest.approx(written.delay_s, abs=PRINTED)
    np.testing.assert_allclose(read.times, written.times, rtol=0, atol=PRINTED)
    np.testing.assert_allclose(read.poses[:, :3], written.poses[:, :3], rtol=0, atol=PRINTED)
    turned = (read.poses[:, 3] - written.poses[:, 3] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(turned, 0.0, rtol=0, atol=PRINTED)


@pytest.mark.parametrize("kind", ["sdf", "csv", "json"])
@pytest.mark.parametrize("mode", ["once", "loop", "back_and_forth"])
def test_what_is_written_is_read_back(tmp_path, kind, mode):
    path = tmp_path / f"actor.{kind}"
    actor = plan_on_ground(wavy_world(), BEND, mode=mode, pauses_s=np.array([0.0, 0.4, 0.0]), delay_s=1.25)
    write_trajectory(path, actor, ON_GROUND)
    (read,) = read_actor_file(path)
    assert_equal(read, actor)
    # Turns are the shorter ones, as planned: to the printed digits.
    np.testing.assert_allclose(np.diff(read.poses[:, 3]), np.diff(actor.poses[:, 3]), atol=3e-6)


@settings(max_examples=25, deadline=None)
@given(
    text=st.text(
        st.characters(blacklist_categories=("Cs", "Cc", "Cn", "Zs", "Zl", "Zp", "Cf", "Co")),
        min_size=1,
        max_size=20,
    ),
    kind=st.sampled_from(["sdf", "csv", "json"]),
)
def test_names_and_skins_are_escaped(tmp_path_factory, guard, text, kind):
    path = tmp_path_factory.mktemp("names") / f"actor.{kind}"
    named = ActorTrajectory(text, guard.times, guard.poses, guard.loop, guard.delay_s)
    write_trajectory(path, named, Appearance(f"<{text}&", text, 0.0))
    (read,) = read_actor_file(path)
    assert read.name == text
    if kind == "sdf":
        root = ElementTree.parse(path).getroot()
        assert root.findtext("actor/skin/filename") == f"<{text}&"


def test_the_origin_of_the_skin_is_above_the_ground(guard, tmp_path):
    (tmp_path / "a.sdf").write_text(sdf_text(guard))
    (read,) = read_actor_file(tmp_path / "a.sdf")
    np.testing.assert_allclose(read.poses[:, 2] - guard.poses[:, 2], 1.0, atol=PRINTED)
    assert read.set_on_ground(wavy_world().terrain).on_ground


def test_several_actors_and_bare_columns_are_read(tmp_path):
    path = tmp_path / "two.csv"
    path.write_text(
        "actor,time_s,x_m,y_m,z_m,yaw_rad\na,0,0,0,0,0\nb,1,5,0,0,0\na,2,1,0,0,0\nb,3,6,0,0,0\na,4,0,0,0,0\n"
    )
    with pytest.warns(
        WorldWarning, match="the loop of the actor 'b' ends 1.0 m from its start: it walks back"
    ):
        first, second = read_actor_file(path)
    assert (first.name, first.loop, first.delay_s) == ("a", True, 0.0)
    np.testing.assert_array_equal(first.times, [0, 2, 4])
    # It stands until its first time.
    assert second.delay_s == 1.0 and second.times[1] == 2.0


BAD = {
    "none.csv": ("time_s,x_m\n1,2\n", "none.csv has no column y_m, z_m, yaw_rad"),
    "word.csv": ("time_s,x_m,y_m,z_m,yaw_rad\n0,a,0,0,0\n", "has 'a' for x_m in line 2: write a number"),
    "nan.csv": ("time_s,x_m,y_m,z_m,yaw_rad\n0,nan,0,0,0\n", "has numbers that are not finite"),
    "back.csv": ("time_s,x_m,y_m,z_m,yaw_rad\n1,0,0,0,0\n1,1,0,0,0\n", "times that rise from pose to pose"),
    "loop.csv": (
        "loop,time_s,x_m,y_m,z_m,yaw_rad\nmaybe,0,0,0,0,0\n",
        "for loop in line 2: write true or fal",
    ),
    "empty.csv": ("time_s,x_m,y_m,z_m,yaw_rad\n", "has no actors with trajectories"),
    "bytes.csv": (b"\xff\xfe\x00", "is no CSV file"),
    "list.json": ("[1]", "is no file of trajectories"),
    "extra.json": ('{"actors": [], "more": 1}', "is no file of trajectories"),
    "short.json": (
        json.dumps({"actors": [{"times_s": [0, 1], "poses": [[0, 0, 0, 0]]}]}),
        "as many times as poses",
    ),
    "far.json": (
        json.dumps({"actors": [{"times_s": [0], "poses": [[1e9, 0, 0, 0]]}]}),
        "farther off than 1e.06 m",
    ),
    "late.json": (
        json.dumps({"actors": [{"times_s": [0], "poses": [[0, 0, 0, 0]], "delay_s": -1}]}),
        "needs a delay_s of 0",
    ),
    "entity.sdf": (
        '<!DOCTYPE a [<!ENTITY b "c">]><sdf version="1.7"><actor name="&b;"/></sdf>',
        "declares XML ent",
    ),
    "model.sdf": ('<sdf version="1.7"><model name="m"/></sdf>', "has no actors with trajectories"),
    "a.txt": ("", "is no file of trajectories: .txt is none of .sdf, .csv, .json"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_file_that_is_none_is_refused(tmp_path, name):
    content, message = BAD[name]
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(WorldError, match=message):
        read_actor_file(path)
    with pytest.raises(WorldError, match="there is no file"):
        read_actor_file(tmp_path / "absent.csv")


@pytest.mark.skipif(shutil.which("ign") is None, reason="needs ign sdf (ignition-tools, libsdformat-dev)")
def test_libsdformat_finds_no_fault_and_reads_the_same_way_points(tmp_path, guard):
    path = tmp_path / "actor.sdf"

    def ign(flag: str) -> str:
        done = subprocess.run(["ign", "sdf", flag, str(path)], capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    # What libsdformat prints is not escaped, so that such a name is checked alone.
    for name in ('a "guard" & <more>', guard.name):
        named = ActorTrajectory(name, guard.times, guard.poses, guard.loop, guard.delay_s)
        path.write_text(sdf_text(named))
        assert ign("-k").strip().endswith("Valid.")
    text = ign("-p")
    root = ElementTree.fromstring(text[text.index("<sdf") :])
    assert root.find("actor").get("name") == guard.name
    assert float(root.findtext("actor/script/delay_start")) == guard.delay_s
    points = root.findall("actor/script/trajectory/waypoint")
    times = np.array([float(point.findtext("time")) for point in points])
    poses = np.array([[float(word) for word in point.findtext("pose").split()] for point in points])
    np.testing.assert_allclose(times, guard.times, rtol=1e-5, atol=2e-6)
    np.testing.assert_allclose(poses[:, :2], guard.poses[:, :2], rtol=1e-5, atol=2e-6)
    np.testing.assert_allclose(poses[:, 2], guard.poses[:, 2] + 1.0, rtol=1e-5, atol=2e-6)
    turned = (poses[:, 5] - guard.poses[:, 3] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(turned, 0.0, atol=2e-5)
