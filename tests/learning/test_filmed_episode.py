"""The film at the end of a training shows an episode of the evaluation in which its policy was the best."""

from pathlib import Path
from typing import Any

import pytest

from dune_rl.commands.end_of_training import choose_episode
from dune_rl.commands.train import train
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.learning.evaluation import PeriodicEvaluation
from dune_rl.learning.settings import EvaluationConf


def row(episode: int, steps: int, success: float, agent: int = 0) -> dict[str, float]:
    return {"agent": float(agent), "episode": float(episode), "steps": float(steps), "success": success}


@pytest.mark.parametrize(
    ("rows", "chosen"),
    [
        ([row(0, 10, 1.0), row(1, 40, 1.0), row(2, 90, 0.0), row(3, 20, 1.0)], 1),
        ([row(0, 10, 0.0), row(1, 40, 0.0)], 1),
        # The film shows the first agent.
        ([row(0, 10, 1.0), row(1, 5, 1.0), row(1, 40, 1.0, agent=1)], 0),
        # Settings may leave the metric out.
        ([{"agent": 0.0, "episode": 0.0, "steps": 5.0}, {"agent": 0.0, "episode": 1.0, "steps": 9.0}], 1),
        ([], 0),
    ],
)
def test_the_longest_episode_with_success_is_chosen(rows: list[dict[str, float]], chosen: int) -> None:
    assert choose_episode(rows) == chosen


def test_the_rows_of_the_best_evaluation_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    good, bad = ({"group": [{**row(0, 10, success), "return": 0.0}]} for success in (1.0, 0.0))
    results = iter([bad, good, bad])
    monkeypatch.setattr("dune_rl.learning.evaluation.evaluate", lambda *_, **__: next(results))
    evaluation = PeriodicEvaluation(EvaluationConf(episodes=1), None, {}, seed=0)
    bests = [evaluation.run(frames, lambda: False) for frames in (10, 20, 30)]
    assert bests == [True, True, False]
    assert evaluation.rows == bad and evaluation.best_rows == good
    resumed = PeriodicEvaluation(EvaluationConf(episodes=1), None, {}, seed=0)
    resumed.restore(evaluation.state())
    assert resumed.rows == bad and resumed.best_rows == good


@pytest.mark.slow
def test_the_film_repeats_an_episode_of_the_best_evaluation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[dict[str, float]] = []

    def drive(view: Any, *_: object) -> None:
        for _done in view.run():
            pass
        names = view.simulation.metric_names(view.group.name)
        seen.append(dict(zip(names, view.simulation.metrics(view.group.name)[0, 0].tolist(), strict=True)))

    monkeypatch.setattr("dune_rl.reporting.views.film.write_video", drive)
    words = [
        "+world=inspection",
        "actors=walkers",
        "sensors=[lidar,goal]",
        "total_frames=192",
        "learning.learning_starts=64",
        "learning.batch_size=32",
        "learning.hidden=[16]",
        "learning.collector.mode=serial",
        "learning.collector.scenes=2",
        "learning.collector.steps=8",
        "learning.evaluation.every_frames=64",
        "learning.evaluation.episodes=3",
        "learning.evaluation.scenes=2",
        # Worlds that training does not draw.
        "learning.evaluation.world_seeds=[2000,2999]",
        "randomisation.world_seed={name: integers, low: 0, high: 3}",
        "task.terminations.time_limit.max_steps=30",
        f"run_dir={tmp_path}/run",
    ]
    result = train(compose(Conf, words))
    (rows,) = result.best_evaluation.values()
    (filmed,) = seen
    (same,) = [each for each in rows if each["episode"] == filmed["episode"]]
    assert choose_episode(rows) == filmed["episode"]
    assert (filmed["steps"], filmed["return"]) == (same["steps"], pytest.approx(same["return"], rel=1e-4))
