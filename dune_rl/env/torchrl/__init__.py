"""The TorchRL environment, and transforms for it."""

from dune_rl.env.torchrl.environment import DuneEnv
from dune_rl.env.torchrl.episode_metrics import EpisodeMetrics
from dune_rl.env.torchrl.single_agent import SingleAgent

__all__ = ["DuneEnv", "EpisodeMetrics", "SingleAgent"]
