"""Evaluations by a protocol: runs of control steps, the same over processes, resumed and verified."""

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from dune_rl import evaluate
from dune_rl.evaluation import run_plan
from dune_rl.evaluation.blocks import EpisodeBlock
from dune_rl.evaluation.protocols.report import describe_runs, run_rows
from dune_rl.evaluation.running import BlockRunner
from dune_rl.statistics.measures import estimate_metrics

Call = Callable[..., int]
PAPER = ["protocol=paper", "+world=flat", "actors=none", "sensors=[goal]", "seed=3"]
CODE = ["protocol=dune_code", *PAPER[1:]]


def read(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.mark.slow
def test_a_run_has_its_steps_and_a_cut_episode(call: Call, folder: Path) -> None:
    words = [*PAPER, "policy=go_to_goal", "runs=2", "run_steps=150", "scenes=2", "steps=true"]
    assert call(evaluate.main, *words, "out=one") == 0
    rows = read(folder / "one" / "episodes.csv")
    for run in ("0", "1"):
        mine = [row for row in rows if row["run"] == run]
        assert sum(int(row["steps"]) for row in mine) == 150
        assert [row["finished"] for row in mine[:-1]] == ["1"] * (len(mine) - 1)
        assert [int(row["episode"]) for row in mine] == [100_000 * int(run) + i for i in range(len(mine))]
    assert "0" in {row["finished"] for row in rows}

    # The same episodes, uncut: those that finish are the same, and the cut one begins like its longer self.
    longer = [*PAPER, "policy=go_to_goal", "runs=1", "run_steps=400", "scenes=2", "steps=true"]
    assert call(evaluate.main, *longer, "out=longer") == 0
    whole = {row["episode"]: row for row in read(folder / "longer" / "episodes.csv")}
    steps = read(folder / "longer" / "steps.csv")
    for row in (row for row in rows if row["run"] == "0"):
        if row["finished"] == "1":
            assert row == whole[row["episode"]]
            continue
        assert int(row["steps"]) < int(whole[row["episode"]]["steps"])
        taken = [each for each in steps if each["episode"] == row["episode"]][: int(row["steps"])]
        assert sum(float(each["reward"]) for each in taken) == pytest.approx(float(row["return"]), abs=1e-3)
        assert row["reached"] == "0" and row["start_x_m"] == whole[row["episode"]]["start_x_m"]


@pytest.mark.slow
def test_runs_do_not_depend_on_processes_and_are_repeated(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = [*PAPER, "policy=random", "against=go_to_goal", "runs=2", "run_steps=120", "scenes=2"]
    assert call(evaluate.main, *words, "processes=2", "out=two") == 0
    told = capsys.readouterr().out
    assert "flat, protocol=paper: 2 runs of 120 steps, seed 3" in told and "TC/run" in told
    assert "VORT: tilt above 5°" in told
    run, count = BlockRunner.run, 0

    def interrupted(self: BlockRunner, block: EpisodeBlock, emit: Callable[..., None]) -> None:
        def cut(episode: Any) -> None:
            nonlocal count
            emit(episode)
            count += 1
            if episode.policy == 1:
                raise KeyboardInterrupt

        run(self, block, cut)

    with monkeypatch.context() as patch:
        patch.setattr(run_plan.BlockRunner, "run", interrupted)
        assert call(evaluate.main, *words, "out=cut") == 130
    assert "Cut off after 2 of 4 runs" in capsys.readouterr().out
    assert call(evaluate.main, "resume=cut") == 0
    for name in ("episodes.csv", "runs.csv", "summary.csv"):
        assert (folder / "cut" / name).read_bytes() == (folder / "two" / name).read_bytes()
    summary = {(row["policy"], row["measure"]): row for row in read(folder / "two" / "summary.csv")}
    for measure in ("VORT", "VORT/run"):
        assert summary["go_to_goal", measure]["note"] == "tilt above 5°"
    assert {row["measure"] for row in read(folder / "two" / "comparison.csv")} >= {"TC/run", "OC/run"}
    capsys.readouterr()
    assert call(evaluate.main, "verify=two", "sample=1") == 0
    assert "rows were repeated and came out the same." in capsys.readouterr().out


@pytest.mark.slow
def test_the_published_code_has_columns_of_its_own(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*CODE, "policy=go_to_goal", "runs=2", "run_steps=400", "scenes=2", "out=code"]
    assert call(evaluate.main, *words) == 0
    told = capsys.readouterr().out
    assert "code TSR" in told and "The code has no MTT" in told.replace("\n", " ").replace("  ", " ")
    out = folder / "code"
    config = yaml.safe_load((out / "config.yaml").read_text())
    assert config["task"]["terminations"]["goal_reached"]["renew"]
    assert config["task"]["terminations"]["long_collision"] == {
        **{"term": "long_collision", "truncates": False, "renew": False},
        **{"distance_m": 0.3, "steps": 600},
    }
    # Goals are renewed, and nothing else ends an episode before its run does.
    rows, attempts = read(out / "episodes.csv"), read(out / "attempts.csv")
    assert [row["finished"] for row in rows] == ["0", "0"]
    for row in rows:
        mine = [one for one in attempts if one["episode"] == row["episode"]]
        assert [one["outcome"] for one in mine[:-1]] == ["reached"] * int(row["goals"])
        times = [float(one["end_s"]) - float(one["begin_s"]) for one in mine if one["outcome"] == "reached"]
        assert sum(times) == pytest.approx(float(row["dune_code_goal_time"]), rel=1e-5)
        assert int(row["dune_code_successes"]) == sum(time > 5.0 for time in times)
        assert int(row["dune_code_rows"]) == 20
        # At rest or on level ground the accelerometer feels 9.81 m/s².
        assert float(row["dune_code_smoothness"]) / 20 > 9.5
        assert float(row["dune_code_vertical"]) / int(row["steps"]) == pytest.approx(9.81, abs=0.5)
    summary = {row["measure"]: row for row in read(out / "summary.csv")}
    assert summary["code MTT"]["value"] == summary["code TR"]["value"] == "nan"
    assert float(summary["code SR"]["value"]) == pytest.approx(1.0)
    assert {"TC/run", "OC/run", "TSR/run", "code TC", "code VORT", "code best SR"} <= summary.keys()
    assert not {"SR/run", "SR", "MTT/run"} & summary.keys()


# -- arithmetic ------------------------------------------------------------------------------------


def episode(run: int, steps: int, **values: float) -> dict[str, Any]:
    plain = {
        "policy": "p",
        "run": run,
        "finished": 1,
        "steps": steps,
        "return": 1.0,
        "success": 0,
        "reached": 0,
    }
    metrics = {
        "time_to_goal": math.nan,
        "collisions": 0,
        "clearance": 1.0,
        "vort": math.nan,
        "uneven_time": 0.0,
    }
    return plain | metrics | values


def test_totals_and_means_of_a_run() -> None:
    rows = [
        episode(0, 100, success=1, reached=1, time_to_goal=5.0, clearance=1.0, vort=0.4, uneven_time=1.0),
        episode(0, 300, reached=1, time_to_goal=15.0, collisions=2, clearance=3.0, vort=0.8, uneven_time=3.0),
        # What was cut off has its share in totals and means over time alone.
        episode(0, 400, finished=0, collisions=3, clearance=2.0),
        episode(1, 800, clearance=12.0),
    ]
    first, second = run_rows(rows, ends_at_goals=True)
    assert first["run_success"] == pytest.approx(1 / 2) and first["run_reached"] == pytest.approx(1.0)
    assert first["run_time_to_goal"] == pytest.approx(10.0)
    assert first["run_collisions"] == 5 and first["steps"] == 800
    assert first["run_clearance"] == pytest.approx((100 * 1 + 300 * 3 + 400 * 2) / 800)
    assert first["run_vort"] == pytest.approx((0.4 * 1 + 0.8 * 3) / 4)
    assert math.isnan(second["run_vort"]) and math.isnan(second["run_time_to_goal"])
    assert estimate_metrics([first, second])["TC/run"].value == pytest.approx(2.5)
    described = describe_runs(rows, [first, second])
    assert [(row["run"], row["episodes"], row["finished"]) for row in described] == [(0, 3, 2), (1, 1, 1)]
    assert described[0]["TC/run"] == 5


# -- refusals --------------------------------------------------------------------------------------


@pytest.mark.slow(all_but=["words7-protocol"])
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["protocol=paper", "set=flat-v1"], "protocol=paper samples starts and goals as in training"),
        (["protocol=dune_code", "set=flat-v1"], "and set=flat-v1 fixes them and how episodes end"),
        (["protocol=paper", "+world=flat", "episodes=5"], "write runs=N in place of episodes"),
        (["+world=flat", "runs=5"], "runs needs protocol=paper or protocol=dune_code"),
        (["protocol=dune_code", "+world=flat", "task=paper"], "leave task=paper out"),
        (
            ["protocol=dune_code", "+world=flat", "task.terminations.time_limit.max_steps=5"],
            "determines the rewards and ends of episodes",
        ),
        (["protocol=paper", "+world=flat", "robots=[rover_zero,rover_zero]"], "is for one robot"),
        (["protocol=best", "+world=flat"], "protocol"),
    ],
)
def test_what_does_not_go_together_is_refused(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    assert call(evaluate.main, "policy=go_to_goal", *words) == 2
    assert said in capsys.readouterr().err
    assert not list(folder.iterdir())
