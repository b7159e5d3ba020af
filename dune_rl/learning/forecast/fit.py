"""Fits a motion forecast to recorded tracks, and measures its errors on tracks that the fit does not read."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Floats
from dune_rl.learning.forecast.recorder import TrackSamples
from dune_rl.sensors.perception.motion_forecast import (
    AHEAD_S,
    FEATURES,
    OUTPUT_SCALES,
    OUTPUTS,
    constant_velocity,
)

_WIDTH = 128
_RATE, _DECAY = 3e-3, 1e-4
# Errors [usual ones] below this count by their square.
_SMOOTH = 0.1
_LEAST_SAMPLES = 500

Weights = dict[str, Floats]


def fit_forecast(
    samples: TrackSamples,
    updates: int,
    batch_size: int,
    seed: int,
    progress: Callable[[int], None] = lambda done: None,
) -> Weights:
    """The arrays of a forecast's file, but for `step_s`; raises ConfigError for too few samples.

    The loss is the cross-entropy of what is an agent, and the mean distance of what is told of agents from
    the truth, in units of OUTPUT_SCALES: where a walker may go on or turn back, the likelier way is told, and
    not the mean of both.
    """
    if len(samples.features) < _LEAST_SAMPLES or not samples.followed.any():
        raise ConfigError(
            f"{len(samples.features):,} tracks, {int(samples.followed.sum()):,} of them of agents that were "
            f"followed for {AHEAD_S[-1]} s, are too few for a forecast: run more episodes, among more agents"
        )
    generator = torch.Generator().manual_seed(seed)
    features = torch.from_numpy(samples.features)
    mean, scale = features.mean(dim=0), features.std(dim=0) + 1e-3
    features = (features - mean) / scale
    target = torch.from_numpy((samples.told - constant_velocity(samples.features)) / OUTPUT_SCALES)
    agents = torch.from_numpy(samples.agents.astype(np.float32))
    counts = torch.from_numpy(np.where(_known(samples), 1.0, 0.0).astype(np.float32))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        sizes = (FEATURES, _WIDTH, _WIDTH, _WIDTH, OUTPUTS)
        layers = [nn.Linear(size, after) for size, after in itertools.pairwise(sizes)]
    optimiser = torch.optim.AdamW(
        [p for layer in layers for p in layer.parameters()], _RATE, weight_decay=_DECAY
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, _RATE, total_steps=updates)
    for update in range(updates):
        batch = torch.randint(len(features), (batch_size,), generator=generator)
        values = features[batch]
        for layer in layers[:-1]:
            values = functional.silu(layer(values))
        values = layers[-1](values)
        error = values[:, 1:].reshape(batch_size, -1, 2) - target[batch]
        distance = (error.square().sum(dim=-1) + _SMOOTH**2).sqrt()
        weight = counts[batch]
        loss = functional.binary_cross_entropy_with_logits(values[:, 0], agents[batch])
        loss = loss + (distance * weight).sum() / weight.sum().clamp(min=1.0)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        progress(update + 1)
    found = {"mean": mean, "scale": scale}
    for number, layer in enumerate(layers):
        found |= {f"weight_{number}": layer.weight.detach().T, f"bias_{number}": layer.bias.detach()}
    return {name: np.ascontiguousarray(values.numpy(), np.float32) for name, values in found.items()}


def _known(samples: TrackSamples) -> Any:
    """Which numbers are known of each track, (R, 2 + A)."""
    now = np.broadcast_to(samples.agents[:, None], (len(samples.agents), 2))
    ahead = np.broadcast_to(samples.followed[:, None], (len(samples.agents), len(AHEAD_S)))
    return np.concatenate([now, ahead], axis=1)


def forecast_errors(
    samples: TrackSamples, chances: Floats, told: Floats, least: float
) -> list[dict[str, Any]]:
    """Rows of a table: how many agents and others are told right, and errors beside constant velocity's."""
    agents, taken = samples.agents, chances >= least
    counts = {
        "tracks": len(agents),
        "agents among them": int(agents.sum()),
        "agents that are taken for agents [%]": _percent(taken[agents]),
        "agents among what is taken for agents [%]": _percent(agents[taken]),
    }
    rows = [_row(name, count, None) for name, count in counts.items()]
    filtered = constant_velocity(samples.features)
    names = ("place [m]", "velocity [m/s]", *(f"place in {time:g} s [m]" for time in AHEAD_S))
    for number, (name, known) in enumerate(zip(names, _known(samples).T, strict=True)):
        missed = [
            np.hypot(*(each[known, number] - samples.told[known, number]).T) for each in (told, filtered)
        ]
        for word, share in (("median", 50), ("90th percentile", 90)):
            values = (float(np.percentile(each, share)) if len(each) else float("nan") for each in missed)
            rows.append(_row(f"error of {name}, {word}", *(round(value, 3) for value in values)))
    return rows


def _row(measure: str, forecast: float, filtered: float | None) -> dict[str, Any]:
    return {"measure": measure, "forecast": forecast, "constant velocity": filtered}


def _percent(flags: Any) -> float:
    return round(100.0 * float(flags.mean()), 1) if len(flags) else float("nan")
