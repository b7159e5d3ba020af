"""Terms: rewards, terminations and metrics as functions of the state that are named in the settings.

A term is a function `f(state, group, *, parameters...)` that returns (N,), or a class of such functions with
`__init__(self, num_rows, *, parameters...)`, `reset(mask, group)` and `__call__(state, group)`, where
something must be remembered over the steps of an episode. Its keyword parameters are its settings.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dune_rl.registry import Registry
from dune_rl.settings import Settings
from dune_rl.state import Flags, GroupState, State

TermValues = NDArray[Any]
Term = Callable[[State, GroupState], TermValues]


class TermProduct(Protocol):
    """What a term returns: an array (N,) of numbers or flags."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]


class StatefulTerm(Protocol):
    """A term that remembers something; it is called once a control step."""

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Begin the episodes of the agents in `mask` (N,)."""
        ...

    def __call__(self, state: State, group: GroupState) -> TermValues:
        """The values (N,) of this step."""
        ...


class TermConf(Settings):
    """Settings of a term: `term` is the name it is registered by; its parameters are fields of a subclass."""

    term: str

    def __hash__(self) -> int:
        # Parameters of users' terms may be lists.
        return hash((type(self), self.model_dump_json()))


def bind_terms(
    registry: Registry[Any], confs: Sequence[TermConf], num_rows: int
) -> tuple[list[Term], list[StatefulTerm]]:
    """The terms of `confs` for `num_rows` agents, and those of them that need `reset`."""
    terms: list[Term] = []
    stateful: list[StatefulTerm] = []
    for conf in confs:
        part = registry.part_of(conf)
        arguments = part.signature.arguments(conf)
        if part.signature.is_class:
            instance = part.target(num_rows, **arguments)
            terms.append(instance)
            stateful.append(instance)
        else:
            terms.append(partial(part.target, **arguments) if arguments else part.target)
    return terms, stateful
