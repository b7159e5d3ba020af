"""The benchmark of training: times of an update, and speed beside collecting alone."""

import pytest

from dune_rl.commands.benchmark import learning
from dune_rl.config.commands import BenchmarkConf
from dune_rl.config.compose import compose
from dune_rl.core.errors import ConfigError
from dune_rl.learning.sac.settings import SacConf
from dune_rl.learning.settings import CollectorConf

CONF = compose(BenchmarkConf, ["+world=flat", "actors=none", "sensors=[goal,velocity]", "rounds=2"])


@pytest.mark.slow
def test_an_update_and_the_speed_of_training_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    small = SacConf(
        learning_starts=0,
        batch_size=8,
        hidden=(8,),
        updates_per_frame=0.25,
        collector=CollectorConf(mode="serial", scenes=1, steps=4),
    )
    monkeypatch.setattr(learning, "_settings", lambda algorithm: small)
    found = learning.measure_learning(CONF, "sac")
    assert found["update_ms"] > 0.0 and found["update_ms_perception"] > 0.0
    assert found["learn_ratio"] == found["training_frames_per_s"] / found["collecting_frames_per_s"]
    assert (found["algorithm"], found["workers"], found["scenes_each"]) == ("sac", 0, 1)


def test_an_unknown_algorithm_is_named() -> None:
    with pytest.raises(ConfigError, match="did you mean sac"):
        learning.measure_learning(CONF, "sacc")
