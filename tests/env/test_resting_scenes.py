"""Evaluations simulate no steps that nobody asks for."""

import numpy as np
import pytest
from torchrl.envs import TransformedEnv

from dune_rl.config.build import make_torchrl_env
from dune_rl.config.compose import compose_environment
from dune_rl.env.torchrl import EpisodeMetrics
from dune_rl.evaluation.recorder import EpisodeRecorder
from dune_rl.learning.evaluation import evaluate
from dune_rl.learning.policies import built_in_policy
from dune_rl.physics.bullet.scene import BulletScene


@pytest.mark.slow(all_but=["3-2"])
@pytest.mark.parametrize(("scenes", "episodes"), [(3, 5), (2, 4), (3, 2)])
def test_scenes_without_an_episode_left_are_not_simulated(
    scenes: int, episodes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    conf = compose_environment("flat", (), {"actors": "none"})
    env = TransformedEnv(make_torchrl_env(conf, scenes, 4), EpisodeMetrics())
    made: list[int] = []
    begin = BulletScene.begin_step

    def counted(scene: BulletScene, substeps: int, poses: np.ndarray) -> None:
        made.append(substeps)
        begin(scene, substeps, poses)

    monkeypatch.setattr(BulletScene, "begin_step", counted)
    rows = evaluate(built_in_policy("go_to_goal", env), env, episodes, 4)["rover"]
    # The others are those in which robots settle at a reset, of all scenes at first.
    steps = made.count(conf.physics.substeps)
    assert len(made) - steps == max(scenes, episodes)
    assert steps == sum(row["steps"] for row in rows)
    assert [row["episode"] for row in rows] == list(range(episodes))
    # All go on with the next evaluation.
    again = evaluate(built_in_policy("go_to_goal", env), env, episodes, 4)["rover"]
    assert repr(again) == repr(rows)
    env.close()


def test_no_steps_are_recorded_of_scenes_that_rest() -> None:
    conf = compose_environment("flat", (), {"actors": "walkers"})
    env = TransformedEnv(make_torchrl_env(conf, 3, 4), EpisodeMetrics())
    recorder = EpisodeRecorder(env.base_env.simulation, steps=1, actors=True)
    rows = evaluate(built_in_policy("go_to_goal", env), env, 3, 4, observer=recorder)["rover"]
    # One is shorter, so that its scene rests.
    assert len({row["steps"] for row in rows}) > 1
    recorded = recorder.take_steps()
    for row in rows:
        mine = [step for step in recorded if step["episode"] == row["episode"]]
        for agent in ("rover_0", "walker_0", "walker_1"):
            steps = [step["step"] for step in mine if step["agent"] == agent]
            assert steps == list(range(1, int(row["steps"]) + 1))
    assert not any(recorder._steps)
    env.close()
