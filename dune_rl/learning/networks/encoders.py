"""Encoders of vectors, scans and images."""

from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor, nn

from dune_rl.learning.policy_spec import PartSpec
from dune_rl.learning.settings import Width

_KERNEL, _STRIDE = 5, 2
# Least number of scans, and in half precision most elements of the matrix, for which a convolution is a
# product with a matrix. Fewer scans are of scenes: whoever acts does so in the same way as ever.
_MINIBATCH, _MOST_ELEMENTS = 128, 2**18
# Bytes up to this are classes (of a segmentation), not brightness.
_MOST_CLASSES = 15
# The last stage's picture is at most this high and wide.
_SMALL_PX = 5


class VectorEncoder(nn.Flatten):
    """Passes all values on, without weights."""

    def __init__(self, part: PartSpec) -> None:
        super().__init__(-len(part.shape))
        self.size = part.size


class CircularConvolution(nn.Conv1d):
    """Convolution round circles (k, C, `length`): (k, channels, n).

    Minibatches of an update are multiplied by the matrix of the convolution instead, where that is faster:
    the gradient of a convolution with few channels takes several times as long as its products need.
    """

    _places: Tensor

    def __init__(self, n_in: int, channels: int, stride: int, length: int) -> None:
        super().__init__(n_in, channels, _KERNEL, stride, padding=_KERNEL // 2, padding_mode="circular")
        starts = torch.arange(0, length, stride) - _KERNEL // 2
        self.register_buffer("_places", (starts[:, None] + torch.arange(_KERNEL)) % length, persistent=False)
        self._length = length
        self._matrix_size = channels * len(starts) * n_in * length

    def forward(self, scans: Tensor) -> Tensor:
        if torch.compiler.is_exporting() or len(scans) < _MINIBATCH:
            return super().forward(scans)
        if self._matrix_size > self._most_elements(scans):
            return super().forward(scans)
        shape = (self.out_channels, len(self._places), self.in_channels)
        matrix = self.weight.new_zeros(*shape, self._length).scatter_add(
            -1,
            self._places[None, :, None].expand(*shape, _KERNEL),
            self.weight[:, None].expand(*shape, _KERNEL),
        )
        assert self.bias is not None
        bias = self.bias.repeat_interleave(shape[1])
        values = nn.functional.linear(scans.flatten(1), matrix.flatten(2).flatten(0, 1), bias)
        return values.unflatten(1, shape[:2])

    def _most_elements(self, scans: Tensor) -> int:
        """Size of the matrix up to which it is faster, as measured on a CPU; on a GPU the convolution is."""
        if scans.device.type != "cpu":
            return 0
        return _MOST_ELEMENTS if torch.is_autocast_enabled("cpu") else _MOST_ELEMENTS // 4


class ScanEncoder(nn.Sequential):
    """Convolutions round a scan (..., n): a return means the same in whatever direction it lies.

    Several scans (..., C, n), the present and earlier ones, are the channels of one circle. The first layer
    compares them direction by direction; a perceptron would have to learn that anew for every direction.
    """

    def __init__(self, part: PartSpec, channels: Annotated[int, Field(ge=1, le=1024)] = 8) -> None:
        length = part.shape[-1]
        scans = part.size // length
        super().__init__(
            CircularConvolution(scans, channels, 1, length),
            nn.ReLU(),
            CircularConvolution(channels, channels, _STRIDE, length),
            nn.ReLU(),
        )
        self._scans, self._axes = (scans, length), len(part.shape)
        self.size = channels * -(-length // _STRIDE)

    def forward(self, scans: Tensor) -> Tensor:
        """Features (..., size), in float32 also under autocast."""
        flat = scans.reshape(-1, *self._scans).contiguous()
        leading = scans.shape[: scans.ndim - self._axes]
        return super().forward(flat).flatten(1).float().reshape(*leading, self.size)


class ImageEncoder(nn.Module):
    """Convolutions over an image (..., height, width, channels): a few dozen features (..., `size`).

    Each of `channels` is a stage: the first reads patches of 8 pixels at every
    4th, or less of a small image, the others halve what is left until it is small.
    """

    def __init__(
        self,
        part: PartSpec,
        channels: Annotated[tuple[Width, ...], Field(min_length=1)] = (16, 32, 32),
        features: Annotated[int, Field(ge=1, le=4096)] = 64,
    ) -> None:
        super().__init__()
        self._part = part
        self._classes = int(part.high) + 1 if part.uint8 and part.high <= _MOST_CLASSES else 0
        n_in = part.shape[2] * (self._classes or 1)
        height, width = part.shape[:2]
        stages: list[nn.Module] = []
        for index, n_out in enumerate(channels):
            coarse = index == 0 and min(height, width) >= 32
            stride = 4 if coarse else 2 if max(height, width) > _SMALL_PX else 1
            kernel, padding = (8, 2) if coarse else (3, 1)
            # A flat image (a LiDAR's rings) is halved along its long side only, once it is low.
            strides = (stride if height > 1 else 1, stride if width > 1 else 1)
            stages += [nn.Conv2d(n_in, n_out, kernel, strides, padding), nn.ReLU()]
            height, width = (
                (pixels + 2 * padding - kernel) // step + 1
                for pixels, step in zip((height, width), strides, strict=True)
            )
            n_in = n_out
        self.stages = nn.Sequential(*stages)
        self.head = nn.Sequential(
            nn.Linear(n_in * height * width, features), nn.LayerNorm(features), nn.Tanh()
        )
        self.size = features

    def forward(self, images: Tensor) -> Tensor:
        """In float32 also under autocast."""
        flat = images.reshape(-1, *self._part.shape)
        pixels = self._scaled(flat).permute(0, 3, 1, 2)
        features: Tensor = self.head(self.stages(pixels).flatten(1)).float()
        return features.reshape(*images.shape[:-3], self.size)

    def _scaled(self, images: Tensor) -> Tensor:
        """About as large as unit normal values."""
        if self._classes:
            one_hot: Tensor = nn.functional.one_hot(images.long(), self._classes).flatten(-2).float()
            return one_hot
        low, high = self._part.low, self._part.high
        if not self._part.uint8 and low >= 0.0:
            # Of a distance it is the ratio that matters, close by more than far away.
            return torch.log1p(images) * (4.0 / torch.tensor(high).log1p().item()) - 2.0
        # Large copies take as long as the convolutions: one in the type that these will want, then in place.
        device = images.device.type
        reduced = torch.is_autocast_enabled(device)
        pixels = images.to(torch.get_autocast_dtype(device) if reduced else torch.float32)
        if pixels is images:
            pixels = images.clone()
        return pixels.mul_(4.0 / (high - low)).sub_(2.0 + low * 4.0 / (high - low))
