"""An algorithm of one's own: registered, trained, saved, loaded and resumed like ours."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from point_mass import make_two_groups
from tensordict import TensorDict, TensorDictBase

import dune_rl
from dune_rl.core.errors import CheckpointError, ConfigError
from dune_rl.learning.algorithm import Algorithm, LearnerContext
from dune_rl.learning.checkpoint import CHECKPOINT_FILE
from dune_rl.learning.learners import build_learner
from dune_rl.learning.policies import WarmupPolicy
from dune_rl.learning.registry import ALGORITHMS
from dune_rl.learning.saved_policies import load_policy
from dune_rl.learning.settings import CollectorConf, EvaluationConf, LearningConf
from dune_rl.learning.trainer import Trainer


class Cloning(Algorithm):
    """Learns to do what the warm-up did, from each batch once."""

    def __init__(self, context: LearnerContext, learning_rate: float = 1e-3) -> None:
        super().__init__(context)
        self._optimiser = torch.optim.Adam(self.policy.parameters(), learning_rate)
        self._batch: TensorDictBase = TensorDict()

    @property
    def warmup_frames(self) -> int:
        return 256

    def warmup_policy(self) -> WarmupPolicy:
        return WarmupPolicy(self.context.group, self.context.spec)

    def absorb(self, batch: TensorDictBase, frames: int) -> None:
        self._batch = batch

    def update(self) -> dict[str, float]:
        action = self.policy.network(self._batch["observation"].copy())["action"]
        loss = torch.nn.functional.mse_loss(action, self._batch["action"])
        self._optimiser.zero_grad()
        loss.backward()
        self._optimiser.step()
        self.updates += 1
        return {"loss/cloning": loss.item()}


@pytest.fixture
def conf() -> Iterator[LearningConf]:
    dune_rl.register_algorithm("cloning")(Cloning)
    settings = ALGORITHMS.settings_class("cloning")
    yield settings(
        learning_rate=1e-2,
        collector=CollectorConf(mode="serial", scenes=4, steps=16),
        evaluation=EvaluationConf(every_frames=256, episodes=4, scenes=4),
    )
    ALGORITHMS._user_parts.clear()


def run(folder: Path, conf: LearningConf, frames: int, **more: Path) -> Trainer:
    return Trainer(make_two_groups, folder, conf, seed=1, total_frames=frames, **more)


@pytest.mark.slow
def test_a_run_with_it_is_saved_loaded_and_resumed(conf: LearningConf, tmp_path: Path) -> None:
    result = run(tmp_path / "run", conf, 512).train()
    assert result.updates == 2 * 512 // 64
    assert list(result.evaluation) == ["rover", "walker"]
    entry = torch.load(tmp_path / "run" / CHECKPOINT_FILE, weights_only=True)["groups"]["walker"]
    assert entry["algorithm"] == "cloning" and entry["experience"] is None
    env = make_two_groups(2, 0)
    policy, _ = load_policy(tmp_path / "run", env)
    assert policy(env.reset())["rover", "action"].shape == (2, 1, 2)
    again = run(tmp_path / "run", conf, 640, resume=tmp_path / "run")
    assert again.frames == 512 and again.updates == result.updates
    assert again.train().frames == 640


def test_what_was_trained_with_it_needs_it(conf: LearningConf, tmp_path: Path) -> None:
    run(tmp_path / "run", conf, 512).train(stop_after_frames=64)
    ALGORITHMS._user_parts.clear()
    with pytest.raises(CheckpointError, match="made with another algorithm: there is no algorithm 'cloning'"):
        load_policy(tmp_path / "run", make_two_groups(1, 0))


def test_another_algorithm_does_not_resume(conf: LearningConf, tmp_path: Path) -> None:
    from training import SMALL

    run(tmp_path / "run", conf, 512).train(stop_after_frames=64)
    with pytest.raises(CheckpointError, match=r"trained with cloning. Resume with learning=cloning"):
        run(tmp_path / "run", SMALL, 512, resume=tmp_path / "run")


def test_what_is_no_algorithm_is_refused(tmp_path: Path) -> None:
    class Nothing:
        """Is no learner."""

        def __init__(self, context: LearnerContext) -> None:
            self.context = context

    ALGORITHMS.register(Nothing)
    try:
        with pytest.raises(ConfigError, match="'Nothing' must be a class derived from Algorithm"):
            build_learner(ALGORITHMS.settings_class("Nothing")(), None)  # type: ignore[arg-type]
    finally:
        ALGORITHMS._user_parts.clear()
