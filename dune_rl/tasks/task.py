"""A task: spawn settings, reward terms and termination terms of an agent group."""

import math
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.core.errors import RegistryError
from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array, Flags, freeze
from dune_rl.state.state import GroupState, State
from dune_rl.state.terms import bind_terms, name_term
from dune_rl.tasks.registry import REWARDS, TERMINATIONS, RewardTerms, Spawn, TerminationTerms
from dune_rl.tasks.spawn import SpawnConf

DIVERGED = "diverged"

_NAVIGATING: dict[str, Any] = {"unless": ["goal", "collision"]}
POINT_GOAL_REWARDS: dict[str, Any] = {
    "distance": {"weight": 1.5, **_NAVIGATING},
    "heading": {"weight": 1.5, **_NAVIGATING},
    "velocity": {**_NAVIGATING},
    "goal": {"term": "ended_by", "termination": "goal_reached", "weight": 100.0},
    "collision": {"weight": -0.5, "unless": ["goal"]},
    # Not in the paper, whose terms make a collision cheaper than the time that it saves; see `task=paper`.
    "contact": {"weight": -10.0},
    "stuck": {"term": "ended_by", "termination": "stuck", "weight": 0.0},
    "flipped": {"term": "ended_by", "termination": "flipped", "weight": 0.0},
    "out_of_world": {"term": "ended_by", "termination": "out_of_world", "weight": 0.0},
}
POINT_GOAL_TERMINATIONS: dict[str, Any] = {
    "goal_reached": {},
    "stuck": {},
    "flipped": {},
    "out_of_world": {},
    "time_limit": {"truncates": True},
}


class TaskConf(Settings):
    """Settings of a `Task`; the defaults are those of point-goal navigation.

    The order of the rewards is that of the sum and of the columns `reward/NAME`.
    """

    spawn: Spawn = SpawnConf()
    rewards: RewardTerms = Field(POINT_GOAL_REWARDS)
    terminations: TerminationTerms = Field(POINT_GOAL_TERMINATIONS)

    @model_validator(mode="after")
    def _names_are_known(self) -> Self:
        if DIVERGED in self.terminations:
            raise ValueError(
                f"terminations.{DIVERGED} is built in: physics that diverges always truncates; "
                "choose another name"
            )
        for name, reward in self.rewards.items():
            for other in reward.unless:
                if other not in self.rewards or other == name:
                    others = ", ".join(known for known in self.rewards if known != name) or "none"
                    raise ValueError(f"rewards.{name}.unless names no other reward: {other!r} (has {others})")
            ending = getattr(reward, "termination", DIVERGED)
            if reward.weight and ending not in (DIVERGED, *self.terminations):
                raise ValueError(
                    f"rewards.{name}.termination names no termination: {ending!r} "
                    f"(has {', '.join((*self.terminations, DIVERGED))})"
                )
        for name, termination in self.terminations.items():
            if termination.truncates and termination.renew:
                raise ValueError(f"terminations.{name} cannot both truncate and renew the goal: choose one")
        return self

    @property
    def goal_reached_m(self) -> float | None:
        """Distance at which a goal counts as reached [m]; None where none does."""
        return getattr(self.terminations.get("goal_reached"), "distance_m", None)


def walking_task() -> TaskConf:
    """The task of persons: reach the ends of the path, away from agents of other groups."""
    return TaskConf.model_validate(
        {
            "rewards": {"progress": {}, "near_miss": {"weight": -0.1}},
            "terminations": {"goal_reached": {"distance_m": 0.5, "renew": True}},
        }
    )


class Endings(NamedTuple):
    """Flags (N,) of agents whose episode ends in this step, and of those that get a new goal instead.

    `by_term` has the flags (N,) of each termination term by name, as `GroupState.endings`.
    """

    by_term: dict[str, Flags]
    terminated: Flags
    truncated: Flags
    renews: Flags


class Task:
    """The terms of a task for the N agents of a group: call `end`, then `reward`, once a control step.

    Rewards read the flags of `end` from the state (`GroupState.endings`).

    `needs_scan` tells whether a term reads `GroupState.nearest_return`, `needs_joints` whether one reads
    `motion.joints`. `reward_sums` (N, T) are the weighted sums of each reward term over the present episodes,
    and `reward_names` (T) their names, `reward/NAME`.
    """

    def __init__(self, conf: TaskConf, num_rows: int) -> None:
        self.conf = conf
        endings, rewards = list(conf.terminations.values()), list(conf.rewards.values())
        self.needs_scan = any(map(TERMINATIONS.needs_scan, endings)) or any(map(REWARDS.needs_scan, rewards))
        self.needs_joints = any(
            [*map(TERMINATIONS.needs_joints, endings), *map(REWARDS.needs_joints, rewards)]
        )
        self._terminations, stateful_endings = bind_terms(TERMINATIONS, endings, num_rows)
        self._rewards, stateful_rewards = bind_terms(REWARDS, rewards, num_rows)
        self._stateful = [*stateful_endings, *stateful_rewards]
        self._endings = (DIVERGED, *conf.terminations)
        self._truncating = np.array([False, *(term.truncates for term in endings)])
        self._renewing = np.array([False, *(term.renew for term in endings)])
        self._terminating = ~self._truncating & ~self._renewing
        self._terminating[0] = False
        names = list(conf.rewards)
        self._weights = np.array([reward.weight for reward in rewards])[:, None]
        # Terms that other terms name in `unless`, and in each row which of them suppress that term.
        suppressing = [name for name in names if any(name in term.unless for term in rewards)]
        self._suppressing = np.array([names.index(name) for name in suppressing], np.int64)
        self._suppressed_by = np.array(
            [[name in term.unless for name in suppressing] for term in rewards], bool
        )
        self.reward_names = tuple(f"reward/{name}" for name in names)
        self._sums = np.zeros((len(names), num_rows))
        self._values = np.zeros((len(names), num_rows))
        self._rows = list(self._values)

    @property
    def has_ends(self) -> bool:
        """Whether some termination ends an agent's episode."""
        return bool((self._terminating | self._truncating).any())

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Begin the episodes of the agents in `mask` (N,)."""
        self._sums[:, mask] = 0.0
        for term in self._stateful:
            term.reset(mask, group)

    def end(self, state: State, group: GroupState) -> Endings:
        """Which agents' episodes end in this step.

        Diverged physics always truncates and overrides all other terms; a terminated episode is not
        truncated as well.
        """
        num_rows = len(group.done)
        flags = np.empty((len(self._endings), num_rows), bool)
        flags[0] = group.motion.diverged
        try:
            for row, term in enumerate(self._terminations, 1):
                flags[row] = term(state, group)
        except Exception as error:
            name_term(error, "termination", self._endings[row])
            raise
        if not np.count_nonzero(flags):
            nobody = flags[0]
            return Endings(self._by_term(flags), nobody, nobody, nobody)
        flags[1:] &= ~flags[0]
        terminated = flags[self._terminating].any(axis=0)
        flags[self._truncating] &= ~terminated
        truncated = flags[self._truncating].any(axis=0) | flags[0]
        renews = flags[self._renewing].any(axis=0) & ~(terminated | truncated | group.done)
        return Endings(self._by_term(flags), terminated, truncated, renews)

    def _by_term(self, flags: Flags) -> dict[str, Flags]:
        return dict(zip(self._endings, freeze(flags), strict=True))

    def reward(self, state: State, group: GroupState) -> Array:
        """Reward (N,) of this step, 0 for agents that are done; RegistryError where it is not finite."""
        if not self._rows:
            return np.zeros(len(group.done))
        values = self._values
        try:
            for row, term in zip(self._rows, self._rewards, strict=True):
                row[:] = term(state, group)
        except Exception as error:
            named = zip(self.conf.rewards, self._rewards, strict=True)
            name_term(error, "reward", next(name for name, each in named if each is term))
            raise
        suppressing = values.take(self._suppressing, axis=0)
        if np.count_nonzero(suppressing):
            np.copyto(values, 0.0, where=self._suppressed_by @ (suppressing != 0.0))
        values *= self._weights
        if np.count_nonzero(group.done):
            values[:, group.done] = 0.0
        self._sums += values
        # One after another: the bytes of a sum by pairs would depend on how many terms and agents there are.
        reward: Array = np.add.accumulate(values, axis=0)[-1]
        if not math.isfinite(reward.sum()):
            self._name_fault(group.name)
        return reward

    def _name_fault(self, group: str) -> None:
        """Raise RegistryError, which names the first reward term that is not a finite number."""
        for name, values in zip(self.conf.rewards, self._values, strict=True):
            faulty = values[~np.isfinite(values)]
            if len(faulty):
                raise RegistryError(
                    f"the reward term {name!r} of the group {group!r} is {faulty[0]}: let it return finite "
                    "numbers in every step, such as by np.nan_to_num, or leave the term out."
                )

    @property
    def reward_sums(self) -> Array:
        """Weighted sums (N, T) of the reward terms over the present episodes."""
        return self._sums.T
