"""Adam that leaves out the steps that would make weights infinite or NaN."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn


class FiniteAdam(torch.optim.Adam):
    """Adam that skips a step, weights and moments unchanged, where a gradient is not finite.

    `skipped` counts such steps, and `in_a_row` those since the last good one; both are 0-dimensional tensors
    where the weights are. The fused kernel reads there whether to step, as it does for
    `torch.amp.GradScaler`: nothing waits for a GPU.
    """

    def __init__(self, parameters: Any, **settings: Any) -> None:
        super().__init__(parameters, fused=True, **settings)
        first = self.param_groups[0]["params"][0]
        self.skipped = torch.zeros((), device=first.device)
        self.in_a_row = torch.zeros((), device=first.device)

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None, *, norm: Tensor | None = None) -> Any:
        """Take a step; `norm` is that of all gradients, where the caller knows it."""
        if norm is None:
            parameters = (each for group in self.param_groups for each in group["params"])
            norm = nn.utils.get_total_norm([each.grad for each in parameters if each.grad is not None])
        self.found_inf = (~norm.isfinite()).float()
        self.skipped += self.found_inf
        self.in_a_row.add_(1.0).mul_(self.found_inf)
        return super().step(closure)
