"""Reports read what can be used, and name what cannot, with the reason."""

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import pytest
from report_runs import CONFIG, episode_rows, write_evaluation, write_rows, write_sweep, write_training

from dune_rl.evaluation.episode_sets.files import read_episode_set
from dune_rl.reporting.collect import collect_comparisons
from dune_rl.reporting.inputs import group_runs
from dune_rl.reporting.reading import read_inputs
from dune_rl.reporting.tables.runs import sweep_table
from dune_rl.reporting.tables.table import NOTHING


def reasons(*paths: Path) -> list[str]:
    inputs = read_inputs(list(paths))
    assert not inputs.usable
    return [note.text for note in inputs.skipped]


def test_folders_are_searched_and_runs_get_unique_names(tmp_path: Path) -> None:
    write_evaluation(tmp_path / "a" / "result", episode_rows("x", 4))
    write_evaluation(tmp_path / "b" / "result", episode_rows("x", 4))
    write_training(tmp_path / "b" / "flat" / "seed1", 1)
    inputs = read_inputs([tmp_path])
    assert [run.name for run in inputs.evaluations] == ["a/result", "b/result"]
    # "seed1" alone would tell nothing.
    assert [run.name for run in inputs.training] == ["flat/seed1"]
    assert not inputs.skipped


def test_numbers_are_floats_and_names_stay_text(tmp_path: Path) -> None:
    write_evaluation(tmp_path / "a", episode_rows("17", 2, share=0.5))
    (run,) = read_inputs([tmp_path / "a"]).evaluations
    first, second = run.episodes
    assert (first["policy"], first["agent"], first["episode"]) == ("17", "rover_0", 0.0)
    assert second["time_to_goal"] != second["time_to_goal"]


def test_a_study_without_provenance_is_a_run_and_an_evaluation(tmp_path: Path) -> None:
    folder = write_training(tmp_path / "study", 1)
    rows = [{key: value for key, value in row.items() if key != "agent"} for row in episode_rows("x", 4)]
    write_rows(folder / "episodes.csv", rows)
    inputs = read_inputs([folder])
    assert len(inputs.training) == len(inputs.evaluations) == 1
    assert inputs.evaluations[0].provenance == {}
    (note,) = inputs.notes
    assert "has no provenance.json: nothing says by which command, version and weights" in note.text


def test_what_is_no_run_is_named(tmp_path: Path) -> None:
    (tmp_path / "file.csv").write_text("a\n1\n")
    (tmp_path / "empty").mkdir()
    found = reasons(tmp_path / "none", tmp_path / "file.csv", tmp_path / "empty")
    assert found == [
        "there is no such folder",
        "is a file; give the folder of a run or of an evaluation",
        "holds no run, no evaluation and no sweep",
    ]


def test_an_evaluation_that_was_cut_off_is_left_out(tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / "a", episode_rows("x", 4), complete=False, finished=4, episodes=200)
    (reason,) = reasons(folder)
    # Short episodes end first, so that the finished ones are no fair sample.
    assert "cut off after 4 of 200 episodes" in reason and f"resume={folder}" in reason


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "has no episodes"),
        ("policy,episode,agent\n", "has no episodes"),
        ("policy,episode,agent,success\nx,0,rover_0,1\nx,1\n", "line 3: 2 cells under 4 columns"),
        ("policy,episode,agent,success\nx,0,rover_0,1\nx,1,rover_0,yes\n", "line 3: success is 'yes'"),
        ("policy,episode,episode\nx,0,0\n", "has a column twice"),
        ("policy,success\nx,1\n", "lacks the column episode"),
        ("policy,episode\nx,0\nx,0\n", "has episode 0.0 of x twice"),
    ],
)
def test_damaged_rows_are_left_out_with_the_reason(text: str, reason: str, tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / "a", episode_rows("x", 2))
    (folder / "episodes.csv").write_text(text)
    assert reason in reasons(folder)[0]


def test_files_of_other_kinds_are_left_out_with_the_reason(tmp_path: Path) -> None:
    binary = write_evaluation(tmp_path / "a", episode_rows("x", 2))
    (binary / "episodes.csv").write_bytes(b"\xff\xfe\x00policy")
    damaged = write_evaluation(tmp_path / "b", episode_rows("x", 2))
    (damaged / "provenance.json").write_text('{"complete": tr')
    begun = write_training(tmp_path / "c", 1)
    (begun / "metrics.csv").unlink()
    found = reasons(binary, damaged, begun)
    assert "cannot be read" in found[0]
    assert "provenance.json is damaged" in found[1]
    assert "has just begun" in found[2]


def test_the_rest_is_read_beside_what_is_damaged(tmp_path: Path) -> None:
    write_evaluation(tmp_path / "good", episode_rows("x", 2))
    (write_evaluation(tmp_path / "bad", episode_rows("x", 2)) / "episodes.csv").write_text("")
    inputs = read_inputs([tmp_path])
    assert [run.name for run in inputs.evaluations] == ["good"]
    assert [note.path.name for note in inputs.skipped] == ["bad"]


def test_links_are_not_followed_round_in_circles(tmp_path: Path) -> None:
    write_evaluation(tmp_path / "a", episode_rows("x", 2))
    os.symlink(tmp_path, tmp_path / "a" / "round")
    assert len(read_inputs([tmp_path]).evaluations) == 1


def test_a_run_given_twice_is_read_once(tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / "a", episode_rows("x", 2))
    inputs = read_inputs([folder, folder])
    assert len(inputs.evaluations) == 1 and "read once" in inputs.skipped[0].text


def test_folders_given_twice_by_one_above_are_told_as_read(tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / "all" / "a", episode_rows("x", 2))
    for words in ([tmp_path / "all"] * 2, [folder, tmp_path / "all"]):
        inputs = read_inputs(words)
        assert len(inputs.evaluations) == 1
        assert [note.text for note in inputs.skipped] == ["was read already"]


def test_damaged_steps_leave_an_evaluation_out(tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / "a", episode_rows("x", 2))
    for text in ("", "policy,agent,episode\nx,rover_0,0\nx,rov", "policy,agent,episode\nx,rover_0,first\n"):
        (folder / "steps.csv").write_text(text)
        (reason,) = reasons(folder)
        assert "steps.csv cannot be read" in reason and reason.endswith("evaluate again")
    (folder / "steps.csv").write_text("policy,agent,episode,x_m\nx,rover_0,0,1.5\nx,rover_0,1,\n")
    (run,) = read_inputs([folder]).evaluations
    assert len(run.steps) == 2 and run.steps.of("x", [0.0])[0]["x_m"] == 1.5
    assert math.isnan(run.steps.of("x", [1.0])[0]["x_m"]) and run.steps.of("y", [0.0]) == []


def test_damaged_settings_are_told_once(tmp_path: Path) -> None:
    left_out = write_evaluation(tmp_path / "a", episode_rows("x", 2), files={"config.yaml": "0"})
    (left_out / "config.yaml").write_text("{")
    inputs = read_inputs([left_out])
    assert "checksum differs" in inputs.skipped[0].text and not inputs.notes
    kept = write_evaluation(tmp_path / "b", episode_rows("x", 2))
    (kept / "config.yaml").write_text("{")
    inputs = read_inputs([kept])
    assert not inputs.skipped and "config.yaml is damaged" in inputs.notes[-1].text


def test_a_set_in_several_worlds_is_left_out(tmp_path: Path) -> None:
    rows = [*episode_rows("x", 2, set="mine"), *episode_rows("y", 2, set="mine", world="island")]
    (reason,) = reasons(write_evaluation(tmp_path / "a", rows))
    assert "rows of mine in several worlds (flat, island)" in reason


def test_other_rates_of_control_are_other_cases(tmp_path: Path) -> None:
    for name, rate in (("a", 10), ("b", 20)):
        config = {**CONFIG, "physics": {**CONFIG.get("physics", {}), "control_hz": rate}}
        write_evaluation(tmp_path / name, episode_rows(name, 4), config=config)
    assert len(collect_comparisons(read_inputs([tmp_path]).evaluations)) == 2


def test_mixed_worlds_and_sets_are_kept_apart(tmp_path: Path) -> None:
    rows = [*episode_rows("x", 2), *episode_rows("x", 2, world="island"), *episode_rows("x", 2, set="mine")]
    inputs = read_inputs([write_evaluation(tmp_path / "a", rows)])
    assert "kept apart" in inputs.notes[0].text
    titles = [one.cases.title for one in collect_comparisons(inputs.evaluations)]
    assert titles == ["flat, seed 5", "island, seed 5", "mine"]


def test_a_set_with_another_checksum_is_kept_apart(tmp_path: Path) -> None:
    installed = read_episode_set("flat-v1").header.sha256
    rows = episode_rows("x", 2, set="flat-v1")
    write_evaluation(tmp_path / "a", rows, set={"name": "flat-v1", "sha256": installed})
    write_evaluation(
        tmp_path / "b", episode_rows("y", 2, set="flat-v1"), set={"name": "flat-v1", "sha256": "0" * 64}
    )
    inputs = read_inputs([tmp_path])
    assert [(note.path.name, "another set" in note.text) for note in inputs.notes] == [("b", True)]
    first, second = collect_comparisons(inputs.evaluations)
    assert first.cases.title == "flat-v1 (cases 1)" and len(first.methods) == len(second.methods) == 1


def test_populations_of_a_cross_play_are_kept_apart(tmp_path: Path) -> None:
    used = {"set": {"name": "s", "sha256": "a"}}
    write_evaluation(tmp_path / "standard", episode_rows("x", 4, set="s"), **used)
    for name, weights in (("walkers", None), ("foes", "1"), ("others", "2")):
        population = {"name": name, "kind": "option", "location": name, "sha256": weights}
        actors = {"walker": {"count": 2}} if name == "walkers" else {"foe": {"controller": "checkpoint"}}
        write_evaluation(
            tmp_path / name,
            episode_rows("x", 4, set="s"),
            config={**CONFIG, "actors": actors},
            population=population,
            **used,
        )
    titles = [one.cases.title for one in collect_comparisons(read_inputs([tmp_path]).evaluations)]
    assert sorted(titles) == ["s", "s among foes", "s among others", "s among walkers"]


def test_another_version_is_named(tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / "a", episode_rows("x", 2), packages={"dune_rl": "0.0.1"})
    (note,) = read_inputs([folder]).notes
    assert "dune_rl 0.0.1" in note.text


def test_policies_of_several_folders_meet_where_the_cases_are_the_same(tmp_path: Path) -> None:
    write_evaluation(tmp_path / "a", [*episode_rows("x", 6, share=1.0), *episode_rows("go", 6)])
    write_evaluation(tmp_path / "b", [*episode_rows("x", 6, share=0.0), *episode_rows("go", 6)])
    other = {**CONFIG, "task": {**CONFIG["task"], "terminations": {"time_limit": {"max_steps": 7}}}}
    write_evaluation(tmp_path / "c", episode_rows("x", 6), config=other)
    first, second = collect_comparisons(read_inputs([tmp_path]).evaluations)
    # Equal rows are one method; others of the same name are called after their folder too.
    assert [method.name for method in first.methods] == ["x (a)", "go", "x (b)"]
    assert len(first.methods[1].runs) == 2
    pairs = {(one.first, one.second): one for one in first.pairs if one.measure.name == "SR"}
    assert pairs["x (a)", "x (b)"].difference.value == pytest.approx(1.0)
    # Episodes that end otherwise do not pair.
    assert [method.name for method in second.methods] == ["x"]
    assert "task.terminations.time_limit.max_steps" in second.notes[0]
    assert "do not compare" in second.notes[0] and first.numbered == second.numbered == second.notes[0]


def test_different_numbers_of_episodes_pair_on_those_in_common(tmp_path: Path) -> None:
    write_evaluation(tmp_path / "a", episode_rows("x", 8))
    write_evaluation(tmp_path / "b", episode_rows("y", 4))
    (comparison,) = collect_comparisons(read_inputs([tmp_path]).evaluations)
    assert {one.difference.count for one in comparison.pairs if one.measure.name == "SR"} == {4}
    assert "x 8, y 4" in comparison.notes[0]


def test_missing_and_users_own_metrics(tmp_path: Path) -> None:
    rows = [*episode_rows("x", 4, my_metric=2.5), *episode_rows("y", 4)]
    (comparison,) = collect_comparisons(read_inputs([write_evaluation(tmp_path / "a", rows)]).evaluations)
    estimates = comparison.estimates
    assert estimates["x"]["my_metric"].value == pytest.approx(2.5)
    assert "my_metric" not in estimates["y"]
    # Places and ids are no measures.
    assert not {"goal_x_m", "seed", "steps", "episode"} & set(estimates["x"])
    assert "my_metric" not in {one.measure.name for one in comparison.pairs}


def test_several_agents_are_clusters_and_groups_stand_apart(tmp_path: Path) -> None:
    rows = [*episode_rows("x", 5, agents=2), *episode_rows("x", 5, agent="walker_0")]
    first, second = collect_comparisons(read_inputs([write_evaluation(tmp_path / "a", rows)]).evaluations)
    assert [one.cases.title for one in (first, second)] == ["flat, seed 5, rover", "flat, seed 5, walker"]
    assert (first.methods[0].episodes, first.methods[0].agents) == (5, 2)
    assert first.estimates["x"]["SR"].count == 10


def test_different_thresholds_are_told(tmp_path: Path) -> None:
    other = json.loads(json.dumps(CONFIG))
    other["metrics"]["terms"]["vort"]["uneven_tilt_deg"] = 8.0
    write_evaluation(tmp_path / "a", episode_rows("x", 4))
    write_evaluation(tmp_path / "b", episode_rows("y", 4), config=other)
    (comparison,) = collect_comparisons(read_inputs([tmp_path]).evaluations)
    assert comparison.thresholds == [5.0, 8.0]
    assert "different thresholds (5°, 8°)" in comparison.notes[0]


def test_a_policy_on_the_site_of_its_training_is_told(tmp_path: Path) -> None:
    folder = write_training(tmp_path / "study", 1)
    write_rows(folder / "episodes.csv", [*episode_rows("mine", 4), *episode_rows("go_to_goal", 4)])
    (comparison,) = collect_comparisons(read_inputs([folder]).evaluations)
    assert comparison.notes == [
        "mine: measured on the site that it was trained on; on others it may do worse."
    ]


def test_episodes_and_sites_of_a_set_are_told(tmp_path: Path) -> None:
    used = {"name": "flat-v1", "sha256": read_episode_set("flat-v1").header.sha256}
    policies = [{"name": "x", "location": "x", "sha256": None, "sites_of_training": [500, 501]}]
    folder = write_evaluation(
        tmp_path / "a", episode_rows("x", 4, set="flat-v1"), set=used, policies=policies
    )
    (comparison,) = collect_comparisons(read_inputs([folder]).evaluations)
    few, trained = comparison.notes
    assert few == "The set has 200 episodes, of which there are: x 4."
    assert "x was trained on 2 of these sites" in trained


def test_rows_that_were_changed_since_are_left_out(tmp_path: Path) -> None:
    for name in ("episodes.csv", "config.yaml"):
        folder = write_evaluation(tmp_path / name, episode_rows("x", 4), files={name: "0" * 64})
        assert f"{name} is not as the evaluation wrote it" in reasons(folder)[0]
    # The Parquet file says no more than the CSV.
    folder = write_evaluation(tmp_path / "a", episode_rows("x", 4), files={"episodes.parquet": "0" * 64})
    assert read_inputs([folder]).usable


def test_episodes_of_one_site_are_one_sample(tmp_path: Path) -> None:
    rows = [{**row, "world_seed": 500 + int(row["episode"]) // 4} for row in episode_rows("x", 8, set="mine")]
    apart = [{**row, "policy": "y", "world_seed": 500 + number} for number, row in enumerate(rows)]
    write_evaluation(tmp_path / "a", [*rows], set={"name": "mine", "sha256": "1"})
    write_evaluation(tmp_path / "b", [*apart], set={"name": "mine", "sha256": "2"})
    first, second = collect_comparisons(read_inputs([tmp_path]).evaluations)
    assert (first.sites, second.sites) == (2, 0)
    shared, own = first.estimates["x"]["SR"], second.estimates["y"]["SR"]
    assert shared.value == own.value == 0.5
    assert shared.high - shared.low > own.high - own.low


def test_runs_that_differ_only_in_their_seed_are_a_group(tmp_path: Path) -> None:
    for seed in (1, 2, 3):
        write_training(tmp_path / "flat" / f"seed{seed}", seed)
    write_training(tmp_path / "other", 1, learning={"gamma": 0.9})
    groups = group_runs(read_inputs([tmp_path]).training)
    assert [(group.name, group.seeds) for group in groups] == [
        ("flat, 3 seeds", ["1", "2", "3"]),
        ("other", ["1"]),
    ]


def test_groups_of_a_sweep_are_called_by_what_it_varies(tmp_path: Path) -> None:
    for number, (gamma, seed) in enumerate(((0.9, 1), (0.9, 2), (0.99, 1), (0.99, 2))):
        folder = tmp_path / "sweep" / f"{number}_flat_seed{seed}"
        write_training(folder, seed, learning={"gamma": gamma, "name": "sac"})
    groups = group_runs(read_inputs([tmp_path]).training)
    assert [group.name for group in groups] == ["gamma=0.9, 2 seeds", "gamma=0.99, 2 seeds"]


def test_an_unfinished_training_is_told(tmp_path: Path) -> None:
    inputs = read_inputs([write_training(tmp_path / "a", 1, frames=1_500)])
    assert inputs.training and "1,500 of 3,000 frames" in inputs.notes[0].text


def test_a_sweep_is_read_with_its_best_job(tmp_path: Path) -> None:
    inputs = read_inputs([write_sweep(tmp_path / "sweep", ["0.9", "0.95", "0.99"])])
    (sweep,) = inputs.sweeps
    assert [job.parameters for job in sweep.jobs] == [
        {"learning.gamma": rate} for rate in ("0.9", "0.95", "0.99")
    ]
    assert [job.objective for job in sweep.jobs[:2]] == pytest.approx([0.61, 0.62])
    assert sweep.best == "1_flat_seed2"
    table = sweep_table("s", sweep)
    assert [row[-1].text for row in table.rows] == ["61.0", "62.0 (best)", NOTHING]
    equal = replace(sweep, jobs=[replace(job, objective=0.5) for job in sweep.jobs])
    assert {row[-1].text for row in sweep_table("s", equal).rows} == {"50.0"}
    # Its jobs are training runs too.
    assert len(inputs.training) == 2


def test_a_sweep_may_look_for_the_least(tmp_path: Path) -> None:
    folder = write_sweep(tmp_path / "sweep", ["0.9", "0.95", "0.99"], direction="minimize")
    assert read_inputs([folder]).sweeps[0].best == "0_flat_seed1"


def test_the_best_of_optuna_counts_where_no_job_has_the_metric(tmp_path: Path) -> None:
    folder = write_sweep(tmp_path / "sweep", ["0.9", "0.95"])
    (folder / "0_flat_seed1" / "metrics.csv").unlink()
    (folder / "optimization_results.yaml").write_text(
        "best_params: {learning.gamma: 0.95}\nbest_value: 2.0\n"
    )
    assert read_inputs([folder]).sweeps[0].best == "1_flat_seed2"
