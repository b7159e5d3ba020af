"""The replay buffer: flat float32 transitions, in memory or on disk."""

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from pydantic import Field
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import LazyMemmapStorage, LazyTensorStorage, ReplayBuffer

from dune_rl.errors import CheckpointError
from dune_rl.learning.layout import Layout
from dune_rl.learning.networks import FEATURES
from dune_rl.learning.returns import multi_step
from dune_rl.settings import Settings

_ROWS_PER_COPY = 65_536


class ReplayConf(Settings):
    """Where transitions are kept, and how many."""

    capacity: int = Field(1_000_000, ge=1)
    storage: Literal["memory", "disk"] = Field("memory", description="disk: a memory map in the run's folder")


class Transitions:
    """How a transition lies in one row: observation, later observation, action, reward, terminated, steps.

    Observations are kept raw: they are normalised when sampled, with the statistics of that day. The
    later one is `steps` later, at most `n_steps`, and the reward is the discounted sum until then.
    """

    def __init__(self, layout: Layout, n_steps: int = 1, gamma: float = 0.99) -> None:
        self._layout = layout
        self._n_steps, self._gamma = n_steps, gamma
        self._widths = [layout.observation_size] * 2 + [layout.action_size, 1, 1, 1]
        self.width = sum(self._widths)

    def rows(self, batch: TensorDictBase) -> Tensor:
        """Rows (k, width) of a collected batch (scenes, steps) with k transitions.

        The later observation is that of the step itself, before any reset. Only
        `terminated` is kept of the three ends, so a time limit cannot be mistaken for one.
        """
        after = batch.get("next")
        done = after.get("done").squeeze(-1)
        reward, steps = multi_step(after.get("reward").squeeze(-1), done, self._n_steps, self._gamma)
        last = (torch.arange(done.shape[-1]) + steps - 1).unsqueeze(-1)
        later = torch.cat([self._layout.vector(after), after.get("terminated").float()], -1)
        later = later.gather(-2, last.expand(*last.shape[:-1], later.shape[-1]))
        parts = [
            self._layout.vector(batch),
            later[..., :-1],
            batch.get("action"),
            reward.unsqueeze(-1),
            later[..., -1:],
            steps.unsqueeze(-1).float(),
        ]
        return torch.cat(parts, -1).reshape(-1, self.width)

    def observations(self, rows: Tensor) -> Tensor:
        """The raw observations (k, n) of `rows`."""
        return rows[:, : self._layout.observation_size]

    def batch(self, rows: Tensor, encode: Callable[[Tensor], Tensor], reward_scale: float) -> TensorDict:
        """What a loss takes, batch size (k,), from `rows` (k, width).

        `encode` makes features of observations; those of the later ones, which
        only targets are made of, carry no gradient.
        """
        now, after, action, reward, terminated, steps = rows.split(self._widths, -1)
        ended = terminated > 0
        with torch.no_grad():
            later = encode(after)
        return TensorDict(
            {
                FEATURES: encode(now),
                "action": action,
                "steps_to_next_obs": steps,
                "next": TensorDict(
                    {
                        FEATURES: later,
                        "reward": reward * reward_scale,
                        "terminated": ended,
                        "done": ended,
                    },
                    [len(rows)],
                ),
            },
            [len(rows)],
        )


class Replay:
    """A ring of rows (width,) sampled uniformly with torch's global generator."""

    def __init__(
        self, conf: ReplayConf, width: int, scratch: Path, device: torch.device | str = "cpu"
    ) -> None:
        """`scratch` is the folder that the storage `disk` maps into memory."""
        if conf.storage == "disk":
            storage = LazyMemmapStorage(conf.capacity, scratch_dir=str(scratch), existsok=True)
        else:
            storage = LazyTensorStorage(conf.capacity, device=device)
        self._buffer = ReplayBuffer(storage=storage)
        self._scratch = scratch
        self._width = width
        self._capacity = conf.capacity
        self._device = torch.device(device)

    def close(self) -> None:
        """Delete the memory map, which holds nothing that a save does not."""
        shutil.rmtree(self._scratch, ignore_errors=True)

    def __len__(self) -> int:
        return len(self._buffer)

    def extend(self, rows: Tensor) -> None:
        """Add `rows` (k, width), over the oldest where the ring is full."""
        self._buffer.extend(rows)

    def minibatches(self, count: int, size: int, at_once: int = 16) -> Iterator[Tensor]:
        """`count` independent minibatches (size, width); several are gathered in one go, which is faster."""
        while count > 0:
            now = min(count, at_once)
            rows = self._buffer.sample(now * size).to(self._device)
            yield from rows.split(size)
            count -= now

    def save(self, path: Path) -> dict[str, int]:
        """Write the rows as a `.npy` file, and give the plain numbers that `load` needs beside it."""
        size = len(self)
        rows = self._buffer.storage[:size] if size else torch.zeros(0, self._width)
        with path.open("wb") as file:
            np.lib.format.write_array_header_1_0(
                file, {"descr": "<f4", "fortran_order": False, "shape": (size, self._width)}
            )
            # In pieces: the ring may be as large as the memory.
            for piece in rows.split(_ROWS_PER_COPY):
                file.write(piece.cpu().contiguous().numpy().tobytes())
            file.flush()
            os.fsync(file.fileno())
        return {"size": size, "cursor": int(self._buffer.writer.state_dict()["_cursor"])}

    def load(self, path: Path, numbers: Mapping[str, int]) -> None:
        """The inverse of `save`, on an empty buffer; raises CheckpointError if the file does not fit."""
        try:
            rows = np.load(path, mmap_mode="r", allow_pickle=False)
        except FileNotFoundError as error:
            raise CheckpointError(
                f"The replay buffer {path} is missing: its checkpoint needs it.\n"
                "Put it back, or evaluate the checkpoint and train anew."
            ) from error
        except (OSError, ValueError) as error:
            raise CheckpointError(
                f"{path} is damaged: {error}.\nPut a good copy in its place, or train anew."
            ) from error
        if rows.shape != (numbers["size"], self._width):
            raise CheckpointError(
                f"{path} holds rows of shape {rows.shape}, not {(numbers['size'], self._width)}: "
                "it belongs to another checkpoint.\nPut the right file in its place, or train anew."
            )
        if len(rows) > self._capacity:
            raise CheckpointError(
                f"{path} holds {len(rows)} rows, more than learning.replay.capacity={self._capacity}.\n"
                f"Resume with learning.replay.capacity={len(rows)} or more."
            )
        for start in range(0, len(rows), _ROWS_PER_COPY):
            self.extend(torch.from_numpy(np.array(rows[start : start + _ROWS_PER_COPY])))
        if len(rows) == self._capacity:
            self._buffer.writer.load_state_dict({"_cursor": numbers["cursor"]})
