"""The command that exports worlds and robots: what it writes and says, and what it refuses."""

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from libsdformat import assert_valid

from dune_rl import export
from dune_rl.commands.command_line import python_here
from dune_rl.gazebo import scene

Call = Callable[..., int]
SITE = ("world=flat", "world.size_m=20", "duration_s=1")


def test_a_world_with_its_robot_is_written(folder: Path, call: Call, capsys) -> None:
    assert call(export.main, *SITE, "robot=rover_zero", "out=site") == 0
    said = capsys.readouterr().out
    assert "site/world.sdf: 0 objects, 2 actors" in said
    assert "left out: the sensors lidar_past, goal, velocity" in said
    assert f"export GZ_SIM_RESOURCE_PATH={folder / 'site'}" in said
    assert [path.name for path in folder.iterdir()] == ["site"]
    assert_valid(folder / "site" / "world.sdf", folder / "site")
    told = json.loads((folder / "site" / "export.json").read_text())
    assert told["entries"] == ["meshes", "rover_zero", "world.sdf"]
    assert told["settings"]["world"]["size_m"] == 20.0
    before = (folder / "site" / "world.sdf").read_bytes()
    assert call(export.main, *SITE, "robot=rover_zero", "out=site") == 2
    assert "holds an export already; choose another folder, or add overwrite=true" in capsys.readouterr().err
    assert (folder / "site" / "world.sdf").read_bytes() == before
    # Another export takes its place as a whole.
    assert call(export.main, *SITE, "actors=none", "out=site", "overwrite=true") == 0
    assert sorted(path.name for path in (folder / "site").iterdir()) == ["export.json", "meshes", "world.sdf"]
    assert [path.name for path in folder.iterdir()] == ["site"]


@pytest.mark.slow
def test_a_robot_alone_is_written(folder: Path, call: Call, capsys) -> None:
    assert call(export.main, "robot=leo_rover", "out=robots") == 0
    assert sorted(path.name for path in (folder / "robots").iterdir()) == ["export.json", "leo_rover"]
    assert sorted(path.name for path in (folder / "robots" / "leo_rover").iterdir()) == [
        "leo_rover.urdf", "meshes", "model.config", "model.sdf",
    ]  # fmt: skip


# Of the plugins that Gazebo needs.
@pytest.mark.filterwarnings("default::dune_rl.core.untrusted_files.WorldWarning")
@pytest.mark.slow
def test_what_is_read_back_is_said(folder: Path, call: Call, capsys) -> None:
    assert call(export.main, *SITE, "world.surfaces=natural", "actors=none", "out='my site'") == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("read back: "))
    assert line == (
        f"read back: {python_here()} -m dune_rl.view +world=sdf 'world.path=\"my site/world.sdf\"' "
        "world.spacing_m=5 'world.region=[-4,4,-4,4]' 'world.surface_map=\"my site/surfaces.png\"'"
    )
    assert call(export.main, *shlex.split(line)[5:], "actors=none", "out=again") == 0
    # SDF reserves the name `world`.
    assert '<world name="sdf_world">' in (folder / "again" / "world.sdf").read_text()


@pytest.mark.slow
def test_actors_go_on_to_further_goals(folder: Path, call: Call) -> None:
    guest = "+actors.guest={body: person, controller: go_to_goal, task: walking}"
    assert call(export.main, *SITE[:2], "actors=none", guest, "duration_s=20", "out=site") == 0
    (trajectory,) = ElementTree.parse(folder / "site" / "world.sdf").iter("trajectory")
    poses = np.array([point.findtext("pose").split() for point in trajectory], float)
    # The first goal is reached after 5 s.
    assert np.ptp(poses[25:, :2], axis=0).max() > 2.0


@pytest.mark.slow(all_but=["*choose what*", "*wrold*", "*exported apart*", "*no world*", "*other files*"])
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("out=new",), "choose what to export: checkpoint=PATH"),
        (("wrold=flat", "out=new"), "wrold is not a setting; did you mean world?"),
        (("world=flat", "checkpoint=a.pt", "out=new"), "a policy is exported apart"),
        (("robot=leo_rover", "checkpoint=a.pt", "out=new"), "a policy is exported apart"),
        (("world=inspektion", "out=new"), "there is no world 'inspektion'; did you mean inspection?"),
        (("robot=rover_one", "out=new"), "there is no robot 'rover_one'"),
        (("robot=urdf", "robot.path=absent.urdf", "out=new"), "there is no file absent.urdf"),
        (("world=flat",), "out is missing; name the folder to write: out=FOLDER"),
        (("world=flat", "out=taken"), "out=taken holds other files (mine.txt); choose another folder"),
        (("world=flat", "out=taken", "overwrite=true"), "out=taken holds other files (mine.txt)"),
        (("world=flat", "out=taken/mine.txt"), "a file of that name is in the way"),
        (("world=flat", "out=new", "duration_s=0"), "duration_s must be above 0"),
        (("robot=leo_rover", "out=new", "duration_s=9"), "duration_s=9 is of worlds: give world=NAME too"),
        (("world=flat", "out=new", "second=3"), "second is not a setting"),
        (("world=flat", "out=new", "flub"), "cannot read 'flub'"),
    ],
)
def test_faults_are_named_and_nothing_is_written(
    words: tuple[str, ...], said: str, folder: Path, call: Call, capsys
) -> None:
    (folder / "taken").mkdir()
    (folder / "taken" / "mine.txt").write_text("mine")
    assert call(export.main, *words) == 2
    told = capsys.readouterr().err
    assert said in told and len(told.strip().splitlines()) <= 2
    assert [path.name for path in folder.iterdir()] == ["taken"]
    assert (folder / "taken" / "mine.txt").read_text() == "mine"


@pytest.mark.slow
def test_what_is_cut_off_leaves_nothing(folder: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    assert call(export.main, *SITE, "actors=none", "out=site") == 0
    before = (folder / "site" / "export.json").read_bytes()

    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(scene, "record_actors", fail)
    for out in ("site", "deep/new"):
        assert call(export.main, *SITE, "actors=none", f"out={out}", "overwrite=true") == 130
    assert [path.name for path in folder.iterdir()] == ["site"]
    assert (folder / "site" / "export.json").read_bytes() == before
    # What somebody has put beside an export stays.
    (folder / "site" / "notes.txt").write_text("mine")
    assert call(export.main, *SITE, "actors=none", "out=site", "overwrite=true") == 2
    assert (folder / "site" / "notes.txt").read_text() == "mine"
