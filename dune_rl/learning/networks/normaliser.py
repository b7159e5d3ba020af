"""Running normalisation of observation vectors."""

import torch
from torch import Tensor, nn

_LEAST_RANGE_M = 1e-3


class Normaliser(nn.Module):
    """Running mean and variance of observation vectors (..., n), which it scales to about unit size.

    Of the entries in `logarithmic` (n,) it takes the logarithm first. On a
    linear scale of 12 m the last half metre before a wall would be a tenth of
    a standard deviation.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor
    logarithmic: Tensor

    def __init__(self, logarithmic: Tensor, clip: float) -> None:
        super().__init__()
        size = len(logarithmic)
        self.clip = clip
        self.register_buffer("logarithmic", logarithmic)
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("variance", torch.ones(size))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    @torch.no_grad()
    def observe(self, vectors: Tensor) -> None:
        """Merge `vectors` (k, n) into the statistics (Chan, Golub and LeVeque's pairwise update)."""
        batch = self._scaled(vectors).double()
        k = len(batch)
        mean, variance = batch.mean(0), batch.var(0, correction=0)
        total = self.count + k
        shift = mean - self.mean.double()
        merged = self.variance.double() * self.count + variance * k + shift**2 * (self.count * k / total)
        self.mean.copy_(self.mean.double() + shift * (k / total))
        self.variance.copy_(merged / total)
        self.count.copy_(total)

    def forward(self, vectors: Tensor) -> Tensor:
        """`vectors` normalised and clipped, same shape."""
        vectors = self._scaled(vectors)
        # The floor keeps a part that never moves (an empty LiDAR) from amplifying its first change.
        return ((vectors - self.mean) / (self.variance + 1e-4).sqrt()).clamp(-self.clip, self.clip)

    def _scaled(self, vectors: Tensor) -> Tensor:
        return torch.where(self.logarithmic, vectors.clamp(min=_LEAST_RANGE_M).log(), vectors)
