"""Convolutions over an image: from pixels to a few dozen features."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from dune_rl.learning.policy_spec import ImageSpec

# Bytes up to this are classes (of a segmentation), not brightness.
_MOST_CLASSES = 15
# The last stage's picture is at most this high and wide.
_SMALL_PX = 5


class ImageEncoder(nn.Module):
    """Features (..., `size`) of an image (..., height, width, channels).

    Each of `channels` is a stage: the first reads patches of 8 pixels at every
    4th, or less of a small image, the others halve what is left until it is small.
    """

    def __init__(self, image: ImageSpec, channels: Sequence[int], size: int) -> None:
        super().__init__()
        self._image = image
        self._classes = int(image.high) + 1 if image.uint8 and image.high <= _MOST_CLASSES else 0
        n_in = image.shape[2] * (self._classes or 1)
        height, width = image.shape[:2]
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
        self.head = nn.Sequential(nn.Linear(n_in * height * width, size), nn.LayerNorm(size), nn.Tanh())
        self.size = size

    def forward(self, images: Tensor) -> Tensor:
        """In float32 also under autocast."""
        flat = images.reshape(-1, *self._image.shape)
        pixels = self._scaled(flat).permute(0, 3, 1, 2)
        features: Tensor = self.head(self.stages(pixels).flatten(1)).float()
        return features.reshape(*images.shape[:-3], self.size)

    def _scaled(self, images: Tensor) -> Tensor:
        """About as large as unit normal values."""
        if self._classes:
            one_hot: Tensor = nn.functional.one_hot(images.long(), self._classes).flatten(-2).float()
            return one_hot
        low, high = self._image.low, self._image.high
        if not self._image.uint8 and low >= 0.0:
            # Of a distance it is the ratio that matters, close by more than far away.
            return torch.log1p(images) * (4.0 / torch.tensor(high).log1p().item()) - 2.0
        # Large copies take as long as the convolutions: one in the type that these will want, then in place.
        device = images.device.type
        reduced = torch.is_autocast_enabled(device)
        pixels = images.to(torch.get_autocast_dtype(device) if reduced else torch.float32)
        if pixels is images:
            pixels = images.clone()
        return pixels.mul_(4.0 / (high - low)).sub_(2.0 + low * 4.0 / (high - low))
