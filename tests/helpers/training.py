"""Small training runs, and what they end with."""

from pathlib import Path
from typing import Any

import torch
from point_mass import make_point_mass

from dune_rl.learning.algorithm import LearnerContext
from dune_rl.learning.checkpoint import CHECKPOINT_FILE
from dune_rl.learning.collector import MakeEnv
from dune_rl.learning.networks.settings import ReplayConf
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.ppo.settings import PpoConf
from dune_rl.learning.run.progress import Reporter
from dune_rl.learning.sac.learner import Sac
from dune_rl.learning.sac.settings import SacConf
from dune_rl.learning.settings import CheckpointConf, CollectorConf, EvaluationConf, LearningConf
from dune_rl.learning.trainer import Trainer

SMALL = SacConf(
    hidden=(32, 32),
    batch_size=64,
    learning_starts=512,
    warm_up="random",
    updates_per_frame=1 / 16,
    learning_rate=1e-3,
    initial_entropy_coefficient=0.05,
    precision="float32",
    replay=ReplayConf(capacity=5000),
    collector=CollectorConf(mode="serial", scenes=8, steps=16),
    evaluation=EvaluationConf(every_frames=1024, episodes=10, scenes=4),
    checkpoint=CheckpointConf(every_frames=10**6),
)


SMALL_PPO = PpoConf(
    hidden=(32, 32),
    batch_size=64,
    epochs=2,
    learning_rate=1e-3,
    collector=CollectorConf(mode="serial", scenes=8, steps=16),
    evaluation=SMALL.evaluation,
    checkpoint=SMALL.checkpoint,
)


class Notes(Reporter):
    """Keeps the lines that are said once."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def note(self, line: str) -> None:
        self.lines.append(line)


def small(**changes: Any) -> SacConf:
    """`SMALL` with other values; `mode` and `storage` are the collector's and the replay buffer's."""
    if "mode" in changes:
        changes["collector"] = SMALL.collector.model_copy(update={"mode": changes.pop("mode")})
    if "storage" in changes:
        changes["replay"] = SMALL.replay.model_copy(update={"storage": changes.pop("storage")})
    return SMALL.model_copy(update=changes)


def trainer(
    folder: Path,
    learning: LearningConf = SMALL,
    *,
    make_env: MakeEnv = make_point_mass,
    total_frames: int = 2048,
    resume: Path | None = None,
    seed: int = 3,
    reporter: Reporter | None = None,
) -> Trainer:
    """A small run; tests of other environments give their own `make_env`."""
    return Trainer(
        make_env,
        folder,
        learning,
        seed=seed,
        total_frames=total_frames,
        resume=resume,
        config={"seed": 3},
        reporter=reporter,
    )


def make_sac(
    spec: PolicySpec,
    folder: Path,
    *,
    total_frames: int = 1,
    agents: int = 1,
    group: str = "rover",
    **settings: Any,
) -> Sac:
    """A learner of one group by itself."""
    context = make_context(spec, folder, total_frames=total_frames, agents=agents, group=group)
    return Sac(context, SacConf(precision=settings.pop("precision", "float32"), **settings))


def make_context(
    spec: PolicySpec,
    folder: Path,
    *,
    total_frames: int = 1,
    agents: int = 1,
    group: str = "rover",
    critic_spec: PolicySpec | None = None,
) -> LearnerContext:
    """What a learner of one group is built for, on the CPU."""
    return LearnerContext(
        group=group,
        num_agents=agents,
        spec=spec,
        total_frames=total_frames,
        folder=folder,
        device=torch.device("cpu"),
        algorithm="sac",
        critic_spec=critic_spec,
    )


def weights(folder: Path) -> dict[str, torch.Tensor]:
    """Weights, targets and optimiser moments of all groups of a run."""
    found: dict[str, torch.Tensor] = {}
    for group, entry in torch.load(folder / CHECKPOINT_FILE, weights_only=True)["groups"].items():
        learner = entry["learner"]
        states = learner["optimiser"]["state"].items()
        moments = {f"{i}.{k}": v for i, state in states for k, v in state.items()}
        every = {**learner["policy"], **learner["loss"], **moments}
        found |= {f"{group}.{key}": value for key, value in every.items()}
    return found


def assert_halves_make_a_whole(
    make_env: MakeEnv, folder: Path, learning: LearningConf = SMALL, frames: int = 1280, half: int = 900
) -> None:
    """Two half-runs end with the weights, targets and optimiser moments of one whole run, bit for bit."""
    trainer(folder / "whole", learning, make_env=make_env, total_frames=frames).train()
    first = trainer(folder / "halves", learning, make_env=make_env, total_frames=frames).train(half)
    assert 0 < first.frames < frames and first.updates > 0
    second = trainer(
        folder / "halves", learning, make_env=make_env, total_frames=frames, resume=folder / "halves"
    ).train()
    assert second.frames == frames
    whole, halves = weights(folder / "whole"), weights(folder / "halves")
    assert whole.keys() == halves.keys()
    different = [key for key, value in whole.items() if not torch.equal(value, halves[key])]
    assert not different
