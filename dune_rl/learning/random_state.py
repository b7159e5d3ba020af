"""Saves and restores the global random states of PyTorch and NumPy."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch


def random_state() -> dict[str, Any]:
    """States of torch's and NumPy's global generators, as `torch.load(weights_only=True)` reads them."""
    name, keys, position, has_gauss, gauss = np.random.get_state(legacy=True)
    mersenne = torch.from_numpy(np.asarray(keys).astype(np.int64))
    return {
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
        "numpy": [str(name), mersenne, int(position), int(has_gauss), float(gauss)],
    }


def set_random_state(state: dict[str, Any]) -> None:
    """The inverse of `random_state`; CUDA states are restored if the number of devices is the same."""
    torch.set_rng_state(state["torch"])
    if state["cuda"] and len(state["cuda"]) == torch.cuda.device_count():
        torch.cuda.set_rng_state_all(state["cuda"])
    name, keys, position, has_gauss, gauss = state["numpy"]
    np.random.set_state((name, keys.numpy().astype(np.uint32), position, has_gauss, gauss))


@contextmanager
def preserve_random_state() -> Iterator[None]:
    """Context that restores the random states at its end."""
    state = random_state()
    try:
        yield
    finally:
        set_random_state(state)
