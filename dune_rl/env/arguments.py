"""Checks of what users give to environments: errors that name the argument and what it must be."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Floats


def check_whole(name: str, value: object, *, at_least: int) -> None:
    """Raise ConfigError unless `value` is a whole number of at least so much."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < at_least:
        raise ConfigError(f"{name} must be a whole number of at least {at_least} (got {value!r})")


def combined_seed(seeds: Sequence[int | None]) -> int:
    """One seed that depends on all of `seeds`; a random one where one of them is None."""
    if any(seed is None for seed in seeds):
        return random_seed()
    for seed in seeds:
        check_whole("seed", seed, at_least=0)
    entropy = [int(seed) for seed in seeds if seed is not None]
    return int(np.random.SeedSequence(entropy).generate_state(1)[0])


def random_seed() -> int:
    """A seed that differs from call to call."""
    return int(np.random.SeedSequence().generate_state(1)[0])


def action_numbers(values: Any) -> Floats:
    """`values` in the precision of actions, float32; empty if they are not numbers.

    Restored episodes repeat actions in this precision.
    """
    try:
        return np.asarray(values, np.float32)
    except (TypeError, ValueError):
        return np.zeros(0, np.float32)


def agent_action(actions: Mapping[str, Any], agent: str, size: int) -> Floats:
    """The action of an agent, (size,); raises ValueError where it is none."""
    if not isinstance(actions, Mapping):
        raise ValueError(f"step needs a mapping from agents to actions (got {type(actions).__name__})")
    if agent not in actions:
        given = f"there are {', '.join(map(str, actions))}" if actions else "the mapping is empty"
        raise ValueError(f"step needs an action for every agent, and {agent} has none; {given}")
    action = action_numbers(actions[agent])
    if action.size != size or not np.isfinite(action).all():
        numbers = "1 finite number" if size == 1 else f"{size} finite numbers"
        raise ValueError(f"the action of {agent} must be {numbers} (got {actions[agent]!r})")
    return action.reshape(size)


def group_actions(group: str, values: Any, shape: tuple[int, int, int]) -> Array:
    """The actions of a group as rows (M G, A); raises ValueError unless they are (M, G, A) numbers."""
    rows = np.asarray(values, np.float64)
    if rows.size != shape[0] * shape[1] * shape[2] or rows.shape[-1] != shape[2]:
        raise ValueError(
            f"actions of the group {group!r} must have the shape {shape} of scenes, agents and numbers"
            f" (got {rows.shape})"
        )
    if not np.isfinite(rows).all():
        raise ValueError(f"actions of the group {group!r} must be finite numbers, and some are not")
    return rows.reshape(-1, shape[2])
