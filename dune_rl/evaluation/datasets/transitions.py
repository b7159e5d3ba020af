"""The transitions of episodes: observations, actions, rewards and ends, a file for each episode."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import write_atomically
from dune_rl.geometry.arrays import Flags

Values = dict[str, NDArray[Any]]
OBSERVATIONS, INFOS = "observations", "infos"
ACTIONS, REWARDS, TERMINATIONS, TRUNCATIONS = "actions", "rewards", "terminations", "truncations"
# Metrics whose exact values are the episode's, in its metadata; float32 would round them.
_EXACT = ("episode", "world_seed")
_FIRST_CAPACITY = 256


def info_columns(metric_names: tuple[str, ...]) -> dict[str, int]:
    """The metrics that are recorded in each step, with their columns.

    Left out are ids, and terms of rewards and randomised values ("reward/NAME"): HDF5 takes the "/" for a
    group.
    """
    return {
        name: column
        for column, name in enumerate(metric_names)
        if "/" not in name and name not in (*_EXACT, "agent")
    }


class TransitionRecorder:
    """Records the transitions of the one agent of each of M scenes, as `GymnasiumEnv` would give them.

    `step` copies each entry of a step into an array (steps, M, ...), whatever the number of scenes;
    `finish` writes those of an episode to `folder`.
    """

    def __init__(self, env: EnvBase, folder: Path) -> None:
        self._simulation = env.base_env.simulation
        (self._group,) = env.group_map
        self._columns = info_columns(env.metric_names[self._group])
        self._folder = folder
        self._arrays: Values = {}
        self._scenes = np.arange(self._simulation.num_scenes)
        self._steps = np.zeros_like(self._scenes)
        self._ended = np.zeros(len(self._scenes), bool)

    def begin(self) -> None:
        """Forget the steps of scenes that have made none."""
        fresh = self._simulation.steps == 0
        self._steps[fresh] = 0
        self._ended[fresh] = False

    def step(self, after: TensorDictBase) -> None:
        """Add a step of the scenes whose episode has not ended; `after` is what TorchRL's `step` returns."""
        before, then = after[self._group], after["next", self._group]
        over = after["next", "done"].reshape(-1).numpy()
        terminated = over & _of_agent(then["terminated"])[:, 0]
        values = self._seen(before) | {
            ACTIONS: _of_agent(before["action"]),
            REWARDS: _of_agent(then["reward"])[:, 0],
            TERMINATIONS: terminated,
            TRUNCATIONS: over & _of_agent(then["truncated"])[:, 0] & ~terminated,
        }
        self._reserve(values)
        for key, value in values.items():
            self._arrays[key][self._steps, self._scenes] = value
        # A scene that rests may have ended in this very step, between two of its control steps.
        self._steps += ~self._ended
        ends = over & ~self._ended
        self._ended |= ends
        if ends.any():
            self._add_last(self._seen(then), ends)

    def _seen(self, part: TensorDictBase) -> Values:
        """What is known before an action, (M, ...) each: readings by sensor, and the metrics so far."""
        readings = {f"{OBSERVATIONS}/{key}": _of_agent(value) for key, value in part["observation"].items()}
        return readings | {INFOS: _of_agent(part["metrics"])}

    def _add_last(self, seen: Values, ends: Flags) -> None:
        """Add what was observed after the last steps of the scenes in `ends` (M,)."""
        for key, value in seen.items():
            self._arrays[key][self._steps[ends], self._scenes[ends]] = value[ends]

    def _reserve(self, values: Values) -> None:
        """Make room for this step and the observation after it."""
        needed = int(self._steps.max()) + 2
        for key, value in values.items():
            array = self._arrays.get(key)
            if array is None:
                self._arrays[key] = np.zeros((_FIRST_CAPACITY, *value.shape), value.dtype)
            elif len(array) < needed:
                self._arrays[key] = np.concatenate([array, np.zeros_like(array)])

    def finish(self, episode: int) -> None:
        """Write the transitions of an episode that has ended, whole or not at all."""
        (scene,) = np.flatnonzero(self._simulation.episodes == episode).tolist()
        count = int(self._steps[scene])
        found = {}
        for key, array in self._arrays.items():
            is_seen = key == INFOS or key.startswith(OBSERVATIONS)
            found[key] = array[: count + is_seen, scene]
        metrics = np.nan_to_num(found.pop(INFOS), nan=-1.0)
        found |= {f"{INFOS}/{name}": metrics[:, column] for name, column in self._columns.items()}
        self._folder.mkdir(exist_ok=True)
        with write_atomically(_path(self._folder, episode)) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **found)


def _of_agent(values: Any) -> NDArray[Any]:
    """The entries (M, ...) of the one agent in `values` (M, 1, ...)."""
    found: NDArray[Any] = values[:, 0].numpy()
    return found


def _path(folder: Path, episode: int) -> Path:
    return folder / f"episode_{episode}.npz"


def read_transitions(folder: Path, episodes: int) -> Iterator[Values]:
    """The arrays of the episodes 0 to `episodes` - 1, in order; raises ConfigError if a file is missing."""
    for episode in range(episodes):
        try:
            with np.load(_path(folder, episode), allow_pickle=False) as file:
                yield dict(file)
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"the transitions of episode {episode} cannot be read ({error}); evaluate again"
            ) from None
