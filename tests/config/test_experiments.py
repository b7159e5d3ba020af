"""The studies under `experiments/`: their weights fit what is in the tree, and drive."""

import csv
import json
from pathlib import Path

import pytest
import torch

from dune_rl.commands import evaluate as evaluate_command
from dune_rl.commands.command_line import parse_arguments
from dune_rl.config.build import make_learning_env
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose
from dune_rl.learning.checkpoint import read_checkpoint_file
from dune_rl.learning.evaluation import evaluate
from dune_rl.learning.saved_policies import load_policy
from dune_rl.statistics.measures import average_metrics

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
README = EXPERIMENTS.parent / "README.md"
SPEED_PAGE = EXPERIMENTS.parent / "docs" / "concepts" / "speed.md"
POLICIES = sorted(EXPERIMENTS.rglob("policy.pt"))
# Of the study of actors one seed, and no robot among adversaries, who are there to keep it from its goals.
DRIVING = [
    file
    for file in POLICIES
    if file.parents[1].name != "actors" or file.parent.name in ("walkers_1", "social_1")
]


@pytest.mark.slow(all_but=["flat/seed1"])
@pytest.mark.parametrize("file", DRIVING, ids=lambda file: str(file.parent.relative_to(EXPERIMENTS)))
def test_the_weights_of_a_study_still_drive(file: Path) -> None:
    conf = compose(EvaluateConf, [f"checkpoint={file}"], [], read_checkpoint_file(file, "policy")["config"])
    env = make_learning_env(conf, 8, seed=3)
    policy, _ = load_policy(file, env)
    rows = evaluate(policy, env, 8, seed=3)["rover"]
    env.close()
    # Random actions reach one goal in ten.
    assert average_metrics(rows)["TR"] >= 0.75


def test_studies_name_no_folder_of_the_machine_they_ran_on() -> None:
    assert len(POLICIES) >= 4
    for file in POLICIES:
        config = torch.load(file, weights_only=True)["config"]
        assert not Path(config["run_dir"]).is_absolute()
        assert "run_dir: runs/" in (file.parent / "config.yaml").read_text()


def test_the_table_of_memory_is_that_of_its_files() -> None:
    folder = EXPERIMENTS / "memory"
    text = (folder / "README.md").read_text()
    for engine in ("bullet", "dart"):
        parts = dict(list(csv.reader((folder / f"scenes_{engine}.csv").read_text().splitlines()))[1:])
        libraries = sum(int(parts[part]) for part in parts if part == "Python" or part.startswith("import "))
        assert f"| {engine} | {libraries} | {parts['together']} |" in text
        if engine == "bullet":
            assert (
                f"hold {parts['together']} MiB, of which {libraries} are libraries" in SPEED_PAGE.read_text()
            )


def test_the_table_of_new_worlds_is_that_of_its_file() -> None:
    folder = EXPERIMENTS / "memory"
    text = (folder / "README.md").read_text()
    measured: dict[tuple[str, str], list[str]] = {}
    for row in csv.DictReader((folder / "worlds.csv").read_text().splitlines()):
        if row["worlds entered"] in ("48", "144", "240", "336") and "removed" not in row["variant"]:
            measured.setdefault((row["engine"], row["variant"]), []).append(row["resident_mib"])
    for (engine, variant), figures in measured.items():
        cells = " | ".join(figures + ["-"] * (4 - len(figures)))
        assert f"| {engine}, {variant} | {cells} |" in text
    assert {engine for engine, _ in measured} == {"bullet", "dart"}


def test_the_table_of_inspection_is_that_of_its_episodes() -> None:
    folder = EXPERIMENTS / "inspection"
    with open(folder / "evaluation" / "episodes.csv") as file:
        rows = list(csv.DictReader(file))
    columns = [[row for row in rows if row["policy"] == policy] for policy in ("inspection", "go_to_goal")]
    assert [len(episodes) for episodes in columns] == [200, 200]
    assert {row["seed"] for row in rows} == {"21"}
    text = (folder / "README.md").read_text()
    table = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line[:1] == "|"
    ]
    shown = {cells[0].strip("*"): cells[1:] for cells in table}
    for name, column, scale in (
        ("SR", "success", 100.0),
        ("TR", "reached", 100.0),
        ("collisions per episode", "collisions", 1.0),
        ("MTT [s]", "time_to_goal", 1.0),
        ("OC [m]", "clearance", 1.0),
        ("VORT [m/s]", "vort", 1.0),
    ):
        for cell, episodes in zip(shown[name], columns, strict=False):
            figure = cell.strip("*").split()[0]
            values = [float(row[column]) for row in episodes if row[column] not in ("", "nan")]
            digits = len(figure.partition(".")[2])
            assert figure == f"{scale * sum(values) / len(values):.{digits}f}", name


def test_the_table_of_speed_is_that_of_its_run() -> None:
    lines = (EXPERIMENTS / "speed" / "benchmark.jsonl").read_text().splitlines()
    environment, cameras, _ = (json.loads(line) for line in lines)
    text = SPEED_PAGE.read_text()
    for name in ("overhead_ratio", "torchrl_ratio", "pettingzoo_ratio"):
        assert f"(`{name}`) | {environment[name]:.2f} |" in text
    colour, depth = (cameras[f"overhead_ratio_{name}"] for name in ("camera", "depth"))
    assert f"(`overhead_ratio_camera`, `_depth`) | {colour:.2f}, {depth:.2f} |" in text
    assert f"| {environment['core_steps_per_s']:,.0f} steps/s:" in text
    assert f"| reset of a scene | {environment['reset_ms']:.1f} ms |" in text
    headline = " ".join(README.read_text().split())
    assert f"add {environment['overhead_ratio'] - 1.0:.0%} to the physics time".replace("%", " %") in headline
    assert f"{environment['core_steps_per_s']:,.0f} control steps a second" in headline


def test_the_costs_of_sensors_and_new_worlds_are_those_of_their_runs() -> None:
    text = " ".join(SPEED_PAGE.read_text().split())
    sensors = json.loads((EXPERIMENTS / "speed" / "sensors.jsonl").read_text())
    camera, far = sensors["camera_speedup"], sensors["camera_speedup_heightfield"]
    assert f"| {camera:.1f} \u00d7, {far:.0f} \u00d7 |" in text
    assert f"(`lidar_speedup`) | {sensors['lidar_speedup']:.1f} \u00d7 |" in text
    lines = (EXPERIMENTS / "speed" / "new_worlds.jsonl").read_text().splitlines()
    worlds = [json.loads(line) for line in lines]
    for kind in ("default", "camera"):
        own = sorted((row for row in worlds if row["sensors"] == kind), key=lambda row: row["fresh_ms"])
        first, last = own[0], own[-1]
        shown = f"{first['fresh_ms'] / 1e3:.1f} (`{first['world']}`) to {last['fresh_ms'] / 1e3:.1f} s"
        assert f"takes {shown} (`{last['world']}`)" in text
        kept = [row["kept_ms"] / 1e3 for row in own]
        assert f"and {min(kept):.1f} to {max(kept):.1f} s where" in text


def test_the_cost_of_actors_is_that_of_its_run() -> None:
    found = json.loads((EXPERIMENTS / "speed" / "actors.jsonl").read_text())
    path, force, orca = (found[f"actors_cost{kind}"] for kind in ("", "_social_force", "_orca"))
    text = " ".join(SPEED_PAGE.read_text().split())
    assert f"(`actors_cost`) {path:.0%}".replace("%", " %") in text
    assert f"by social forces {force:.0%}, by ORCA {orca:.0%}".replace("%", " %") in text


def test_sizes_films_and_live_topics_are_those_of_their_runs() -> None:
    text = " ".join(SPEED_PAGE.read_text().split())
    sizes = json.loads((EXPERIMENTS / "speed" / "sizes.jsonl").read_text())
    films = (EXPERIMENTS / "speed" / "films.jsonl").read_text().splitlines()
    memory, scene = sizes["process_memory_mib"], sizes["scene_memory_mib"]
    assert f"holds {memory:.0f} MiB, and each further scene {scene:.0f}" in text
    starts = sizes["startup_s"]
    assert f"A wheel has {sizes['wheel_mib']:.1f} MiB." in text
    assert f"begin in {min(starts.values()):.1f} (`{min(starts, key=starts.__getitem__)}`)" in text
    assert f"to {max(starts.values()):.1f} s (`{max(starts, key=starts.__getitem__)}`)" in text
    assert f"`train` begins in {starts['train']:.1f}" in text
    first, before, now = (list(json.loads(line)["film_cpu_s"].values()) for line in films)
    small, training, view = now
    assert f"takes {small:.0f} s of processor time at 640" in text and f"{training:.0f} s at the 960" in text
    assert f"and {view:.0f} s at the 1920" in text
    assert f"the latter two took {before[1]:.0f} and {before[2]:.0f} s; on a slower machine" in text
    assert f"{first[0]:.0f}, {first[1]:.0f} and {first[2]:.0f} s." in text
    with (EXPERIMENTS / "speed" / "films_in_turns.csv").open(newline="") as opened:
        rows = list(csv.DictReader(opened))
    old, new = ([float(row["film_cpu_s"]) for row in rows[first::2]] for first in (0, 1))
    assert f"took {min(new):.1f} to {max(new):.1f} s, and by the code of {rows[0]['commit']}" in text
    assert f"{min(old):.1f} to {max(old):.1f} s" in text
    with (EXPERIMENTS / "speed" / "live_topics.csv").open(newline="") as opened:
        (row,) = csv.DictReader(opened)
    assert f"take {row['median_ms']} ms in the median" in text and f"and {row['late_ms']} ms in 95" in text


def test_the_cost_of_perception_is_that_of_its_runs() -> None:
    lines = (EXPERIMENTS / "speed" / "perception.jsonl").read_text().splitlines()
    plain, flat, rings = (json.loads(line)["overhead_ratio"] for line in lines)
    text = " ".join(SPEED_PAGE.read_text().split())
    assert f"of {plain:.2f} with `sensors=default` becomes {flat:.2f} with `sensors=perception`" in text
    assert f"and {rings:.2f} with `sensors=perception_3d`" in text
    shares = [f"{100.0 * (one - plain) / one:.0f}" for one in (flat, rings)]
    assert f"{shares[0]} and {shares[1]} % of a step are perception" in text


def test_the_table_of_failures_is_that_of_its_files() -> None:
    folder = EXPERIMENTS / "policies"
    text = (folder / "README.md").read_text()
    columns = ["collisions_person", "collisions_static", "stuck", "timeout", "flipped", "out_of_world"]
    table = text[text.index("| set | failed |") :].split("\n\n")[0].splitlines()[2:]
    assert len(table) == 14
    for line in table:
        name, *shown = [cell.strip() for cell in line.split("|")[1:-1]]
        seeds = (1,) if "-site-" in name else (1, 2, 3)
        files = [folder / "evaluations" / f"all_worlds_{seed}" / name / "episodes.csv" for seed in seeds]
        rows = [row for file in files for row in csv.DictReader(file.read_text().splitlines())]
        failed = [row for row in rows if not float(row["success"])]
        counts = [sum(float(row[column]) > 0 for row in failed) for column in columns]
        assert [int(cell) for cell in shown] == [len(failed), *counts]
        assert all(any(float(row[column]) > 0 for column in columns) for row in failed)


def test_without_a_set_a_policy_is_evaluated_in_the_worlds_that_its_run_kept_for_that() -> None:
    words = [f"checkpoint={EXPERIMENTS / 'policies' / 'all_worlds_1' / 'policy.pt'}", "+world=inspection"]
    drawn = evaluate_command._compose(parse_arguments(words)).randomisation.distributions["world_seed"]
    assert drawn.limits == (2000, 2999)
    asked = [*words, "randomisation.world_seed={name: integers, low: 7, high: 9}"]
    drawn = evaluate_command._compose(parse_arguments(asked)).randomisation.distributions["world_seed"]
    assert drawn.limits == (7, 9)


def test_the_errors_of_the_forecast_are_those_of_its_file() -> None:
    folder = EXPERIMENTS / "forecast"
    rows = list(csv.reader((folder / "errors.csv").read_text().splitlines()))
    lines = [" | ".join(f"{float(cell):,g}" if cell else "" for cell in row[1:]) for row in rows[1:]]
    text = (folder / "README.md").read_text()
    for (measure, *_), line in zip(rows[1:], lines, strict=True):
        assert f"| {measure} | {line} |" in text
    assert len(lines) == 18


def test_the_touches_of_persons_with_a_forecast_are_those_of_the_episodes() -> None:
    def touches(name: str) -> list[int]:
        found = []
        for world in ("flat", "inspection", "construction"):
            file = EXPERIMENTS / "policies" / "evaluations" / name / f"{world}-crowd-v2" / "episodes.csv"
            rows = csv.DictReader(file.read_text().splitlines())
            failed = [row for row in rows if float(row["success"]) == 0.0]
            found.append(sum(float(row["collisions_person"]) > 0.0 for row in failed))
        return found

    text = " ".join((EXPERIMENTS / "forecast" / "README.md").read_text().split())
    before, after = touches("dwa"), touches("dwa_forecast")
    pairs = [f"{one} to {other}" for one, other in zip(before, after, strict=True)]
    assert f"fell from {pairs[0]}, {pairs[1]} and {pairs[2]} of 250" in text
