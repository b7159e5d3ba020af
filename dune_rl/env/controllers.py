"""What drives the agents that no user drives: a behaviour, or a frozen policy."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from dune_rl.behaviours.registry import Behaviour
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.sensors.sensor import Reading
from dune_rl.state.state import GroupState, State
from dune_rl.state.terms import check_written_state

Observe = Callable[[], dict[str, Reading]]
Policy = Callable[[dict[str, Reading], Flags], Array]


class Controller(Protocol):
    """Decides the actions of the N agents of a group."""

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Forget the past of the agents in `mask` (N,), whose episodes begin."""
        ...

    def act(self, state: State, group: GroupState, observe: Observe) -> Array:
        """Actions (N, A) for the next control step; `observe` gives the group's observation, each part
        (N, ...).
        """
        ...


class BehaviourController:
    """A behaviour as a controller: it reads the state, not sensors."""

    def __init__(self, behaviour: Behaviour) -> None:
        self._behaviour = behaviour

    def reset(self, mask: Flags, group: GroupState) -> None:
        self._behaviour.reset(mask, group)

    def forecast(self, step_s: float, steps: int) -> Array | None:
        """Where the agents will be, (N, steps, 2) [m], every `step_s` [s]; None unless ways are fixed."""
        forecast = getattr(self._behaviour, "forecast", None)
        return None if forecast is None else forecast(step_s, steps)

    def act(self, state: State, group: GroupState, observe: Observe) -> Array:
        try:
            actions = self._behaviour.act(state, group)
        except ValueError as error:
            check_written_state(error, f"the behaviour {type(self._behaviour).__name__}")
            raise
        return np.asarray(actions, np.float64)


class PolicyController:
    """A frozen policy as a controller: it maps the group's observation to actions (N, A).

    It is also given the agents (N,) whose episodes begin, of which it must not remember anything.
    """

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self._begins = np.zeros(0, bool)

    def reset(self, mask: Flags, group: GroupState) -> None:
        self._begins = mask | self._begins if len(self._begins) else mask.copy()

    def act(self, state: State, group: GroupState, observe: Observe) -> Array:
        begins, self._begins = self._begins, np.zeros_like(self._begins)
        return np.asarray(self._policy(observe(), begins), np.float64)
