"""Convolutions round a scan: a return means the same in whatever direction it lies."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from dune_rl.learning.layout import Layout

# Shorter scans go to the networks as they are.
_SHORTEST = 8
_KERNEL, _STRIDE = 5, 2


class ScanEncoder(nn.Module):
    """Passes observation vectors (..., n) on, with their scans convolved: features (..., `size`).

    The parts of a layout that are ranges and of equal length are the channels
    of one circular scan, the present one beside those of before. The first
    layer compares them direction by direction; a perceptron would have to
    learn that anew for every direction. With `channels` 0 nothing is changed.
    """

    def __init__(self, layout: Layout, channels: int) -> None:
        super().__init__()
        scans = _columns_by_length(layout) if channels else {}
        self._scans = [columns for _, columns in sorted(scans.items())]
        scanned = {int(column) for columns in self._scans for column in columns.flatten()}
        self._others = torch.tensor([i for i in range(layout.observation_size) if i not in scanned])
        self.convolutions = nn.ModuleList(_convolution(len(columns), channels) for columns in self._scans)
        self.size = layout.observation_size - len(scanned)
        self.size += sum(channels * -(-columns.shape[1] // _STRIDE) for columns in self._scans)

    def forward(self, vectors: Tensor) -> Tensor:
        """Features (..., size), in float32 also under autocast."""
        if not self._scans:
            return vectors
        flat = vectors.reshape(-1, vectors.shape[-1])
        parts = [flat[:, self._others]]
        for columns, convolution in zip(self._scans, self.convolutions, strict=True):
            parts.append(convolution(flat[:, columns]).flatten(1).float())
        return torch.cat(parts, 1).reshape(*vectors.shape[:-1], self.size)


def _columns_by_length(layout: Layout) -> Mapping[int, Tensor]:
    """Columns (channels, length) of the layout's scans, by their length."""
    columns: dict[int, list[Tensor]] = {}
    start = 0
    for key, length in layout.sizes.items():
        if key in layout.ranges and length >= _SHORTEST:
            columns.setdefault(length, []).append(torch.arange(start, start + length))
        start += length
    return {length: torch.stack(each) for length, each in columns.items()}


def _convolution(scans: int, channels: int) -> nn.Sequential:
    around = {"kernel_size": _KERNEL, "padding": _KERNEL // 2, "padding_mode": "circular"}
    return nn.Sequential(
        nn.Conv1d(scans, channels, **around),
        nn.ReLU(),
        nn.Conv1d(channels, channels, stride=_STRIDE, **around),
        nn.ReLU(),
    )
