"""Curricula: levels driven by outcomes, nearer goals, eased properties, and states that are restored."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from training import assert_halves_make_a_whole, small, trainer

from dune_rl.config.build import make_learning_env, make_simulation
from dune_rl.config.compose import compose, compose_environment
from dune_rl.config.schema import Conf
from dune_rl.core.errors import ConfigError
from dune_rl.env.curriculum import CURRICULA, Curriculum, by_outcome
from dune_rl.env.replay import RestoreError
from dune_rl.env.simulation import VectorSimulation
from dune_rl.learning.checkpoint import CHECKPOINT_FILE
from dune_rl.learning.settings import CollectorConf

SHORT = ["actors=none", "task.terminations.time_limit.max_steps=3"]


def curriculum_conf(**values: Any) -> Any:
    return CURRICULA.parse_settings({"name": "by_outcome", **values})


def simulation(*words: str, scenes: int = 4, **values: Any) -> VectorSimulation:
    conf = compose_environment("flat", [*SHORT, *words])
    return make_simulation(conf, scenes, 5, curriculum=curriculum_conf(**values))


def goal_distances(made: VectorSimulation, episodes: int) -> np.ndarray:
    """Distances of the goals at the starts of some episodes of each scene, (episodes * M,)."""
    found = []
    for _ in range(episodes):
        made.reset()
        state = made.state.groups["rover"]
        found.append(np.hypot(*(state.goal.position_w - state.motion.position_w[:, :2]).T))
    return np.concatenate(found)


@pytest.mark.parametrize(
    ("outcomes", "expected"),
    [
        ([1.0] * 9, 0.5),
        ([1.0] * 10, 0.6),
        ([0.0] * 10, 0.4),
        ([0.0, 1.0] * 5, 0.5),
        ([0.0] * 5 + [1.0] * 10, 0.6),
    ],
)
def test_the_level_follows_the_mean_of_the_last_outcomes(outcomes: list[float], expected: float) -> None:
    assert by_outcome(0.5, np.array(outcomes), episodes=10) == pytest.approx(expected)


def test_the_level_stays_between_0_and_1() -> None:
    level = Curriculum(curriculum_conf(episodes=1, step=0.7), 1)
    found = []
    for outcome in (1.0, 1.0, 1.0, 0.0, 0.0, 0.0):
        level.begin(np.array([True]))
        level.end(np.array([True]), lambda _, value=outcome: np.array([value]))
        found.append(level.level)
    assert found == pytest.approx([0.7, 1.0, 1.0, 0.3, 0.0, 0.0])


def test_episodes_that_began_at_another_level_do_not_count() -> None:
    level = Curriculum(curriculum_conf(episodes=2, step=0.5), 3)
    level.end(np.array([True, True, False]), lambda _: np.ones(3))
    assert level.level == 0.5
    level.end(np.array([False, False, True]), lambda _: np.zeros(3))
    assert level.state()["outcomes"] == []


@pytest.mark.slow
def test_goals_are_near_at_first_and_as_set_at_the_last_level() -> None:
    least = compose_environment("flat", SHORT).task.spawn.min_goal_distance_m
    easy = goal_distances(simulation(start_level=0.0), 8)
    middle = goal_distances(simulation(start_level=0.5), 8)
    full = goal_distances(simulation(start_level=1.0), 8)
    plain = goal_distances(make_simulation(compose_environment("flat", SHORT), 4, 5), 8)
    # Starts settle by some centimetres.
    assert least - 0.1 < easy.min() and easy.max() < least + 1.0
    assert easy.max() < middle.max() < full.max()
    np.testing.assert_array_equal(full, plain)


def test_outcomes_without_a_value_and_limits_out_of_order() -> None:
    level = Curriculum(curriculum_conf(episodes=2, step=0.5), 3)
    level.end(np.ones(3, bool), lambda _: np.array([1.0, np.nan, 1.0]))
    assert level.level == 0.5
    level.end(np.ones(3, bool), lambda _: np.ones(3))
    assert level.level == 0.5
    with pytest.raises(ConfigError, match=r"lower_below=0.9 must be below raise_above=0.2"):
        by_outcome(0.5, np.ones(3), raise_above=0.2, lower_below=0.9)


def test_the_outcomes_are_of_a_group_that_is_there() -> None:
    with pytest.raises(ConfigError, match="the group 'walker' with the metric 'success' is not here"):
        simulation(group="walker")


def test_without_a_curriculum_a_state_with_one_is_restored_at_full_difficulty() -> None:
    made = simulation(start_level=0.3)
    made.reset()
    plain = make_simulation(compose_environment("flat", SHORT), 4, 5)
    with pytest.raises(RestoreError):
        plain.restore(made.save_state())
    assert plain.curriculum.difficulty.tolist() == [1.0] * 4


def test_properties_rise_from_their_easiest_values() -> None:
    words = ["randomisation.friction={name: uniform, low: 0.5, high: 0.6}"]
    for level, low, high in ((0.0, 1.0, 1.0), (0.5, 0.75, 0.8), (1.0, 0.5, 0.6)):
        made = simulation(*words, start_level=level, easiest={"friction": 1.0})
        made.reset()
        drawn = made.randomized["friction"]
        assert low - 1e-9 <= drawn.min() and drawn.max() <= high + 1e-9


def test_outcomes_of_episodes_change_the_level_of_the_next() -> None:
    # Nobody reaches a goal in three steps.
    made = simulation(start_level=0.6, episodes=4, step=0.25)
    made.reset()
    for _ in range(3):
        result = made.step({"rover": np.zeros((4, 1, 2))})
    assert result.done.all()
    assert made.curriculum.level == pytest.approx(0.35)
    np.testing.assert_allclose(made.curriculum.difficulty, 0.6)
    made.reset(np.array([True, False, False, False]))
    np.testing.assert_allclose(made.curriculum.difficulty, [0.35, 0.6, 0.6, 0.6])


def test_a_restored_state_has_the_level_and_the_difficulty_of_each_episode() -> None:
    made = simulation(start_level=0.6, episodes=4, step=0.25)
    made.reset()
    for _ in range(3):
        made.step({"rover": np.zeros((4, 1, 2))})
    made.reset(np.array([True, True, False, False]))
    made.step({"rover": np.ones((4, 1, 2))})
    saved = made.save_state()
    other = simulation(start_level=0.1, episodes=4, step=0.25)
    other.restore(saved)
    assert other.save_state() == saved


def test_a_misspelt_curriculum_is_told() -> None:
    with pytest.raises(ConfigError, match="by_outcome"):
        compose(Conf, ["+world=flat", "learning.curriculum=by_outcomes"])
    with pytest.raises(ConfigError, match=r"learning.curriculum.measure.*speedy"):
        compose(Conf, ["+world=flat", "learning.curriculum={name: by_outcome, measure: speedy}"])
    with pytest.raises(ConfigError, match=r"easiest.friction: it is not drawn; randomisation.friction draws"):
        compose(Conf, ["+world=flat", "learning.curriculum={name: by_outcome, easiest: {friction: 1.0}}"])
    with pytest.raises(ConfigError, match=r"easiest.fricton: it is not drawn; did you mean friction\?"):
        compose(Conf, ["+world=flat", "learning.curriculum={name: by_outcome, easiest: {fricton: 1.0}}"])
    by_path = compose(Conf, ["+world=flat", "learning.curriculum.step=0.05"])
    assert by_path.learning.curriculum.model_dump()["step"] == 0.05
    seeds = ["randomisation=worlds", "learning.curriculum={name: by_outcome, easiest: {world_seed: 1000}}"]
    with pytest.raises(ConfigError, match=r"easiest.world_seed: no seed is easier"):
        compose(Conf, ["+world=inspection", *seeds])


@pytest.mark.slow
def test_a_resumed_training_goes_on_with_its_levels(tmp_path: Path) -> None:
    conf = compose_environment("flat", ["actors=none", "task.terminations.time_limit.max_steps=20"])
    levels = curriculum_conf(start_level=0.5, episodes=2, raise_above=-1.0, lower_below=-2.0, step=0.01)
    make_env = partial(make_learning_env, conf)
    learning = small(curriculum=levels, hidden=(16,), batch_size=16, learning_starts=64)
    assert_halves_make_a_whole(make_env, tmp_path, learning, frames=640, half=300)
    saved = torch.load(tmp_path / "whole" / CHECKPOINT_FILE, weights_only=True)["collector"]
    assert saved["level"] > 0.5 and saved["state"]["scenes"]["curriculum"]["level"] > 0.5


@pytest.mark.slow
def test_other_processes_begin_at_the_level_of_those_before(tmp_path: Path) -> None:
    conf = compose_environment("flat", SHORT)
    levels = curriculum_conf(start_level=0.5, episodes=1, raise_above=-1.0, lower_below=-2.0, step=0.02)
    learning = small(curriculum=levels, hidden=(16,), batch_size=16, learning_starts=0, warm_up="random")
    learning = learning.model_copy(update={"collector": CollectorConf(mode="sync", scenes=2, steps=4)})
    make_env = partial(make_learning_env, conf)
    first = trainer(tmp_path / "run", learning, make_env=make_env)
    first.train(stop_after_frames=64)
    assert first._level is not None and first._level > 0.5
    second = trainer(tmp_path / "run", learning, make_env=make_env, resume=tmp_path / "run")
    assert second._curriculum_now(levels).start_level == first._level
