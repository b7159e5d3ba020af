"""Fully connected layers."""

from collections.abc import Sequence

from torch import nn


def perceptron(n_in: int, hidden: Sequence[int], n_out: int) -> nn.Sequential:
    """Linear layers with a ReLU after each but the last."""
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [nn.Linear(n_in, width), nn.ReLU()]
        n_in = width
    return nn.Sequential(*layers, nn.Linear(n_in, n_out))
