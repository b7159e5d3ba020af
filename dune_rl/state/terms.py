"""Registries of terms: rewards, terminations and metrics, which are functions of the state."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import FrozenInstanceError
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dune_rl.core.errors import RegistryError
from dune_rl.core.registry import Registry
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Flags

if TYPE_CHECKING:
    from dune_rl.state.state import GroupState, State

Term = Callable[["State", "GroupState"], NDArray[Any]]


class StatefulTerm(Protocol):
    """A term with memory for each of N agents; its constructor takes N as `num_rows`."""

    def reset(self, mask: Flags, group: "GroupState") -> None:
        """Clear the memory of the agents in `mask` (N,), whose episodes begin."""
        ...

    def __call__(self, state: "State", group: "GroupState") -> NDArray[Any]:
        """The value of each agent of `group`, (N,), after a control step."""
        ...


class TermConf(Settings):
    """Settings of a term: `term` is its registered name; its parameters are fields of a subclass."""

    term: str

    def __hash__(self) -> int:
        # Parameters of users' terms may be lists.
        return hash((type(self), self.model_dump_json()))


class TermRegistry(Registry[StatefulTerm]):
    """Terms of one kind: functions `f(state, group, *, SETTINGS) -> (N,)`, or classes for terms with memory.

    A class has `__init__(self, num_rows, *, SETTINGS)`, `reset(mask, group)` and `__call__(state, group)`.
    """

    def __init__(self, kind: str, location: str, *, own: Mapping[str, str], base: type[Settings]) -> None:
        super().__init__(
            kind,
            location,
            own=own,
            base=base,
            product=StatefulTerm,
            returned=np.ndarray,
            form="a function of (state, group) that returns an array, or a class made with (num_rows)",
            function_leading=("state", "group"),
            class_leading=("num_rows",),
            tag="term",
        )

    def bind(self, conf: Settings, num_rows: int) -> Term:
        """The term with its settings, for a group of `num_rows` agents in all scenes.

        A user's term raises `RegistryError` if it does not return one value for each agent.
        """
        part = self.part_of(conf)
        if part.signature.is_class:
            term: Term = self.build(conf, num_rows)
        else:
            term = partial(part.target, **part.signature.arguments(conf))
        return term if part.is_own else _CheckedTerm(term, part.origin, num_rows)

    def needs_joints(self, conf: Settings) -> bool:
        """Whether the term reads the joints' state: it has the attribute `needs_joints`."""
        return bool(getattr(self.part_of(conf).target, "needs_joints", False))

    def needs_scan(self, conf: Settings) -> bool:
        """Whether the term reads `GroupState.nearest_return`: it has the attribute `needs_scan`."""
        return bool(getattr(self.part_of(conf).target, "needs_scan", False))


class _CheckedTerm:
    """Wraps a user's term, and checks the shape (N,) of the arrays that it returns."""

    def __init__(self, term: Term, origin: str, num_rows: int) -> None:
        self._term, self._origin, self._shape = term, origin, (num_rows,)
        if hasattr(term, "reset"):
            self.reset = term.reset

    def __call__(self, state: "State", group: "GroupState") -> NDArray[Any]:
        values = self._term(state, group)
        if getattr(values, "shape", None) != self._shape:
            what = f"one of shape {values.shape}" if hasattr(values, "shape") else f"{values!r:.80}"
            raise RegistryError(
                f"{self._origin}, which must return an array of shape {self._shape}, one value for each "
                f"agent, but returned {what}."
            )
        return values


def bind_terms(
    registry: TermRegistry, confs: Sequence[TermConf], num_rows: int
) -> tuple[list[Term], list[StatefulTerm]]:
    """The terms of `confs` for `num_rows` agents, and those of them that need `reset`."""
    terms = [registry.bind(conf, num_rows) for conf in confs]
    stateful: list[Any] = [term for term in terms if hasattr(term, "reset")]
    return terms, stateful


def name_term(error: Exception, kind: str, name: str) -> None:
    """Add to an error in which term of which kind it was raised.

    Raises `RegistryError`, which names the term, if the error is that of writing into the state.
    """
    check_written_state(error, f"the {kind} term {name!r}")
    error.add_note(f"in the {kind} term {name!r}")


def check_written_state(error: Exception, part: str) -> None:
    """Raise `RegistryError` if `error` says that `part` wrote into the state or into one of its arrays."""
    if isinstance(error, FrozenInstanceError):
        raise RegistryError(f"{part} changes the state, which cannot be changed ({error}).") from error
    if isinstance(error, ValueError) and "read-only" in str(error):
        raise RegistryError(
            f"{part} writes into an array of the state, which cannot be changed: let it work on a copy "
            "(`values.copy()`)."
        ) from error
