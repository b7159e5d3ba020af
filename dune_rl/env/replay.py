"""Episodes that are repeated from their actions: logs, restored states, and copies of environments."""

import hashlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import DuneError
from dune_rl.geometry.arrays import Floats
from dune_rl.state.state import State

_FIRST_LENGTH = 64


class ActionLog:
    """The actions of M scenes since their episodes began, `width` numbers in each step."""

    def __init__(self, num_scenes: int, width: int) -> None:
        self._rows = np.zeros((num_scenes, _FIRST_LENGTH, width), np.float32)
        self._scenes = np.arange(num_scenes)

    def add(self, steps: NDArray[np.int64], actions: Sequence[NDArray[np.floating]]) -> None:
        """Record the `actions` of each group, (M, ...), at each scene's step `steps` (M,)."""
        if int(steps.max()) >= self._rows.shape[1]:
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)], axis=1)
        scenes, first = self._scenes, 0
        for values in actions:
            flat = values.reshape(len(scenes), -1)
            self._rows[scenes, steps, first : first + flat.shape[1]] = flat
            first += flat.shape[1]

    def plain(self, steps: NDArray[np.int64]) -> list[list[list[float]]]:
        """Each scene's actions so far, its first `steps` (M,), as plain numbers, exact in float32."""
        return [self._rows[scene, :count].tolist() for scene, count in enumerate(steps.tolist())]

    def aligned(self, plain: list[list[list[float]]]) -> Floats:
        """What `plain` gave as rows (longest, M, width), each scene's last action in the last row."""
        longest = max((len(actions) for actions in plain), default=0)
        rows = np.zeros((longest, len(plain), self._rows.shape[2]), np.float32)
        for scene, actions in enumerate(plain):
            if actions:
                rows[longest - len(actions) :, scene] = np.array(actions, np.float32)
        return rows


class RestoreError(DuneError):
    """Repeating the saved episodes did not reproduce the saved state."""


def state_digest(state: State | None) -> str:
    """Hash of the bytes of the poses, velocities and goals of all agents."""
    digest = hashlib.sha256()
    for name, group in () if state is None else sorted(state.groups.items()):
        digest.update(name.encode())
        motion = group.motion
        for values in (motion.position_w, motion.roll_pitch_yaw, motion.velocity_w, group.goal.position_w):
            digest.update(values.tobytes())
    return digest.hexdigest()


def check_arrival(saved: str | None, state: State | None) -> None:
    """Raise RestoreError unless the digest of `state` is the `saved` one; None, of older files, is
    not checked.
    """
    if saved is not None and saved != state_digest(state):
        raise RestoreError(
            "the episodes under way, played again, arrived elsewhere than where they were saved: this machine"
            " or this version computes otherwise. Start new episodes, or go on where the run was saved."
        )


class CopiedByReplay:
    """An environment that `pickle` and `copy.deepcopy` make anew; it repeats its actions to get where it is.

    `remake` makes one like it; None where it was made of a simulation of the user's own.
    """

    simulation: Any
    remake: Callable[[], Any] | None = None

    def __reduce__(self) -> Any:
        if self.remake is None:
            raise TypeError(
                f"this {type(self).__name__} cannot be copied or pickled: it was made of a simulation. Make "
                "another one, or use dune_rl.parallel_env, gym_env, gym_vector_env or make"
            )
        return _restored, (self.remake, self.simulation.save_point(), self._own_point())

    def _own_point(self) -> dict[str, Any]:
        """What the environment itself remembers, as plain data."""
        return {}

    def _return_to(self, own: dict[str, Any]) -> None:
        """Restore what `_own_point` returned."""


def _restored(remake: Callable[[], Any], point: dict[str, Any], own: dict[str, Any]) -> Any:
    env = remake()
    env.remake = remake
    env.simulation.return_to(point)
    env._return_to(own)
    return env


# What Gymnasium's `make`, `reset` and `sample` set: how the environment was made, and random states.
_GYMNASIUM = ("spec", "_np_random", "_np_random_seed", "action_space", "observation_space")
_OF_VECTORS = ("single_action_space", "single_observation_space")


def gymnasium_state(env: Any) -> dict[str, Any]:
    """What Gymnasium keeps in an environment, by the attributes' names."""
    return {name: vars(env)[name] for name in (*_GYMNASIUM, *_OF_VECTORS) if name in vars(env)}
