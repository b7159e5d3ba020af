"""Cross-play: the robots' policies among all populations, what is written, and what is refused."""

import csv
import io
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from rich.console import Console

from dune_rl.config.agents import AgentGroupConf
from dune_rl.config.build import make_learning_env
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError
from dune_rl.core.files import sha256_of
from dune_rl.evaluation.actor_populations import find_populations
from dune_rl.evaluation.blocks import EpisodeBlock
from dune_rl.evaluation.cross_play import (
    begin_cross_play,
    is_cross_play,
    run_cross_play,
    settings_among,
)
from dune_rl.evaluation.cross_play_figure import describe_cell, draw_matrices, row_title
from dune_rl.evaluation.folder import read_provenance
from dune_rl.evaluation.running import BlockRunner
from dune_rl.learning.algorithm import LearnerContext
from dune_rl.learning.checkpoint import write_checkpoint_file
from dune_rl.learning.learners import build_learner
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.run.folder import RunFolder
from dune_rl.reporting.collect import collect_comparisons
from dune_rl.reporting.reading import read_inputs

TINY = ["+world=flat", "+experiment=multi_agent", "learning.hidden=[8]", "learning.precision=float32"]
SHORT = "task.terminations.time_limit.max_steps=6"
QUIET = Console(quiet=True)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A run of a rover and adversaries, with policies that have learned nothing."""
    conf = compose(Conf, [*TINY, "actors.walker.task=adversarial", "actors.walker.count=2", SHORT])
    env = make_learning_env(conf, 1, 0)
    torch.manual_seed(0)
    folder = RunFolder(tmp_path_factory.mktemp("runs") / "foes", conf.model_dump(mode="json"), fresh=True)
    learners = {}
    for group, agents in env.group_map.items():
        spec = PolicySpec.of(env, group)
        context = LearnerContext(group, len(agents), spec, 1, folder.path, torch.device("cpu"), "sac")
        learners[group] = build_learner(conf.learning.of_group(group), context)
    folder.save_policies(learners, 0)
    folder.save_policies(learners, 0, {"measure": "SR", "score": 0.0, "episodes": 1, "seed": 1})
    folder.release()
    env.close()
    return folder.path


def settings(*words: str) -> EvaluateConf:
    conf = compose(
        EvaluateConf,
        ["+world=flat", "policy=go_to_goal", "against=random", "cross_play=true", "seed=3", SHORT, *words],
    )
    return conf.model_copy(update={"episodes": 3})


@pytest.mark.slow
def test_every_policy_meets_every_population(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "matrix"
    conf = settings(f"populations=[none,walkers,{run}]", "scenes=3")
    populations = find_populations(conf)
    assert [one.name for one in populations] == ["none", "walkers", "foes"]
    begin_cross_play(conf, populations, out, overwrite=False)
    assert is_cross_play(out) and not is_cross_play(run)
    run_cross_play(out, QUIET)
    with (out / "cross_play.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {(row["robot"], row["population"], row["measure"]) for row in rows} == {
        (robot, population, measure)
        for robot in ("go_to_goal", "random")
        for population in ("none", "walkers", "foes")
        for measure in ("SR", "TC", "OC")
    }
    # Three episodes have no bootstrap interval.
    known = [row for row in rows if row["measure"] == "SR" or not math.isnan(float(row["low"]))]
    assert all(float(row["low"]) <= float(row["value"]) <= float(row["high"]) for row in known)
    picture = np.asarray(Image.open(out / "cross_play.png").convert("RGB"))
    assert picture.shape[0] > 200 and len(np.unique(picture.reshape(-1, 3), axis=0)) > 20
    # All populations have the same episodes: equal starts and goals.
    starts = []
    for name in ("none", "walkers", "foes"):
        with (out / name / "episodes.csv").open() as file:
            kept = [key for key in next(csv.reader(file)) if key.startswith(("start_", "goal_"))]
            file.seek(0)
            starts.append([[row[key] for key in kept] for row in csv.DictReader(file)])
    assert starts[0] == starts[1] == starts[2] and len(starts[0]) == 6
    # Reports do not take one population for another.
    comparisons = collect_comparisons(read_inputs([out]).evaluations)
    assert sorted(one.cases.title.split(" among ")[1] for one in comparisons) == ["foes", "none", "walkers"]
    assert all(len(one.methods) == 2 for one in comparisons)
    # What is complete is not run again, and a population that is not is.
    before = (out / "cross_play.csv").read_bytes()
    provenance = read_provenance(out / "foes")
    assert provenance["complete"]
    (out / "foes" / "provenance.json").write_text(json.dumps({**provenance, "complete": False}))
    (out / "cross_play.csv").unlink()
    run_cross_play(out, QUIET)
    assert (out / "cross_play.csv").read_bytes() == before
    assert read_provenance(out / "foes")["complete"]
    with pytest.raises(ConfigError, match="holds results already"):
        begin_cross_play(conf, populations, out, overwrite=False)


@pytest.mark.slow
def test_actors_of_a_run_act_by_its_policy_in_its_bodies(run: Path) -> None:
    (population,) = find_populations(settings(f"populations=[{run}]"))
    conf = settings_among(settings("populations=[none]"), population, run / "out")
    rover, walker = conf.groups
    assert rover.is_external and not walker.is_external
    assert walker.count == 2 and walker.sensors is not None and walker.task is not None
    assert list(walker.sensors) == ["goal", "neighbours", "lidar", "velocity"]
    assert not walker.task.rewards and walker.task.terminations["goal_reached"].renew
    assert not conf.cross_play and conf.populations == ()


def test_actors_of_a_run_are_as_in_the_run_and_act_by_its_last_policy(tmp_path: Path) -> None:
    presence = "actors.walker.presence={arrive_s: [0, 2], stay_s: [3, 4]}"
    conf = compose(Conf, [*TINY, "actors.walker.count=2", presence, SHORT])
    source = tmp_path / "visitors"
    source.mkdir()
    for name in ("policy_best.pt", "policy_last.pt"):
        content = {"config": conf.model_dump(mode="json"), "groups": {}, "name": name}
        write_checkpoint_file(source / name, "policy", content)
    (population,) = find_populations(settings(f"populations=[{source}]"))
    group = population.groups["walker"]
    assert group.keys() == AgentGroupConf.model_fields.keys()
    assert group["presence"] == {"arrive_s": [0.0, 2.0], "stay_s": [3.0, 4.0]}
    assert group["controller"] == {"checkpoint": str(source / "policy_last.pt")}
    assert population.sha256 == sha256_of(source / "policy_last.pt")


@pytest.mark.slow
def test_populations_without_room_are_told_before_anything_is_made(tmp_path: Path) -> None:
    words = ["+world=construction", "policy=go_to_goal", "cross_play=true", "scenes=1"]
    conf = compose(EvaluateConf, [*words, "populations=[none,trucks,tractor]"])
    conf = conf.model_copy(update={"episodes": 1})
    out = tmp_path / "matrix"
    with pytest.raises(ConfigError, match=r"populations: trucks: [^$]*\npopulations: tractor: "):
        begin_cross_play(conf, find_populations(conf), out, overwrite=False)
    assert not out.exists()


@pytest.mark.slow
def test_an_interruption_says_once_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def cut(self: BlockRunner, block: EpisodeBlock, emit: Callable[..., None]) -> None:
        raise KeyboardInterrupt

    conf, out, said = settings("populations=[none]", "against=[]"), tmp_path / "matrix", io.StringIO()
    begin_cross_play(conf, find_populations(conf), out, overwrite=False)
    monkeypatch.setattr(BlockRunner, "run", cut)
    with pytest.raises(KeyboardInterrupt):
        run_cross_play(out, Console(file=said, width=500))
    asked = [line for line in said.getvalue().splitlines() if "go on with" in line]
    assert [line.partition("; ")[2] for line in asked] == [
        f"go on with python -m dune_rl.evaluate resume={out}"
    ]


@pytest.mark.slow
def test_a_folder_of_another_cross_play_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "matrix"
    first, second = (settings(f"populations=[{name}]", "against=[]") for name in ("none", "walkers"))
    begin_cross_play(first, find_populations(first), out, overwrite=False)
    with pytest.raises(ConfigError, match=r"matrix holds a cross-play among others \(none\); remove it, or "):
        begin_cross_play(second, find_populations(second), out, overwrite=True)
    assert [each.name for each in sorted(out.iterdir())] == ["cross_play.json", "none"]


def test_what_resuming_does_not_mend_is_told_alone(tmp_path: Path) -> None:
    conf, out, said = settings("populations=[none]", "against=[]"), tmp_path / "matrix", io.StringIO()
    begin_cross_play(conf, find_populations(conf), out, overwrite=False)
    shutil.rmtree(out / "none")
    with pytest.raises(ConfigError):
        run_cross_play(out, Console(file=said, width=500))
    assert said.getvalue() == ""


def test_rows_of_several_groups_name_theirs() -> None:
    robots = [("go_to_goal", "scout"), ("go_to_goal", "rover")]
    assert [row_title(*each, robots) for each in robots] == ["go_to_goal, scout", "go_to_goal, rover"]
    assert row_title(*robots[0], robots[:1]) == "go_to_goal"


def test_a_population_that_has_the_robots_name_is_refused() -> None:
    (walkers,) = find_populations(settings("populations=[walkers]"))
    data = settings("populations=[walkers]").model_dump(mode="json")
    data["agents"] = {"walker": {"body": "rover_zero"}}
    with pytest.raises(
        ConfigError, match=r"^populations: walkers has a group walker, as the robots are called"
    ):
        settings_among(EvaluateConf.model_validate(data), walkers, Path("out"))


def test_a_population_that_is_there_twice_is_named() -> None:
    with pytest.raises(ConfigError, match=r"^populations: none is there twice; leave one of them out$"):
        find_populations(settings("populations=[none,walkers,none]"))


def test_a_record_that_leads_out_of_its_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "cross_play.json").write_text('{"populations": [{"name": ".."}], "robots": []}')
    with pytest.raises(ConfigError, match="names a folder outside"):
        run_cross_play(tmp_path, Console(quiet=True))


@pytest.mark.slow
def test_what_is_no_population_is_named(run: Path, tmp_path: Path) -> None:
    published = Path(__file__).parents[2] / "experiments" / "flat" / "seed1" / "policy.pt"
    words = f"populations=[walkrs,my_people,runs/lost,learning_walkers,{published}]"
    with pytest.raises(ConfigError) as error:
        find_populations(settings(words))
    first, unknown, lost, second, third = str(error.value).splitlines()
    assert first.startswith("populations: walkrs is no option of actors, and no run; did you mean walkers?")
    assert unknown.startswith(
        "populations: my_people is no option of actors, and no run: there are cars, cows, "
    )
    assert unknown.endswith("options of your own need --config-dir FOLDER")
    assert lost == "populations: there is no runs/lost; name a run, a policy file or an option of actors"
    assert second.startswith("populations: nobody drives walker of actors=learning_walkers; give a run")
    assert third.startswith(f"populations: {published} trained no actors, but rover")
    for words, said in (
        ("populations=null", "cross_play tests robots among populations of actors; name some"),
        ("cross_play=false", "populations are of a cross-play; give cross_play=true as well"),
    ):
        with pytest.raises(ConfigError, match=said):
            settings("populations=[walkers]", words)


def test_cells_have_intervals_and_better_ones_are_darker(tmp_path: Path) -> None:
    row = {"measure": "SR", "value": 0.5, "low": 0.25, "high": 0.75}
    assert describe_cell(row) == "50.0 % (25.0 to 75.0)"
    assert describe_cell({**row, "measure": "TC"}, "\n") == "0.50\n(0.25 to 0.75)"
    assert describe_cell({**row, "value": float("nan")}) == "-"
    brightness = {}
    for measure, values in (("SR", (0.1, 0.9)), ("TC", (0.1, 0.9))):
        cells = [
            {"robot": "a", "group": "rover", "population": str(i), "measure": measure, "value": value,
             "low": 0.0, "high": 1.0}
            for i, value in enumerate(values)
        ]  # fmt: skip
        draw_matrices(cells, (measure,), tmp_path / f"{measure}.png")
        picture = np.asarray(Image.open(tmp_path / f"{measure}.png").convert("L"), float)
        middle = picture[:, picture.shape[1] // 3 :]
        left, right = np.array_split(middle[picture.shape[0] // 4 : picture.shape[0] // 2], 2, axis=1)
        brightness[measure] = right.mean() - left.mean()
    assert brightness["SR"] < 0 < brightness["TC"]


def test_where_nothing_is_near_the_clearance_is_no_result_of_driving(tmp_path: Path) -> None:
    def shades(*values: float) -> list[float]:
        about = {"robot": "a", "group": "rover", "measure": "OC", "low": 1.0, "high": 1.0}
        cells = [{**about, "population": str(i), "value": value} for i, value in enumerate(values)]
        draw_matrices(cells, ("OC",), tmp_path / "oc.png")
        picture = np.asarray(Image.open(tmp_path / "oc.png").convert("L"), float)
        line = picture[int(0.3 * len(picture)), picture.shape[1] // 6 :]
        coloured = line[line < 254]
        return [float(np.median(part)) for part in np.array_split(coloured, len(values))]

    near, far, none = shades(1.0, 3.0, 12.0)
    # The two that differ are as far apart as without the third, which is grey.
    assert near - far > 100.0 and none > 200.0
    assert near - far == pytest.approx(np.subtract(*shades(1.0, 3.0)), abs=5.0)
