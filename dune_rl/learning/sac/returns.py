"""Multi-step returns within a collected batch."""

import torch
from torch import Tensor


def multi_step(reward: Tensor, done: Tensor, n: int, gamma: float) -> tuple[Tensor, Tensor]:
    """Discounted reward of the next `n` steps, and how many there were, from (..., T) each.

    The sum stops at an episode's end, of whatever kind, and at the batch's, so
    that the second result (int64) is between 1 and `n`: bootstrap from the
    observation after that many steps, discounted `gamma` to that power.
    TorchRL's `MultiStep` keeps the first step's `terminated` flag instead of the
    last one's, which would bootstrap beyond the ends of episodes.
    """
    total = reward.clone()
    steps = torch.ones_like(reward, dtype=torch.int64)
    going = ~done
    for ahead in range(1, min(n, reward.shape[-1])):
        going = going.clone()
        going[..., -ahead:] = False
        total += torch.where(going, gamma**ahead * reward.roll(-ahead, -1), 0.0)
        steps += going
        going = going & ~done.roll(-ahead, -1)
    return total, steps
