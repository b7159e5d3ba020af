"""Behaviour cloning from a Minari dataset: pip install 'dune_rl[datasets]', then run this file.

    python -m dune_rl.evaluate +world=flat policy=planner episodes=100 dataset=dune_rl/flat/planner-v0
    python examples/behaviour_cloning.py dune_rl/flat/planner-v0 --out clone.pt
    PYTHONPATH=examples python -m dune_rl.evaluate +world=flat policy=behaviour_cloning:Clone seed=1

A network learns the recorded actions by their squared error; `Clone` drives with it.
"""

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

import minari
import numpy as np
import torch
from torch import Tensor, nn

# Where `Clone` looks for the network.
DEFAULT_FILE = "clone.pt"


class CloneNetwork(nn.Module):
    """A multilayer perceptron from observations (N, D) to actions (N, A) in their own units."""

    def __init__(self, inputs: int, low: Tensor, high: Tensor, cells: int = 128) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            *(nn.Linear(inputs, cells), nn.ReLU(), nn.Linear(cells, cells), nn.ReLU()),
            nn.Linear(cells, len(low)),
        )
        for name, values in (("mean", torch.zeros(inputs)), ("scale", torch.ones(inputs))):
            self.register_buffer(name, values)
        self.register_buffer("middle", (low + high) / 2)
        self.register_buffer("half_range", (high - low) / 2)

    def observe(self, observations: Tensor) -> None:
        """Set what inputs are normalised by to the mean and spread of `observations` (N, D)."""
        self.mean.copy_(observations.mean(0))
        # Entries that never change stay as they are.
        spread = observations.std(0)
        self.scale.copy_(torch.where(spread > 1e-3, spread, 1.0))

    def forward(self, observations: Tensor) -> Tensor:
        """The actions, (N, A)."""
        # What is far from all that was seen would be as far from all that was learned.
        inputs = ((observations - self.mean) / self.scale).clamp(-5, 5)
        return self.middle + self.half_range * self.layers(inputs)


def flatten(observation: Mapping[str, Any]) -> Tensor:
    """Readings (N, ...) side by side in the order of their names, (N, D)."""
    rows = [np.reshape(observation[key], (len(observation[key]), -1)) for key in sorted(observation)]
    return torch.from_numpy(np.concatenate(rows, axis=1, dtype=np.float32, casting="unsafe"))


def read_pairs(dataset: minari.MinariDataset, *, only_successes: bool) -> tuple[Tensor, Tensor]:
    """Observations (N, D) and the actions (N, A) taken on them, of all episodes or the successful ones."""
    episodes = [each for each in dataset if each.infos["success"][-1] > 0 or not only_successes]
    if not episodes:
        raise SystemExit(f"no episode of {dataset.id} succeeded; add --all-episodes to learn from failures")
    # The last observation has no action.
    observations = [flatten(each.observations)[:-1] for each in episodes]
    return torch.cat(observations), torch.cat([torch.from_numpy(each.actions) for each in episodes])


def train(network: CloneNetwork, observations: Tensor, actions: Tensor, updates: int, batch: int) -> float:
    """Learn the `actions` (N, A) on `observations` (N, D); returns the mean loss of the last tenth."""
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates)
    losses = []
    for _ in range(updates):
        rows = torch.randint(len(actions), (batch,))
        errors = (network(observations[rows]) - actions[rows]) / network.half_range
        loss = errors.square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        losses.append(loss.item())
    return float(np.mean(losses[-max(1, updates // 10) :]))


class Clone:
    """A policy for `policy=behaviour_cloning:Clone`, of the file clone.pt in the working folder."""

    def __init__(self, file: str = DEFAULT_FILE) -> None:
        content = torch.load(file, weights_only=True)
        self._network = CloneNetwork(content["inputs"], content["low"], content["high"])
        self._network.load_state_dict(content["weights"])

    @torch.no_grad()
    def __call__(self, observation: Mapping[str, Any]) -> np.ndarray:
        """Actions (N, A) for the readings (N, ...) of N agents."""
        actions: np.ndarray = self._network(flatten(observation)).numpy()
        return actions


def main(words: Sequence[str] | None = None) -> float:
    """Learn as the command line says, and write the file; returns the last loss."""
    parser = argparse.ArgumentParser(description="Behaviour cloning from a Minari dataset")
    parser.add_argument("dataset", help="its name, such as dune_rl/flat/planner-v0")
    parser.add_argument("--out", default=DEFAULT_FILE)
    parser.add_argument("--updates", type=int, default=5_000)
    parser.add_argument("--batch", type=int, default=256)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--all-episodes", action="store_true", help="learn from failures, too")
    given = parser.parse_args(words)
    torch.manual_seed(given.seed)
    dataset = minari.load_dataset(given.dataset)
    observations, actions = read_pairs(dataset, only_successes=not given.all_episodes)
    low, high = (torch.from_numpy(bound) for bound in (dataset.action_space.low, dataset.action_space.high))
    network = CloneNetwork(observations.shape[1], low, high)
    network.observe(observations)
    loss = train(network, observations, actions, given.updates, given.batch)
    content = {"inputs": observations.shape[1], "low": low, "high": high, "weights": network.state_dict()}
    torch.save(content, given.out)
    print(f"{len(actions)} transitions, loss {loss:.2g}: {given.out}")
    return loss


if __name__ == "__main__":
    main()
