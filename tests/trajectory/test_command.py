"""The command: its settings, what it writes, and what it refuses."""

import sys

import numpy as np
import pytest
from world_files import write_yard

import dune_rl
from dune_rl import trajectory
from dune_rl.core.errors import ConfigError, WorldError
from dune_rl.trajectories.settings import choose_world, parse_words
from dune_rl.worlds.importing.actor_files import read_actor_file

WAY = "waypoints=[[0,0],[4,2]]"


def run(monkeypatch, *words: str) -> int:
    monkeypatch.setattr(sys, "argv", ["trajectory", *words])
    with pytest.raises(SystemExit) as ended:
        trajectory.main()
    return ended.value.code


@pytest.mark.slow
def test_it_writes_the_file_and_the_picture_and_overwrites_neither(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = "world=flat", "velocity=1.0", WAY, "out=deep/actor.sdf", "mode=once", "name=<b> & c"
    assert run(monkeypatch, *words) == 0
    assert "91 poses, 4.5 m in 4.5 s, once" in capsys.readouterr().out
    (actor,) = read_actor_file("deep/actor.sdf")
    assert actor.name == "<b> & c" and actor.duration_s == pytest.approx(20**0.5, abs=1e-6)
    picture = tmp_path / "deep" / "actor.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    first = (tmp_path / "deep" / "actor.sdf").read_bytes()
    assert run(monkeypatch, *words) == 2
    assert "deep/actor.sdf exists; choose another name, or overwrite=true" in capsys.readouterr().err
    assert run(monkeypatch, *words[:-1], "out=deep/other.csv", "picture=deep/actor.png") == 2
    assert not (tmp_path / "deep" / "other.csv").exists()
    # The same settings give the same bytes.
    drawn = picture.read_bytes()
    assert run(monkeypatch, *words, "overwrite=true") == 0
    assert (tmp_path / "deep" / "actor.sdf").read_bytes() == first and picture.read_bytes() == drawn


def test_nothing_is_written_for_a_way_that_cannot_be_walked(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, "world=flat", "waypoints=[[0,0],[4000,2]]", "out=actor.csv") == 2
    assert "way-point 2, (4000.00, 2.00), is outside the world" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([WAY, "out=a.sdf"], "choose a world: world=NAME or world=FILE"),
        (["world=flat", "out=a.sdf"], "waypoints is missing"),
        (["world=flat", WAY], "out is missing"),
        (["world=flat", WAY, "out=a.xml"], "out must end in .sdf, .csv, .json"),
        (["world=flat", WAY, "out=a.sdf", "velocty=2"], "velocty is not a setting; did you mean velocity"),
        (["world=flat", WAY, "out=a.sdf", "velocity=0"], "velocity must be above 0"),
        (["world=flat", WAY, "out=a.sdf", "mode=twice"], "mode must be one of once, loop, back_and_forth"),
        (["world=flat", WAY, "out=a.sdf", "pauses_s=[1,2,3]"], "one for each way-point: 2 of them"),
        (["world=flat", WAY, "out=a.sdf", "pauses_s=-1"], "pauses_s must be from 0"),
        (["world=flat", "waypoints=[[0,0],[4]]", "out=a.sdf"], "waypoints.1"),
        (["world=flat", "waypoints=[[0,0],[4,.nan]]", "out=a.sdf"], "waypoints.1.1 must be a finite number"),
        (["world=flat", "waypoints=[[0,0],[4,x]]", "out=a.sdf"], "waypoints.1.1 must be a number"),
        (["world=flat", "waypoints=[[0,0],[4", "out=a.sdf"], "cannot read"),
        (["flat", WAY, "out=a.sdf"], "cannot read 'flat'; write key=value"),
        (["world=flat", WAY, "out=a.sdf", "picture=a.jpg"], "picture must end in .png"),
    ],
)
def test_faulty_settings_are_named(words, message):
    with pytest.raises(ConfigError) as error:
        parse_words(words)
    assert message in str(error.value)


def test_all_faults_are_named_at_once():
    with pytest.raises(ConfigError) as error:
        parse_words(["velocity=-1", "spacing_m=9", WAY])
    lines = str(error.value).splitlines()
    assert len(lines) == 4 and lines[0].startswith("choose a world")


@pytest.mark.slow
def test_worlds_are_options_with_settings_or_files(tmp_path, monkeypatch):
    assert choose_world("flat", ["world.friction=0.5"]).friction == 0.5
    yard = choose_world(str(write_yard(tmp_path, "glb")))
    assert yard.name == "mesh"
    np.save(tmp_path / "hill.npy", np.ones((20, 20)))
    assert choose_world(str(tmp_path / "hill.npy"), ["world.size_m=[20,20]"]).extent == (-10, 10, -10, 10)
    for name, message in (
        ("flt", "there is no world 'flt'"),
        ("gone.dae", "there is no file gone.dae"),
        ("./flat", "there is no file flat"),
    ):
        with pytest.raises(ConfigError, match=message):
            choose_world(name)
    with pytest.raises(ConfigError, match=r"world.frction is not a setting; did you mean world.friction"):
        choose_world("flat", ["world.frction=1"])
    monkeypatch.chdir(tmp_path)
    # A folder of an option's name is not meant.
    (tmp_path / "flat").mkdir()
    assert choose_world("flat").name == "flat"


def test_programs_plan_trajectories_too():
    way = dune_rl.plan_trajectory([[0, 0], [3, 0]], "flat", velocity=1.5, mode="once")
    np.testing.assert_allclose(way.poses[-1], [3, 0, 0, 0], atol=1e-9)
    assert way.times[-1] == pytest.approx(2.0)
    with pytest.raises(ConfigError, match="did you mean velocity"):
        dune_rl.plan_trajectory([[0, 0], [3, 0]], "flat", velocities=1)
    with pytest.raises(WorldError, match="outside the world"):
        dune_rl.plan_trajectory([[0, 0], [3000, 0]], "flat")
