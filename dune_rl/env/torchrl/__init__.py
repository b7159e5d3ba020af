"""The TorchRL environment, and transforms for it."""

from dune_rl.env.torchrl.environment import DuneEnv
from dune_rl.env.torchrl.transforms import EpisodeMetrics, SingleAgent

__all__ = ["DuneEnv", "EpisodeMetrics", "SingleAgent"]
