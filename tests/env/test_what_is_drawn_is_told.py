"""What randomisation drew is told in infos, evaluations and logs, and its settings are checked."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scripted_physics import scripted_simulation
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

import dune_rl
from dune_rl.config.build import make_torchrl_env
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.env.distributions import Choice, Integers, LogUniform, Uniform
from dune_rl.env.randomisation import RandomisationConf
from dune_rl.env.torchrl import EpisodeMetrics
from dune_rl.learning.evaluation import evaluate
from dune_rl.learning.policies import built_in_policy
from dune_rl.learning.run.log import RunLog
from dune_rl.metrics.episode import BUILT_IN, PAPER_METRICS


# -- what is drawn is told -------------------------------------------------------------------------
def test_info_tells_what_was_drawn() -> None:
    settings = {"randomisation": {"world_seed": [0, 3], "friction": [0.5, 0.7]}, "actors": "none"}
    env = dune_rl.gym_env("island", **settings)
    seen = set()
    for _ in range(4):
        _, info = env.reset()
        assert 0.5 <= info["randomisation/friction"] <= 0.7
        assert info["randomisation/world_seed"] in range(4)
        after = env.step(np.float32([0.5, 0.0]))[-1]
        assert after["randomisation/friction"] == info["randomisation/friction"]
        assert "randomisation/brightness" not in info
        seen.add(info["randomisation/friction"])
    assert len(seen) == 4
    env.close()


@pytest.mark.slow
def test_evaluation_tells_what_was_drawn_whatever_the_number_of_scenes() -> None:
    settings = {
        "randomisation": {"world_seed": [0, 3], "friction": [0.5, 0.7]},
        "actors": "none",
        "task": {"terminations": {"time_limit": {"max_steps": 12}}},
    }
    rows = []
    for scenes in (1, 3):
        inner = make_torchrl_env(compose_environment("island", (), settings), scenes, 4)
        env = TransformedEnv(inner, EpisodeMetrics())
        rows.append(evaluate(built_in_policy("go_to_goal", env), env, 4, 4)["rover"])
        env.close()
    assert repr(rows[0]) == repr(rows[1])
    assert len({row["randomisation/friction"] for row in rows[0]}) == 4


def test_a_run_log_shows_the_mean_of_what_was_drawn(tmp_path: Path) -> None:
    names = (*BUILT_IN, *PAPER_METRICS, "randomisation/friction")
    log = RunLog(tmp_path, {"rover": names})
    metrics = torch.zeros(1, 2, 1, len(names))
    metrics[0, :, 0, names.index("randomisation/friction")] = torch.tensor([0.5, 0.7])
    done = torch.ones(1, 2, 1, dtype=torch.bool)
    rover = TensorDict({"metrics": metrics}, (1, 2, 1))
    collected = TensorDict({"next": TensorDict({"done": done, "rover": rover}, (1, 2))}, (1, 2))
    log.log_batch(collected, 64, {"rover": 0})
    log.close()
    events = EventAccumulator(str(tmp_path)).Reload()
    (scalar,) = events.Scalars("randomisation/friction")
    assert (scalar.step, scalar.value) == (64, pytest.approx(0.6))


def test_without_randomisation_nothing_more_is_told() -> None:
    simulation, _ = scripted_simulation()
    assert not simulation.randomized
    assert not [name for name in simulation.metric_names() if name.startswith("randomisation")]


# -- settings --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("world", "words", "message"),
    [
        (
            "flat",
            ["randomisation.world_seed=[0,9]"],
            "randomisation.world_seed: the world 'flat' has no seed; leave it null, or choose a world that "
            "is made from a seed",
        ),
        (
            "island",
            ["randomisation.friction=[2,1]"],
            "randomisation.friction: low must be at most high (got 2 and 1)",
        ),
        (
            "island",
            ["randomisation.friction=[0,1]"],
            "randomisation: friction must lie between 0.01 and 10 (got 0 to 1)",
        ),
        (
            "island",
            ["randomisation.world_seed=[0,16777216]"],
            "randomisation: world_seed must lie between 0 and 16777215 (got 0 to 16777216)",
        ),
        (
            "island",
            ["randomisation.layout_seed=[1,2.5,4]"],
            "randomisation.layout_seed: values must be whole numbers (got [1.0, 2.5, 4.0])",
        ),
        (
            "island",
            ["randomisation.friction={name: gauss, low: 1, high: 2}"],
            "randomisation.friction must be one of uniform, log_uniform, normal, choice "
            "(got {'name': 'gauss', 'low': 1, 'high': 2})",
        ),
        (
            "island",
            ["randomisation.fricton=[0.5,1]"],
            "randomisation.fricton is not a setting; did you mean randomisation.friction?",
        ),
        (
            "island",
            ["randomisation.sun_bearing_deg=[0,60]", "weather.time_of_day_h=9"],
            "randomisation.sun_bearing_deg: weather.time_of_day_h=9 determines the position of the sun; "
            "set one of them to null",
        ),
    ],
)
def test_bad_settings(world: str, words: list[str], message: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose_environment(world, words)
    assert str(error.value) == message


def test_lists_are_short_for_distributions() -> None:
    conf = compose_environment(
        "island",
        [
            "randomisation.friction=[0.5,1]",
            "randomisation.world_seed=[3,7]",
            "randomisation.layout_seed=[1,5,9]",
            "randomisation.brightness={name: log_uniform, low: 0.5, high: 2}",
        ],
    ).randomisation
    assert conf == RandomisationConf(
        friction=Uniform(low=0.5, high=1.0),
        world_seed=Integers(low=3, high=7),
        layout_seed=Choice(values=(1.0, 5.0, 9.0)),
        brightness=LogUniform(low=0.5, high=2.0),
    )
    assert list(conf.distributions) == ["world_seed", "layout_seed", "friction", "brightness"]
