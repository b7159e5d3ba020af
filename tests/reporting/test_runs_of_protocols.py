"""Reports of evaluations by a protocol, whose runs cut off their last episodes."""

import hashlib
from pathlib import Path

import pytest
from report_runs import CONFIG, episode_rows, write_evaluation

from dune_rl.evaluation.folder import changed_files
from dune_rl.reporting.collect import collect_comparisons
from dune_rl.reporting.comparison import EvaluatedPolicy, estimate_rows
from dune_rl.reporting.figures.failure_replay import Failure, replay_failures
from dune_rl.reporting.reading import read_inputs

PAPER = {**CONFIG, "protocol": "paper", "run_steps": 300}


def run_rows() -> list[dict[str, object]]:
    """Six episodes in two runs; the last one of each was cut off before it could succeed."""
    rows = episode_rows("x", 6, share=0.5)
    return [{**row, "run": index // 3, "finished": int(index % 3 < 2)} for index, row in enumerate(rows)]


def test_episodes_that_a_run_cut_off_are_no_failures(tmp_path: Path) -> None:
    inputs = read_inputs([write_evaluation(tmp_path / "a", run_rows(), config=PAPER)])
    (comparison,) = collect_comparisons(inputs.evaluations)
    assert [row["episode"] for row in comparison.methods[0].rows] == [0, 1, 3, 4]
    assert estimate_rows(comparison.methods[0].rows)["SR"].value == pytest.approx(0.5)
    assert comparison.cases.title == "flat, seed 5, protocol=paper"
    assert "4 episodes are reported that ended within their run" in inputs.notes[0].text


def test_a_method_without_a_finished_episode_is_named(tmp_path: Path) -> None:
    rows = [*run_rows(), *({**row, "policy": "slow", "finished": 0} for row in run_rows())]
    inputs = read_inputs([write_evaluation(tmp_path / "a", rows, config=PAPER)])
    assert "no episode of slow ended within its run" in inputs.notes[0].text
    (comparison,) = collect_comparisons(inputs.evaluations)
    assert [method.name for method in comparison.methods] == ["x"]


def test_runs_do_not_meet_sampled_episodes(tmp_path: Path) -> None:
    write_evaluation(tmp_path / "a", run_rows(), config=PAPER)
    write_evaluation(tmp_path / "b", episode_rows("x", 6))
    assert len(collect_comparisons(read_inputs([tmp_path]).evaluations)) == 2


@pytest.mark.parametrize(
    ("protocol", "finished", "reason"),
    [("dune_code", 1, "summary.csv, runs.csv"), ("paper", 0, "no episode that ended within its run")],
)
def test_runs_without_comparable_episodes_are_left_out(
    protocol: str, finished: int, reason: str, tmp_path: Path
) -> None:
    rows = [{**row, "finished": finished} for row in run_rows()]
    folder = write_evaluation(tmp_path / "a", rows, config={**CONFIG, "protocol": protocol})
    (note,) = read_inputs([folder]).skipped
    assert reason in note.text


def test_a_protocol_that_was_cut_off_has_no_known_number_of_episodes(tmp_path: Path) -> None:
    folder = write_evaluation(
        tmp_path / "a", run_rows(), config=PAPER, complete=False, finished=6, episodes=None, runs=4
    )
    (note,) = read_inputs([folder]).skipped
    assert "was cut off after 6 episodes" in note.text


def test_an_evaluation_that_was_killed_has_the_episodes_of_its_file(tmp_path: Path) -> None:
    folder = write_evaluation(
        tmp_path / "a", run_rows(), config=PAPER, complete=False, finished=0, episodes=50
    )
    (folder / "episodes.part.jsonl").write_text("{}\n{}\n{}\n{")
    (note,) = read_inputs([folder]).skipped
    assert "was cut off after 3 of 50 episodes" in note.text


def test_episodes_of_runs_are_not_run_again(tmp_path: Path) -> None:
    config = {"world": {"name": "flat"}, "protocol": "paper", "runs": 2, "policy": "x:y"}
    folder = write_evaluation(tmp_path / "a", run_rows(), config=config)
    (run,) = read_inputs([folder]).evaluations
    method = EvaluatedPolicy("x", "x", run.episodes, [run], "a")
    failure = Failure(method, "collision", run.episodes[-1])
    replay_failures([failure], (32, 24))
    assert failure.replay is None and "runs" in failure.reason


@pytest.mark.parametrize("files", [["episodes.csv"], "episodes.csv", 3])
def test_damaged_checksums_are_named(files: object, tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / "a", episode_rows("x", 2), files=files)
    (note,) = read_inputs([folder]).skipped
    assert "provenance.json is damaged" in note.text


def test_no_file_outside_the_folder_is_read_for_its_checksum(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_bytes(b"x")
    sums = {str(other): hashlib.sha256(b"x").hexdigest(), "../other": hashlib.sha256(b"x").hexdigest()}
    (tmp_path / "a").mkdir()
    assert changed_files(tmp_path / "a", {"files": sums}) == [*sums]
