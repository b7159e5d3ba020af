"""An evaluation's folder: complete, never overwritten, resumed, verified, the same over processes."""

import csv
import hashlib
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest
import yaml
from ray_nodes import kill_node, ray_nodes
from report_runs import episode_rows, write_evaluation

from dune_rl import evaluate
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose
from dune_rl.core.errors import ConfigError, TrainingError
from dune_rl.core.ray_cluster import RayCluster
from dune_rl.evaluation import processes, run_plan
from dune_rl.evaluation.blocks import EpisodeBlock, FinishedEpisode, missing_blocks
from dune_rl.evaluation.episode_sets.files import read_episode_set, write_episode_set
from dune_rl.evaluation.episode_sets.recipes import all_recipes
from dune_rl.evaluation.folder import ResultsFolder, check_free_for_results, read_settings
from dune_rl.evaluation.running import BlockRunner

Call = Callable[..., int]
POLICY = Path(__file__).parents[2] / "experiments" / "flat" / "seed1" / "policy.pt"
EPISODES = 5
CONF = compose(EvaluateConf, ["+world=flat", "policy=go_to_goal", "episodes=2"])
PROVENANCE = {"set": None, "policies": [], "forecasts": None}

# Fails in the third of episodes of twelve steps.
FAILING_DRIVER = """
import numpy as np

calls = 0

def stand(observation):
    global calls
    calls += 1
    if calls > 30:
        raise RuntimeError("out of order")
    return np.zeros((len(observation["goal"]), 2))
"""


def write_short_set(folder: Path, sites: int = 1) -> str:
    """A set of five short episodes without walkers; of `sites`, as its header says."""
    header = {**all_recipes()["flat-v1"].header(sites), "name": "short-v1", "episodes": EPISODES}
    settings = {**header["settings"], "actors": {}}
    terminations = settings["task"]["terminations"]
    limit = {**terminations["time_limit"], "max_steps": 12}
    settings["task"] = {**settings["task"], "terminations": {**terminations, "time_limit": limit}}
    rows = read_episode_set("flat-v1").episodes[:EPISODES]
    write_episode_set(folder, {**header, "settings": settings}, rows)
    return "set=short-v1.json"


@pytest.fixture
def short_set(folder: Path) -> str:
    return write_short_set(folder)


def read_rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((path / "episodes.csv").read_text().splitlines()))


def test_what_limits_results_is_said_beside_them(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [f"checkpoint={POLICY}", write_short_set(folder, sites=50), "physics.action_repeat=2"]
    assert call(evaluate.main, *words, "episodes=1", "out=results") == 0
    told = capsys.readouterr()
    assert "all on one of the set's 50 sites: nothing is said of others" in told.out
    assert "note: seed1 was trained with physics.action_repeat=1, and decides here with 2" in told.err


@pytest.mark.slow
def test_a_folder_holds_all_about_its_results(
    call: Call, folder: Path, short_set: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [f"checkpoint={POLICY}", "against=random", short_set, "scenes=2", "steps=true", "out=results"]
    assert call(evaluate.main, *words) == 0
    told = capsys.readouterr().out
    assert "short-v1: 5 episodes of seed 140000" in told and "Results: results" in told
    out = folder / "results"
    assert sorted(path.name for path in out.iterdir()) == [
        *("columns.csv", "comparison.csv", "config.yaml", "episodes.csv", "episodes.parquet"),
        *("provenance.json", "steps.csv", "steps.parquet", "summary.csv"),
    ]
    rows = read_rows(out)
    assert [(row["policy"], row["episode"]) for row in rows] == [
        (policy, str(number)) for policy in ("seed1", "random") for number in range(EPISODES)
    ]
    planned = read_episode_set("short-v1.json").episodes
    for row in rows:
        one = planned[int(row["episode"])]
        assert float(row["start_x_m"]) == pytest.approx(one.start[0], abs=0.1)
        assert (float(row["goal_x_m"]), float(row["goal_y_m"])) == one.goal
        assert (row["set"], row["engine"], row["world_seed"]) == ("short-v1", "bullet", "")

    table = pyarrow.parquet.read_table(out / "episodes.parquet")
    assert table.column_names == list(rows[0])
    assert table["return"].to_pylist() == [float(row["return"]) for row in rows]
    assert table.schema.field("time_to_goal").metadata[b"unit"] == b"s"
    assert table.schema.field("start_x_m").metadata[b"unit"] == b"m"
    columns = list(csv.DictReader((out / "columns.csv").read_text().splitlines()))
    assert all(row["meaning"] for row in columns)
    units = {row["column"]: row["unit"] for row in columns}
    assert units["speed_mps"] == "m/s" and set(rows[0]) <= units.keys()

    steps = list(csv.DictReader((out / "steps.csv").read_text().splitlines()))
    for row in rows:
        mine = [s for s in steps if (s["policy"], s["episode"]) == (row["policy"], row["episode"])]
        assert [int(step["step"]) for step in mine] == list(range(1, int(row["steps"]) + 1))
        assert sum(float(step["reward"]) for step in mine) == pytest.approx(float(row["return"]), abs=1e-4)

    provenance = json.loads((out / "provenance.json").read_text())
    assert provenance["set"]["sha256"] == read_episode_set("short-v1.json").header.sha256
    assert provenance["policies"][0]["sha256"] == hashlib.sha256(POLICY.read_bytes()).hexdigest()
    assert provenance["complete"] and provenance["finished"] == 2 * EPISODES
    assert {"numpy", "torch", "pybullet"} <= provenance["packages"].keys()
    config = yaml.safe_load((out / "config.yaml").read_text())
    assert (config["episodes"], config["seed"], config["world"]["name"]) == (EPISODES, 140000, "flat")


@pytest.mark.slow
def test_results_are_never_replaced_unasked(
    call: Call, folder: Path, short_set: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["policy=go_to_goal", short_set, "scenes=2", "out=results"]
    assert call(evaluate.main, *words, "episodes=2") == 0
    kept = (folder / "results" / "episodes.csv").read_bytes()
    assert call(evaluate.main, *words) == 2
    error = capsys.readouterr().err
    assert "out=results holds results already; choose another folder, or replace them with over" in error
    assert (folder / "results" / "episodes.csv").read_bytes() == kept
    assert call(evaluate.main, *words, "overwrite=true") == 0
    assert len(read_rows(folder / "results")) == EPISODES
    # As a process that is killed while it writes leaves it.
    left = folder / "results" / ".episodes.csv.x1.tmp"
    left.write_text("x")
    assert call(evaluate.main, *words, "overwrite=true") == 0
    assert not left.exists()
    (folder / "mine").mkdir()
    (folder / "mine" / "thesis.tex").write_text("x")
    assert call(evaluate.main, *words[:-1], "out=mine", "overwrite=true") == 2
    assert "out=mine holds other files (thesis.tex); choose another folder" in capsys.readouterr().err


@pytest.mark.slow
def test_an_evaluation_that_was_cut_off_goes_on(
    call: Call,
    folder: Path,
    short_set: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    words = ["policy=random", "against=go_to_goal", short_set, "scenes=2"]
    assert call(evaluate.main, *words, "out=whole") == 0
    run, count = BlockRunner.run, 0

    def interrupted(self: BlockRunner, block: EpisodeBlock, emit: Callable[..., None]) -> None:
        def cut(episode: object) -> None:
            nonlocal count
            emit(episode)
            count += 1
            if count == 3:
                raise KeyboardInterrupt

        run(self, block, cut)

    with monkeypatch.context() as patch:
        patch.setattr(run_plan.BlockRunner, "run", interrupted)
        assert call(evaluate.main, *words, "out=cut") == 130
    assert "Cut off after 3 of 10 episodes; go on with python -m dune_rl.evaluate resume=cut" in (
        capsys.readouterr().out.replace("\n", " ")
    )
    assert len(read_rows(folder / "cut")) == 3
    assert call(evaluate.main, *words, "out=cut") == 2
    assert "choose another folder, go on with resume=cut, or replace" in capsys.readouterr().err
    # As a process that is killed leaves it.
    for suffix in ("csv", "parquet"):
        (folder / "cut" / f"episodes.{suffix}").unlink()
    assert call(evaluate.main, "verify=cut") == 2
    assert "cut has no tables yet; go on with resume=cut first" in capsys.readouterr().err
    part = folder / "cut" / "episodes.part.jsonl"
    lines = part.read_text().splitlines(keepends=True)
    assert len(lines) == 3
    part.write_text(lines[0] + lines[1][:-30])
    provenance = json.loads((folder / "cut" / "provenance.json").read_text())
    ResultsFolder.reopen(folder / "cut").add(FinishedEpisode(**json.loads(lines[2])))
    assert part.read_text() == lines[0] + lines[2]
    (folder / "cut" / "provenance.json").write_text(json.dumps({**provenance, "policies": "random"}))
    assert call(evaluate.main, "resume=cut") == 2
    assert "cut holds no results of an evaluation (provenance.json is missing or" in capsys.readouterr().err
    (folder / "cut" / "provenance.json").write_text(json.dumps(provenance))
    assert call(evaluate.main, "resume=cut") == 0
    assert read_rows(folder / "cut") == read_rows(folder / "whole")
    assert not part.exists()


def test_what_ends_before_an_episode_leaves_nothing(
    call: Call, folder: Path, short_set: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(self: BlockRunner, block: EpisodeBlock, emit: Callable[..., None]) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(run_plan.BlockRunner, "run", interrupted)
    assert call(evaluate.main, "policy=random", short_set, "out=results") == 130
    assert not (folder / "results").exists()


def test_a_complete_evaluation_has_nothing_to_resume(
    call: Call, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def files() -> dict[str, tuple[int, bytes]]:
        return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in results.iterdir()}

    results = write_evaluation(folder / "results", episode_rows("a", 6))
    before = files()
    assert call(evaluate.main, "resume=results", "processes=2") == 0
    assert capsys.readouterr().out == "results is a complete evaluation: there is nothing to do\n"
    assert files() == before


def test_an_evaluation_that_was_cut_off_before_it_began_is_begun_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def create(conf: EvaluateConf) -> None:
        with ResultsFolder.create(tmp_path, conf, PROVENANCE, overwrite=False):
            pass

    with monkeypatch.context() as patch:
        patch.setattr(ResultsFolder, "write_provenance", lambda *_, **__: os._exit(9))
        killed = multiprocessing.get_context("fork").Process(target=create, args=(CONF,))
        killed.start()
        killed.join()
    assert sorted(path.name for path in tmp_path.iterdir()) == [".lock", "config.yaml"]
    create(CONF.model_copy(update={"episodes": 3}))
    assert read_settings(tmp_path).episodes == 3
    assert json.loads((tmp_path / "provenance.json").read_text())["finished"] == 0


@pytest.mark.parametrize("file", ["episodes.part.jsonl", "episodes.csv", "transitions.part", "config.yaml"])
def test_a_folder_without_provenance_that_holds_more_is_kept(file: str, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(CONF.model_dump(mode="json")))
    # Settings of something else.
    (tmp_path / file).write_text("total_frames: 100\n")
    with pytest.raises(ConfigError, match="holds results already; choose another folder"):
        check_free_for_results(tmp_path, overwrite=False)


def test_a_folder_in_use_says_what_helps(tmp_path: Path) -> None:
    with ResultsFolder.create(tmp_path / "results", CONF, PROVENANCE, overwrite=False) as folder:
        with pytest.raises(ConfigError, match=r"results; wait until it has ended, or end it$"):
            ResultsFolder.reopen(folder.path)
        with pytest.raises(ConfigError, match=r"results; choose another out=FOLDER$"):
            ResultsFolder.create(folder.path, CONF, PROVENANCE, overwrite=True)


def _is_alive(pid: int) -> bool:
    state = Path(f"/proc/{pid}/stat")
    return state.exists() and state.read_text().rpartition(")")[2].split()[0] != "Z"


def _command(pid: int) -> bytes:
    """The command of a process; empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads Linux's list of processes")
def test_no_process_outlives_an_evaluation_that_is_killed(folder: Path, short_set: str) -> None:
    words = ["policy=random", short_set, "scenes=1", "processes=2", "out=results"]
    parent = subprocess.Popen([sys.executable, "-m", "dune_rl.evaluate", *words])
    children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children")
    workers: list[int] = []
    while len(workers) < 2 and parent.poll() is None:
        found = [int(pid) for pid in children.read_text().split()]
        workers = [pid for pid in found if b"spawn_main" in _command(pid)]
        time.sleep(0.05)
    assert len(workers) >= 2
    parent.kill()
    parent.wait()
    # Without an end of their own, they wait forever, and so does this test.
    while any(_is_alive(pid) for pid in workers):
        time.sleep(0.05)


class _DyingRunner:
    """In a process of an evaluation, tells its number by an episode and ends before the next one is sent."""

    def __init__(self, plan: str) -> None:
        self._plan = plan

    def run(self, block: EpisodeBlock, emit: Callable[[FinishedEpisode], None]) -> None:
        emit(FinishedEpisode(0, block.first, {}, [{"pid": os.getpid()}]))
        if self._plan == "leave":
            os._exit(0)
        # The parent does not read meanwhile, so that no more of the message is written than a pipe holds.
        threading.Timer(2.0, os.kill, (os.getpid(), signal.SIGKILL)).start()
        emit(FinishedEpisode(0, block.first + 1, {}, [{"text": "x" * 8_000_000}]))
        time.sleep(3600.0)


# Under this name the processes find it, which import this module anew.
_real_work = processes._work


def _work_and_die(*arguments: Any) -> None:
    processes.BlockRunner = _DyingRunner  # type: ignore[assignment,misc]
    _real_work(*arguments)


@pytest.fixture
def alarm() -> Iterator[None]:
    """Ends a test that waits forever."""

    def fail(number: int, frame: object) -> None:
        raise TimeoutError("it waits forever")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(300)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads Linux's list of processes")
@pytest.mark.parametrize(("plan", "code"), [("be killed amid a message", -9), ("leave", 0)])
def test_a_process_that_is_lost_ends_an_evaluation(
    plan: Any, code: int, alarm: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "_work", _work_and_die)

    def wait_for_its_end(episode: FinishedEpisode) -> None:
        while _is_alive(episode.steps[0]["pid"]):
            time.sleep(0.05)

    blocks = [EpisodeBlock(0, first, 2) for first in (0, 2, 4)]
    with pytest.raises(TrainingError, match=f"ended with code {code}; take fewer processes or scenes"):
        processes.run_in_processes(plan, blocks, 2, wait_for_its_end)


@pytest.mark.slow
def test_rows_do_not_depend_on_processes(call: Call, folder: Path, short_set: str) -> None:
    words = [f"checkpoint={POLICY}", "against=random", short_set, "scenes=2"]
    assert call(evaluate.main, *words, "out=one") == 0
    assert call(evaluate.main, *words, "processes=2", "out=two") == 0
    assert (folder / "one" / "episodes.csv").read_bytes() == (folder / "two" / "episodes.csv").read_bytes()


@pytest.mark.slow
def test_parts_are_joined_to_the_whole(
    call: Call, folder: Path, short_set: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [f"checkpoint={POLICY}", "against=random", short_set, "scenes=2", "steps=true"]
    assert call(evaluate.main, *words, "out=whole") == 0
    for number in (1, 3):
        assert call(evaluate.main, *words, f"part={number}/3", f"out=parts/{number}") == 0
    assert [row["episode"] for row in read_rows(folder / "parts" / "3")] == ["4", "4"]
    capsys.readouterr()
    assert call(evaluate.main, "join=parts", "out=joined") == 2
    assert "episode 2 is in none of the parts 1/3, 3/3" in capsys.readouterr().err
    assert call(evaluate.main, *words, "part=2/3", "out=parts/2", "processes=2") == 0
    rows = folder / "parts" / "2" / "episodes.part.jsonl"
    whole = rows.read_text()
    rows.write_text(whole[: len(whole) // 2])
    assert call(evaluate.main, "join=parts", "out=joined") == 2
    assert "parts/2 is not complete; go on with resume=parts/2" in capsys.readouterr().err
    assert call(evaluate.main, "resume=parts/2") == 0
    assert call(evaluate.main, "join=parts", "out=joined") == 0
    for name in ("episodes.csv", "steps.csv", "summary.csv", "comparison.csv"):
        assert (folder / "joined" / name).read_bytes() == (folder / "whole" / name).read_bytes()
    assert json.loads((folder / "joined" / "provenance.json").read_text())["parts"].keys() == {
        "1/3", "2/3", "3/3"
    }  # fmt: skip
    assert call(evaluate.main, "join=whole", "out=other") == 2
    assert "join=whole holds no parts" in capsys.readouterr().err


@pytest.mark.slow
def test_rows_do_not_depend_on_a_ray_cluster_whose_node_dies(
    call: Call, folder: Path, short_set: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = [f"checkpoint={POLICY}", "against=random", short_set, "scenes=2", "steps=true"]
    assert call(evaluate.main, *words, "out=one") == 0
    add = ResultsFolder.add
    # A block for each policy, of which the node that is lost has given some episodes, and not yet the others.
    monkeypatch.setattr(RayCluster, "cpus", lambda self: 1)
    with ray_nodes(monkeypatch, 2) as nodes:

        def add_and_kill(self: ResultsFolder, episode: FinishedEpisode) -> None:
            add(self, episode)
            if len(nodes) > 1 and len(self.finished) == 3:
                kill_node(nodes.pop())

        monkeypatch.setattr(ResultsFolder, "add", add_and_kill)
        assert call(evaluate.main, *words, "processes=ray", "out=two") == 0
    assert len(nodes) == 1
    for name in ("episodes.csv", "steps.csv"):
        assert (folder / "one" / name).read_bytes() == (folder / "two" / name).read_bytes()


@pytest.mark.slow
def test_episodes_of_a_ray_task_that_fails_are_kept(
    call: Call, folder: Path, short_set: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "failing_driver.py").write_text(FAILING_DRIVER)
    monkeypatch.syspath_prepend(folder)
    with ray_nodes(monkeypatch, 1):
        words = ["policy=failing_driver:stand", short_set, "scenes=1", "processes=ray", "out=results"]
        assert call(evaluate.main, *words) != 0
    # All five are one block.
    assert [row["episode"] for row in read_rows(folder / "results")] == ["0", "1"]


@pytest.mark.slow
def test_a_sample_is_repeated(
    call: Call, folder: Path, short_set: str, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = folder / "policy.pt"
    shutil.copy(POLICY, policy)
    words = [f"checkpoint={policy}", "against=random", short_set, "scenes=2", "out=results"]
    assert call(evaluate.main, *words) == 0
    capsys.readouterr()
    assert call(evaluate.main, "verify=results", "sample=10") == 0
    assert "10 of 10 rows were repeated and came out the same." in capsys.readouterr().out
    assert call(evaluate.main, "verify=results", "sample=3") == 0
    assert "of 10 rows were repeated and came out the same." in capsys.readouterr().out
    file = folder / "results" / "episodes.csv"
    kept = file.read_bytes()
    rows = read_rows(folder / "results")
    rows[0]["return"] = "99.5"
    with file.open("w", newline="") as opened:
        writer = csv.DictWriter(opened, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    assert call(evaluate.main, "verify=results", "sample=10") == 2
    error = capsys.readouterr().err
    assert "results: 1 of 10 repeated rows differ." in error and "return: 99.5 stored" in error
    assert "episodes.csv changed since the evaluation wrote them." in error
    file.write_bytes(kept.splitlines()[0])
    assert call(evaluate.main, "verify=results", "sample=2") == 2
    error = capsys.readouterr().err
    assert "results: 2 of 2 sampled rows are missing in episodes.csv. episodes.csv changed since" in error
    file.write_bytes(kept)
    assert call(evaluate.main, "verify=results", "sample=2") == 0
    summary = folder / "results" / "summary.csv"
    figures = summary.read_bytes()
    summary.write_bytes(figures.replace(b"SR,", b"SR,0."))
    assert call(evaluate.main, "verify=results", "sample=2") == 2
    assert "results: summary.csv changed since" in capsys.readouterr().err
    summary.write_bytes(figures)
    (folder / "results" / "episodes.parquet").write_bytes(b"")
    assert call(evaluate.main, "verify=results", "sample=2") == 2
    error = capsys.readouterr().err
    assert "results: episodes.parquet changed since" in error and "came out the same; others may not" in error
    # Without what follows from the rows, the results are whole.
    (folder / "results" / "episodes.parquet").unlink()
    assert call(evaluate.main, "verify=results", "sample=2") == 0
    shutil.copy(POLICY.parents[1] / "seed2" / "policy.pt", policy)
    assert call(evaluate.main, "verify=results") == 2
    assert "was made with other weights than those now in" in capsys.readouterr().err


def test_blocks_keep_every_episode_in_its_row() -> None:
    assert missing_blocks(1, 10, (), 4, 1) == [EpisodeBlock(0, 0, 10)]
    shared = missing_blocks(2, 10, (), 4, 2)
    assert all(block.first % 4 == 0 for block in shared)
    covered = [(one.policy, number) for one in shared for number in range(one.first, one.first + one.count)]
    assert sorted(covered) == [(policy, number) for policy in range(2) for number in range(10)]
    done = {(0, number) for number in (0, 1, 2, 3, 4, 8, 9)}
    assert missing_blocks(1, 10, done, 4, 1) == [EpisodeBlock(0, 4, 4)]
