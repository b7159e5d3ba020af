"""Transitions as flat rows with multi-step rewards, as a replay buffer keeps them."""

from collections.abc import Callable

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from dune_rl.learning.networks.policy import FEATURES
from dune_rl.learning.policy_spec import PackedObservation, PolicySpec


class TransitionCodec:
    """Packs a transition into one row: observation, later observation, action, reward, terminated, steps.

    Observations are kept raw: they are normalised when sampled, with the statistics of that time. The
    later one is `steps` later, at most `n_steps`, and the reward is the discounted sum until then.
    Rows are float32; where there are images of uint8, rows are the bytes of those floats, and the images
    of both observations behind them.
    """

    def __init__(self, spec: PolicySpec, n_steps: int = 1, gamma: float = 0.99) -> None:
        self._spec = spec
        self._n_steps, self._gamma = n_steps, gamma
        floats, self._octets = spec.packed_sizes
        self._widths = [floats] * 2 + [spec.action_size, 1, 1, 1]
        self._floats = sum(self._widths)
        self.dtype = torch.uint8 if self._octets else torch.float32
        self.width = 4 * self._floats + 2 * self._octets if self._octets else self._floats

    def encode(self, sequences: TensorDictBase) -> Tensor:
        """Rows (k, width) of the steps (S, T) of S agents, without those in which an agent idles.

        The later observation is that of the step itself, before any reset. Only
        `terminated` is kept of the three ends, so a time limit cannot be mistaken for one.
        """
        after = sequences.get("next")
        done = after.get("done").squeeze(-1)
        reward, steps = multi_step(after.get("reward").squeeze(-1), done, self._n_steps, self._gamma)
        last = torch.arange(done.shape[-1]) + steps - 1
        chosen = (torch.arange(len(done)).unsqueeze(-1), last)
        now = self._spec.pack(sequences.get("observation"))
        later = self._spec.pack(after.get("observation"))
        parts = [
            now.floats,
            later.floats[chosen],
            sequences.get("action"),
            reward.unsqueeze(-1),
            after.get("terminated").float()[chosen],
            steps.unsqueeze(-1).float(),
        ]
        rows = torch.cat(parts, -1).reshape(-1, self._floats)
        if self._octets:
            images = [each.reshape(len(rows), -1) for each in (now.octets, later.octets[chosen])]
            rows = torch.cat([rows.view(torch.uint8), *images], -1)
        idle = sequences.get("done").reshape(-1)
        return rows[~idle] if idle.any() else rows

    def vectors(self, rows: Tensor) -> Tensor:
        """The raw vectors (k, observation_size) observed in `rows`."""
        return self._split(rows)[0].floats[:, : self._spec.observation_size]

    def _split(self, rows: Tensor) -> tuple[PackedObservation, PackedObservation, list[Tensor]]:
        now = later = rows.new_zeros((len(rows), 0), dtype=torch.uint8)
        if self._octets:
            now, later = rows[:, 4 * self._floats :].split(self._octets, -1)
            rows = rows[:, : 4 * self._floats].contiguous().view(torch.float32)
        first, second, *rest = rows.split(self._widths, -1)
        return PackedObservation(first, now), PackedObservation(second, later), rest

    def decode(
        self, rows: Tensor, encode: Callable[[PackedObservation], Tensor], reward_scale: float
    ) -> TensorDict:
        """What a loss takes, batch size (k,), from `rows` (k, width).

        `encode` makes features of observations; those of the later ones, which
        only targets are made of, carry no gradient.
        """
        now, after, (action, reward, terminated, steps) = self._split(rows)
        ended = terminated > 0
        with torch.no_grad():
            later = encode(after)
        return TensorDict(
            {
                FEATURES: encode(now),
                "action": action,
                "steps_to_next_obs": steps,
                "next": TensorDict(
                    {FEATURES: later, "reward": reward * reward_scale, "terminated": ended, "done": ended},
                    [len(rows)],
                ),
            },
            [len(rows)],
        )


def multi_step(reward: Tensor, done: Tensor, n: int, gamma: float) -> tuple[Tensor, Tensor]:
    """Discounted reward of the next `n` steps, and how many there were, from (..., T) each.

    The sum stops at an episode's end, of whatever kind, and at the batch's, so that the second result (int64)
    is between 1 and `n`: bootstrap from the observation after that many steps, discounted `gamma` to that
    power. TorchRL's `MultiStep` keeps the first step's `terminated` flag instead of the last one's, which
    would bootstrap beyond the ends of episodes.
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
