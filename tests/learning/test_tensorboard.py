"""TensorBoard's file of a run: what is in it, and that a resumed run does not write points twice."""

import io
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.metadata import (
    EXPERIMENT_TAG,
    SESSION_START_INFO_TAG,
    parse_experiment_plugin_data,
    parse_session_start_info_plugin_data,
)
from training import small, trainer

from dune_rl.commands.train import train
from dune_rl.config.build import make_learning_env
from dune_rl.config.compose import compose
from dune_rl.config.schema import Conf
from dune_rl.learning.evaluation import evaluate
from dune_rl.learning.policies import built_in_policy
from dune_rl.learning.run.tensorboard import EventFile, choose_hyperparameters, log_film, reduce_picture
from dune_rl.learning.trainer import Trainer
from dune_rl.reporting.views.evaluation_pictures import EvaluationTracks


def read(folder: Path) -> EventAccumulator:
    events = EventAccumulator(str(folder), size_guidance={"images": 0, "scalars": 0, "histograms": 0})
    events.Reload()
    return events


def steps(folder: Path) -> dict[str, list[int]]:
    """The steps of each scalar and histogram."""
    events = read(folder)
    tags = events.Tags()
    found = {tag: [event.step for event in events.Scalars(tag)] for tag in tags["scalars"]}
    return found | {tag: [event.step for event in events.Histograms(tag)] for tag in tags["histograms"]}


@pytest.mark.slow
def test_a_resumed_run_has_the_points_of_a_whole_one(tmp_path: Path) -> None:
    learning = small(hidden=(8,))
    trainer(tmp_path / "whole", learning).train()
    # Its checkpoint is at 1,024 frames; what it logs after that is logged again.
    often = learning.checkpoint.model_copy(update={"every_frames": 1024})
    first = trainer(tmp_path / "halves", learning.model_copy(update={"checkpoint": often}))
    first._folder.save = _only_at(first, 1024)  # type: ignore[method-assign]
    first.train(stop_after_frames=1536)
    trainer(tmp_path / "halves", learning, resume=tmp_path / "halves").train()
    whole, halves = steps(tmp_path / "whole"), steps(tmp_path / "halves")
    assert whole == halves
    assert whole["eval/SR"] == [1024, 2048] == whole["sac/action_value"] == whole["eval episodes/return"]


def _only_at(run: Trainer, frames: int) -> Any:
    """A run's `save` that a crash leaves as it was after `frames`."""
    save = run._folder.save

    def at(learners: Any, now: int, progress: Mapping[str, Any], **how: Any) -> None:
        if now == frames:
            save(learners, now, progress, **how)

    return at


@pytest.mark.slow
def test_the_table_of_hyperparameters_has_a_row(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    learning = small(hidden=(8,))
    run = partial(
        Trainer, learning=learning, seed=3, hyperparameters={"learning.gamma": 0.99, "world": "flat"}
    )
    from point_mass import make_point_mass

    result = run(make_point_mass, folder, total_frames=1024, config={"objective": "clearance"}).train()
    events = read(folder)
    # One run for TensorBoard: no folders inside.
    assert not [path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")]
    contents = {tag: events.SummaryMetadata(tag).plugin_data.content for tag in _hparams_tags(events)}
    started = parse_session_start_info_plugin_data(contents[SESSION_START_INFO_TAG])
    assert {name: value.WhichOneof("kind") for name, value in started.hparams.items()} == {
        "learning.gamma": "number_value",
        "world": "string_value",
    }
    columns = [info.name.tag for info in parse_experiment_plugin_data(contents[EXPERIMENT_TAG]).metric_infos]
    assert {"final/SR", "final/return", "final/objective"} <= set(columns)
    last = result.history[-1]
    (rate,) = events.Scalars("final/SR")
    assert rate.value == pytest.approx(last["SR"]) and rate.step == 1024
    (objective,) = events.Scalars("final/objective")
    assert objective.value == pytest.approx(np.mean([row["clearance"] for row in result.evaluation["rover"]]))
    # A resumed run's row is the same one, with newer results.
    run(make_point_mass, folder, total_frames=2048, resume=folder).train()
    assert [event.step for event in read(folder).Scalars("final/SR")] == [1024, 2048]


def _hparams_tags(events: EventAccumulator) -> list[str]:
    return list(events.PluginTagToContent("hparams"))


def test_what_tells_runs_apart() -> None:
    conf = compose(Conf, ["+world=flat", "learning.gamma=0.9"]).model_dump(mode="json")
    words = ["+world=flat", "learning.gamma=0.9", "actors=none", "learning.hidden=[256, 256]"]
    found = choose_hyperparameters(
        conf, [*words, "run_dir=here", "hydra.sweep.dir=there", "film=false", "learning.collector.workers=1"]
    )
    assert found["world"] == "flat" and found["algorithm"] == "sac" and found["actors"] == "none"
    assert found["learning.gamma"] == 0.9 and found["learning.hidden"] == "[256, 256]"
    assert not {"run_dir", "hydra.sweep.dir", "film", "device"} & set(found)
    assert "learning.collector.workers" not in found
    assert choose_hyperparameters({"seed": 3}) == {"seed": 3}


@pytest.mark.slow
def test_films_move(tmp_path: Path) -> None:
    noise = np.random.default_rng(1)
    pictures = [reduce_picture(noise.integers(0, 256, (180, 320, 3), np.uint8)) for _ in range(50)]
    log_film(tmp_path, pictures, 20.0, 7)
    (event,) = read(tmp_path).Images("film")
    film = Image.open(io.BytesIO(event.encoded_image_string))
    assert film.format == "GIF" and film.n_frames == 17 and film.size == (400, 225) and event.step == 7
    EventFile(tmp_path / "none").film("film", [], 5.0, 0)


@pytest.mark.slow
@pytest.mark.parametrize("worlds", [1, 3])
def test_tracks_are_drawn_on_the_maps_of_their_worlds(worlds: int, tmp_path: Path) -> None:
    words = ["+world=island", "task.terminations.time_limit.max_steps=8"]
    words += ["randomisation=worlds"] if worlds > 1 else []
    env = make_learning_env(compose(Conf, words), 2, 4)
    pictures = EvaluationTracks(env, 3)
    drawn = []
    for driver in ("go_to_goal", "random"):
        evaluate(built_in_policy(driver, env), env, 4, seed=4, observer=pictures)
        assert sorted(pictures._seen) == [0, 1, 2]
        for seen in pictures._seen.values():
            assert {len(track.points) for track in seen.tracks} == {9}
            # It begins at the start that is marked.
            assert np.allclose(seen.tracks[0].points[0], [seen.placements[0].x, seen.placements[0].y])
        drawn.append(pictures.draw())
    # A world that all share has one map for good.
    grounds = pictures._ground.cache_info().currsize
    assert grounds == 1 if worlds == 1 else grounds >= worlds
    assert drawn[0].dtype == np.uint8 and drawn[0].shape == drawn[1].shape
    assert (drawn[0] != drawn[1]).any()
    env.close()


@pytest.mark.slow
def test_training_fills_every_tab(tmp_path: Path) -> None:
    words = [
        *("+world=flat", "actors=none", "total_frames=1024", "learning.learning_starts=128"),
        *("learning.batch_size=8", "learning.hidden=[8]", "learning.replay.capacity=1000"),
        *("learning.collector.mode=serial", "learning.collector.scenes=4", "learning.collector.steps=16"),
        *("learning.evaluation.episodes=2", "learning.evaluation.scenes=2", "metrics=navigation"),
        *("task.terminations.time_limit.max_steps=4", f"run_dir={tmp_path / 'run'}"),
    ]
    train(compose(Conf, words), words=words)
    events = read(tmp_path / "run")
    tags = events.Tags()
    assert {"tracks", "film"} == set(tags["images"])
    assert {"train/SR", "eval/SPL", "eval/jerk", "final/SPL"} <= set(tags["scalars"])
    assert {"eval episodes/jerk", "train episodes/path_length", "actions/1"} <= set(tags["histograms"])
