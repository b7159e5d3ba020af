"""The replay buffer: transitions as flat rows, in memory or on disk."""

import logging
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torchrl import logger
from torchrl.data import LazyMemmapStorage, LazyTensorStorage, ReplayBuffer

from dune_rl.core.errors import CheckpointError, ConfigError
from dune_rl.learning.sac.settings import ReplayConf

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

    def load(self, path: Path, numbers: Mapping[str, int]) -> None:
        """The inverse of `save`, on an empty buffer; raises CheckpointError if the file does not fit."""
        try:
            rows = np.load(path, mmap_mode="r", allow_pickle=False)
        except FileNotFoundError as error:
            raise CheckpointError(
                f"The replay buffer {path} is missing: its checkpoint needs it.\n"
                "Put it back, or evaluate the checkpoint and train again."
            ) from error
        except (OSError, ValueError) as error:
            raise CheckpointError(
                f"{path} is damaged: {error}.\nPut a good copy in its place, or train again."
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
