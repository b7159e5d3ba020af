"""Transitions as flat rows with multi-step rewards, and the replay buffer that holds them."""

import logging
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl import logger
from torchrl.data import LazyMemmapStorage, LazyTensorStorage, ReplayBuffer

from dune_rl.core.errors import CheckpointError, ConfigError
from dune_rl.core.files import write_atomically
from dune_rl.core.untrusted_files import first_line, printable
from dune_rl.learning.networks.policy import FEATURES
from dune_rl.learning.networks.settings import ReplayConf
from dune_rl.learning.policy_spec import PackedObservation, PolicySpec

# TorchRL announces every buffer that it makes, on the console.
logger.setLevel(logging.WARNING)

_ROWS_PER_COPY = 65_536
_MOST_OF_MEMORY = 0.75


def check_memory(conf: ReplayConf, row: int, count: int) -> None:
    """Raise ConfigError where `count` rows of `row` bytes would not fit into this machine's memory."""
    if conf.storage == "disk" or not hasattr(os, "sysconf"):
        return
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    needed = row * min(conf.capacity, count)
    if needed > _MOST_OF_MEMORY * memory:
        fits = int(_MOST_OF_MEMORY * memory / row)
        raise ConfigError(
            f"a replay buffer of {min(conf.capacity, count):,} transitions takes {needed / 2**30:.0f} GiB, "
            f"and this machine has {memory / 2**30:.0f}.\n"
            f"Set learning.replay.capacity={fits} or less, or learning.replay.storage=disk."
        )


class Replay:
    """A ring of rows (width,) of one type, sampled uniformly with torch's global generator."""

    def __init__(
        self,
        conf: ReplayConf,
        width: int,
        scratch: Path,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """`scratch` is the folder that the storage `disk` maps into memory."""
        if conf.storage == "disk":
            storage = LazyMemmapStorage(conf.capacity, scratch_dir=str(scratch), existsok=True)
        else:
            storage = LazyTensorStorage(conf.capacity, device=device)
        self._buffer = ReplayBuffer(storage=storage)
        self._scratch = scratch
        self._width = width
        self._dtype = dtype
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

    @property
    def _descr(self) -> str:
        return "|u1" if self._dtype == torch.uint8 else "<f4"

    def save(self, path: Path) -> dict[str, int]:
        """Write the rows as a `.npy` file, and give the plain numbers that `load` needs beside it."""
        size = len(self)
        rows = self._buffer.storage[:size] if size else torch.zeros(0, self._width, dtype=self._dtype)
        with path.open("wb") as file:
            np.lib.format.write_array_header_1_0(
                file, {"descr": self._descr, "fortran_order": False, "shape": (size, self._width)}
            )
            # In pieces: the ring may be as large as the memory.
            for piece in rows.split(_ROWS_PER_COPY):
                file.write(piece.cpu().contiguous().numpy().tobytes())
            file.flush()
            os.fsync(file.fileno())
        return {"size": size, "cursor": int(self._buffer.writer.state_dict()["_cursor"])}

    def save_beside(self, path: Path) -> dict[str, Any]:
        """Write the rows to `path`.npy, atomically; raises CheckpointError where that fails."""
        file = path.with_name(f"{path.name}.npy")
        try:
            with write_atomically(file) as temporary:
                return {"file": file.name, **self.save(temporary)}
        except OSError as error:
            raise CheckpointError(
                f"{file} cannot be written: {error.strerror or error}.\n"
                "Free some space, allow writing there, or set learning.checkpoint.replay=false; "
                "what was saved before is intact."
            ) from error

    def load_from(self, folder: Path, saved: Mapping[str, Any]) -> None:
        """Read what `save_beside` wrote in `folder` and returned; raises CheckpointError where it cannot."""
        name = str(saved["file"])
        if Path(name).name != name:
            raise CheckpointError(
                f"A checkpoint in {folder} names the replay buffer {printable(name)}, outside of its folder: "
                "it is not read.\nGive a checkpoint that dune_rl wrote."
            )
        self.load(folder / name, saved)

    def load(self, path: Path, numbers: Mapping[str, Any]) -> None:
        """The inverse of `save`, on an empty buffer; raises CheckpointError if the file does not fit."""
        try:
            rows = np.load(path, mmap_mode="r", allow_pickle=False)
        except FileNotFoundError as error:
            raise CheckpointError(
                f"The replay buffer {path} is missing: its checkpoint needs it.\n"
                "Put it back, or evaluate the checkpoint and train again."
            ) from error
        # The header is a Python literal, and its parser raises many errors.
        except Exception as error:
            raise CheckpointError(
                f"{path} is damaged: {first_line(error)}.\nPut a good copy in its place, or train again."
            ) from error
        if rows.shape != (numbers["size"], self._width) or rows.dtype.str != self._descr:
            raise CheckpointError(
                f"{path} holds rows of shape {rows.shape} of {rows.dtype.str}, not "
                f"{(numbers['size'], self._width)} of {self._descr}: it belongs to another checkpoint.\n"
                "Put the right file in its place, or train again."
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

    def observations(self, rows: Tensor) -> PackedObservation:
        """The raw observations (k, ...) in which the actions of `rows` were taken."""
        return self._split(rows)[0]

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
