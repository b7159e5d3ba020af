"""The command lines, end to end on a run of seconds: what they write, say and return."""

import importlib.util
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import pytest
import yaml

from dune_rl import benchmark, engines, evaluate, train
from dune_rl.commands import command_line
from dune_rl.commands.pages import PAGES
from dune_rl.config.commands import ViewConf
from dune_rl.core.untrusted_files import WorldWarning

Call = Callable[..., int]


def test_the_commands_are_listed() -> None:
    listed = subprocess.run(
        [sys.executable, "-m", "dune_rl"], capture_output=True, text=True, check=True
    ).stdout
    names = re.findall(r"python -m dune_rl\.(\w+) ", listed)
    others = {"report", "episode_sets", "ros", "view", "trajectory", "benchmark", "engines", "robots"}
    assert set(names) == {"train", "evaluate", "forecast", "drive", "export", "doctor"} | others
    for name in names:
        assert importlib.util.find_spec(f"dune_rl.{name}") is not None
    asked = subprocess.run(
        [sys.executable, "-m", "dune_rl", "drive"], capture_output=True, text=True, check=False
    )
    assert asked.returncode == 2 and "choose a command" in asked.stderr


@pytest.mark.parametrize("program", [train, evaluate])
def test_help(program: object, call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(program.main, "--help") == 0
    text = capsys.readouterr().out
    for words in ("+world=NAME", "construction, flat, heightmap", "seed=N", "python -m dune_rl."):
        assert words in text
    # Of what the command itself refuses, its help does not speak.
    assert ("learning=NAME" in text) == (program is train)


def test_the_help_names_every_view() -> None:
    named = re.split(", | or ", dict(PAGES["view"].settings)["view=NAME"])
    assert sorted(named) == sorted(get_args(ViewConf.model_fields["view"].annotation))


def test_shown_settings_are_the_used_ones(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(train.main, "+world=flat", "seed=4", "--cfg", "job") == 0
    shown = yaml.safe_load(capsys.readouterr().out)
    assert (shown["seed"], shown["world"]["name"]) == (4, "flat")
    assert call(evaluate.main, "+world=flat", "policy=random", "--cfg", "job") == 0
    assert yaml.safe_load(capsys.readouterr().out)["policy"] == ["random"]
    assert not list(folder.iterdir())


@pytest.mark.slow
def test_benchmark_prints_its_ratios(call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["world=flat", "actors=none", "scenes=2", "rounds=1", "steps=2", "processes=[1]"]
    assert call(benchmark.main, *words) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    alone, cameras, sensors, terrain, new_world, groups, actors, together = lines
    assert alone["groups"] == {"rover": 1}
    assert [line["benchmark"] for line in lines] == [
        *("environment", "cameras", "sensors", "terrain", "new_world", "groups", "actors", "processes"),
    ]
    ratios = (
        "overhead_ratio",
        "torchrl_ratio",
        "metrics_ratio",
        "pettingzoo_ratio",
        "gymnasium_vector_ratio",
    )
    for name in (*ratios, "core_steps_per_s", "reset_ms"):
        assert alone[name] > 0
    # Two steps say nothing of how long a step takes.
    assert cameras["overhead_ratio_camera"] > 0 and cameras["overhead_ratio_depth"] > 0
    for name in ("lidar_speedup", "camera_speedup", "camera_speedup_heightfield", "picture_1280x720_s"):
        assert sensors[name] > 0
    for name in ("height", "normal", "slope", "roughness", "nearest_obstacle"):
        assert terrain[f"terrain_{name}_mpoints_per_s"] > 0
    assert min(new_world[f"{name}_ms"] for name in ("build", "fresh", "load", "kept")) > 0
    for name in ("one_robot_core_ratio", "four_robots_core_ratio", "four_robots_agent_steps_per_s"):
        assert groups[name] > 0
    assert {"four_robots_overhead_ratio", "one_robot_overhead_us"} <= groups.keys()
    # Two steps may cost less than two others: the fields are there, and numbers.
    for name in ("actors_cost", "actors_cost_social_force", "actors_cost_orca"):
        assert actors[name] > -1
    assert together["processes"] == 1
    assert together["core_steps_per_s"] > 0


@pytest.mark.slow
def test_engines_are_compared_in_tables(call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(engines.main, "places=[slope]", "worlds=[flat]", "minutes=0.1", "scenes=2") == 0
    lines = capsys.readouterr().out.splitlines()
    straight = next(line for line in lines if line.startswith("| slope | straight |")).split("|")
    speeds = [float(cell.split()[0]) for cell in straight[3:5]]
    assert speeds == pytest.approx([0.8, 0.8], abs=0.01)
    # Nothing is amiss in six seconds of flat ground.
    for engine in ("bullet", "dart"):
        start = f"| rover_zero | flat | {engine} | 0.1 | 2 | 0 | 0 | 0 | 0 | 0 | "
        assert any(line.startswith(start) for line in lines)


def test_a_wrong_setting_of_engines_is_named(call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(engines.main, "minute=1") == 2
    assert "minute is not a setting; did you mean minutes?" in capsys.readouterr().err


@pytest.mark.slow
def test_both_engines_are_timed_in_one_run(call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["world=flat", "actors=none", "parts=[engines]", "scenes=2", "rounds=1", "steps=2"]
    assert call(benchmark.main, *words, "robot=hyperdog", "robot.action=joints") == 0
    (line,) = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert all(line[f"{engine}_physics_steps_per_s"] > 0 for engine in ("bullet", "dart"))


@pytest.mark.slow
def test_sizes_and_starts_are_measured(call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(benchmark.main, "world=flat", "actors=none", "parts=[sizes]", "scenes=2", "rounds=1") == 0
    (line,) = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert line["process_memory_mib"] > 50 and line["scene_memory_mib"] > 0 and line["wheel_mib"] > 1
    assert {"train", "evaluate", "doctor"} <= line["startup_s"].keys() and min(line["startup_s"].values()) > 0


@pytest.mark.slow
def test_films_are_measured(call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(benchmark.main, "world=flat", "parts=[films]", "film_s=0.4") == 0
    (line,) = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert line["film_s"] == 0.4 and "groups" not in line
    assert (
        line["film_cpu_s"].keys() == {"640x360", "960x540", "1920x1080"}
        and min(line["film_cpu_s"].values()) > 0
    )


@pytest.mark.slow
def test_two_policies_are_compared_on_the_same_episodes(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "policy=go_to_goal",
        "against=random",
        "+world=flat",
        "actors=none",
        "episodes=3",
        "out=both",
    ]
    assert call(evaluate.main, *words, "task.terminations.time_limit.max_steps=250") == 0
    assert "Paired: go_to_goal alone succeeds in " in capsys.readouterr().out
    rows = (folder / "both" / "episodes.csv").read_text().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == ["go_to_goal"] * 3 + ["random"] * 3
    assert [row.split(",")[3:5] for row in rows] == [["rover_0", number] for number in "012"] * 2


def test_a_warning_is_a_line_without_our_code(capsys: pytest.CaptureFixture[str]) -> None:
    command_line._warn(WorldWarning("sand.png is missing"), WorldWarning, "reader.py", 7)
    assert capsys.readouterr().err == "warning: sand.png is missing\n"


@pytest.mark.slow
def test_environments_of_pettingzoo_and_gymnasium_do_without_pytorch() -> None:
    code = (
        "import sys, gymnasium, dune_rl\n"
        "env = dune_rl.parallel_env(world='flat', seed=0)\n"
        "env.reset()\n"
        "env.close()\n"
        "env = gymnasium.make('dune_rl:dune_rl/Flat-v0')\n"
        "env.reset(seed=0)\n"
        "env.close()\n"
        "print([name for name in ('torch', 'tensordict', 'torchrl') if name in sys.modules])\n"
        "env = dune_rl.make('flat', 1, seed=0)\n"
        "env.close()\n"
        "print('torchrl' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["[]", "True"]


def test_a_reader_that_has_enough_ends_a_command_without_a_word() -> None:
    code = (
        "from dune_rl.commands.command_line import PAGES, run_command\n"
        "run_command(PAGES['view'], lambda words: print('a line\\n' * 100_000))"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == "a line\n"
        process.stdout.close()
        assert (process.stderr.read(), process.wait()) == ("", 141)
