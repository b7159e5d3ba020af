"""Convolutions round a scan: a return means the same in whatever direction it lies."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from dune_rl.learning.policy_spec import PolicySpec

# Shorter scans go to the networks as they are.
_SHORTEST = 8
_KERNEL, _STRIDE = 5, 2


class ScanEncoder(nn.Module):
    """Passes observation vectors (..., n) on, with their scans convolved: features (..., `size`).

    The parts of a spec that are ranges and of equal length are the channels
    of one circular scan, the present one beside those of before. The first
    layer compares them direction by direction; a perceptron would have to
    learn that anew for every direction. With `channels` 0 nothing is changed.
    """

    _other: Tensor

    def __init__(self, spec: PolicySpec, channels: int) -> None:
        super().__init__()
        scans = _columns_by_length(spec) if channels else {}
        other = torch.ones(spec.observation_size, dtype=torch.bool)
        for columns in scans.values():
            other[columns] = False
        self.register_buffer("_other", other.nonzero().squeeze(1), persistent=False)
        self._lengths = sorted(scans)
        for length in self._lengths:
            self.register_buffer(f"_scans_{length}", scans[length], persistent=False)
        self.convolutions = nn.ModuleList(_convolution(len(scans[n]), channels) for n in self._lengths)
        self.size = len(self._other) + sum(channels * -(-length // _STRIDE) for length in self._lengths)

    def forward(self, vectors: Tensor) -> Tensor:
        """Features (..., size), in float32 also under autocast."""
        if not self._lengths:
            return vectors
        flat = vectors.reshape(-1, vectors.shape[-1])
        parts = [flat[:, self._other]]
        for length, convolution in zip(self._lengths, self.convolutions, strict=True):
            scans = flat[:, self.get_buffer(f"_scans_{length}")]
            parts.append(convolution(scans).flatten(1).float())
        return torch.cat(parts, 1).reshape(*vectors.shape[:-1], self.size)


def _columns_by_length(spec: PolicySpec) -> Mapping[int, Tensor]:
    """Columns (channels, length) of the spec's scans, by their length."""
    columns: dict[int, list[Tensor]] = {}
    start = 0
    for key, length in spec.sizes.items():
        if key in spec.ranges and length >= _SHORTEST:
            columns.setdefault(length, []).append(torch.arange(start, start + length))
        start += length
    return {length: torch.stack(each) for length, each in columns.items()}


def _convolution(scans: int, channels: int) -> nn.Sequential:
    def round_the_scan(n_in: int, stride: int) -> nn.Conv1d:
        return nn.Conv1d(n_in, channels, _KERNEL, stride, padding=_KERNEL // 2, padding_mode="circular")

    return nn.Sequential(round_the_scan(scans, 1), nn.ReLU(), round_the_scan(channels, _STRIDE), nn.ReLU())
