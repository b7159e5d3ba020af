"""Pickles and copies of environments: independent ones at the same point of the same episodes."""

from collections.abc import Callable
from typing import Any


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
