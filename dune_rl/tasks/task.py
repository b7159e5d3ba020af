"""A task: where an agent starts and goes, what its steps earn, and when its episode ends."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from dune_rl.settings import Settings
from dune_rl.state import Array, Flags, GroupState, State
from dune_rl.tasks.registry import REWARDS, TERMINATIONS, RewardTerms, TerminationTerms
from dune_rl.tasks.spawn import SpawnConf
from dune_rl.terms import bind_terms

DIVERGED = "diverged"

_NAVIGATING: dict[str, Any] = {"unless": ["goal", "collision"]}
POINT_GOAL_REWARDS: dict[str, Any] = {
    "distance": {"weight": 1.5, **_NAVIGATING},
    "heading": {"weight": 1.5, **_NAVIGATING},
    "velocity": {**_NAVIGATING},
    "goal": {"term": "ended_by", "termination": "goal_reached", "weight": 100.0},
    "collision": {"weight": -0.5, "unless": ["goal"]},
    # Ours: with the paper's terms alone a bump costs less than the time it saves. `task=paper` leaves it out.
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

    spawn: SpawnConf = SpawnConf()
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
            if ending not in (DIVERGED, *self.terminations):
                raise ValueError(
                    f"rewards.{name}.termination names no termination: {ending!r} "
                    f"(has {', '.join((*self.terminations, DIVERGED))})"
                )
        for name, termination in self.terminations.items():
            if termination.truncates and termination.renew:
                raise ValueError(f"terminations.{name} cannot both truncate and renew the goal: choose one")
        return self

    def changed(
        self,
        rewards: Mapping[str, Mapping[str, Any]] | None = None,
        terminations: Mapping[str, Mapping[str, Any]] | None = None,
        **others: Any,
    ) -> "TaskConf":
        """The same settings but for those given: a few of some terms, further terms, `spawn`."""
        values = self.model_dump()
        for section, changes in (("rewards", rewards), ("terminations", terminations)):
            for name, change in (changes or {}).items():
                values[section][name] = {**values[section].get(name, {}), **change}
        return TaskConf.model_validate({**values, **others})


def walking_task() -> TaskConf:
    """The task of a walker: to go to its way points, clear of the agents of other groups."""
    return TaskConf.model_validate(
        {
            "rewards": {"progress": {}, "near_miss": {"weight": -0.1}},
            "terminations": {"goal_reached": {"distance_m": 0.5, "renew": True}},
        }
    )


@dataclass(frozen=True)
class Endings:
    """Whose episode ends in this step, and who gets a new goal instead, each (N,)."""

    terminated: Flags
    truncated: Flags
    renews: Flags


class Task:
    """The terms of a task for the N agents of a group: call `end`, then `reward`, once a control step.

    `reward_sums` (N, T) are the weighted sums of each reward term over the present episodes, and
    `reward_names` (T) their names, `reward/NAME`.
    """

    def __init__(self, conf: TaskConf, num_rows: int) -> None:
        self.conf = conf
        self._terminations, stateful = bind_terms(TERMINATIONS, list(conf.terminations.values()), num_rows)
        self._rewards, stateful_rewards = bind_terms(REWARDS, list(conf.rewards.values()), num_rows)
        self._stateful = [*stateful, *stateful_rewards]
        kinds = [(conf.truncates, conf.renew) for conf in conf.terminations.values()]
        self._terminating = np.array([kind == (False, False) for kind in kinds], bool)
        self._truncating = np.array([truncates for truncates, _ in kinds], bool)
        self._renewing = np.array([renew for _, renew in kinds], bool)
        names = list(conf.rewards)
        self._weights = np.array([reward.weight for reward in conf.rewards.values()])[:, None]
        # Row i marks the terms that come instead of term i.
        self._instead = np.array(
            [[other in reward.unless for other in names] for reward in conf.rewards.values()], bool
        ).reshape(len(names), len(names))
        self.reward_names = tuple(f"reward/{name}" for name in names)
        self._sums = np.zeros((len(names), num_rows))

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
        """Which agents' episodes end in this step; it fills `group.endings`.

        Diverged physics truncates whatever else seems to be the case, and what terminates does not
        truncate also.
        """
        diverged = group.motion.diverged
        flags = np.empty((len(self._terminations), len(diverged)), bool)
        for row, term in zip(flags, self._terminations, strict=True):
            row[:] = term(state, group)
        flags &= ~diverged
        terminated = flags[self._terminating].any(axis=0)
        flags[self._truncating] &= ~terminated
        truncated = flags[self._truncating].any(axis=0) | diverged
        renews = flags[self._renewing].any(axis=0) & ~(terminated | truncated | group.done)
        group.endings.update(zip(self.conf.terminations, flags, strict=True))
        group.endings[DIVERGED] = diverged
        return Endings(terminated, truncated, renews)

    def reward(self, state: State, group: GroupState) -> Array:
        """Reward (N,) of this step, 0 for agents that are done."""
        values = np.empty(self._sums.shape)
        for row, term in zip(values, self._rewards, strict=True):
            row[:] = term(state, group)
        values[self._instead @ (values != 0.0)] = 0.0
        values *= self._weights
        values[:, group.done] = 0.0
        self._sums += values
        # One after another, so that the bytes do not depend on how many there are.
        reward: Array = np.add.accumulate(values, axis=0)[-1] if len(values) else np.zeros(len(group.done))
        return reward

    @property
    def reward_sums(self) -> Array:
        return self._sums.T
