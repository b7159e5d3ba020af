"""The registries of reward and termination terms, and of sources of starts and goals."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Protocol

import numpy as np
from pydantic import BeforeValidator, SerializeAsAny

from dune_rl.core.registry import Registry
from dune_rl.geometry.arrays import Array
from dune_rl.state.terms import TermConf, TermRegistry
from dune_rl.tasks.spawn import Placement, SpawnConf, Spawner

_ROBOT_REWARDS = {
    **{name: name for name in ("blocking", "closing_in", "robot_progress")},
    **{"hit_by_robot": "HitByRobot", "ran_into_robot": "RanIntoRobot"},
}
_REWARDS = [
    *("collision", "contact", "distance", "ended_by", "heading", "near_miss", "progress"),
    *("scan_collision", "smoothness", "velocity"),
]
_TERMINATIONS = {
    **{name: name for name in ("contact", "flipped", "goal_reached", "out_of_world", "time_limit")},
    **{"long_collision": "LongCollision", "stuck": "Stuck"},
}


class RewardTermConf(TermConf):
    """A reward term: `weight` multiplies its value.

    It earns 0 in a step in which one of the reward terms named in `unless` is not 0, before its weight.
    """

    weight: float = 1.0
    unless: tuple[str, ...] = ()


class TerminationTermConf(TermConf):
    """A termination term, which ends an agent's episode; with `truncates` it is a truncation.

    `renew` gives the agent another goal instead of ending its episode.
    """

    truncates: bool = False
    renew: bool = False


# Reward terms whose `groups` are groups of robots.
ROBOT_REWARDS = tuple(_ROBOT_REWARDS)
REWARDS = TermRegistry(
    "reward",
    "dune_rl.tasks.registry:REWARDS",
    own={name: f"dune_rl.tasks.rewards:{name}" for name in _REWARDS}
    | {name: f"dune_rl.tasks.actor_rewards:{target}" for name, target in _ROBOT_REWARDS.items()},
    base=RewardTermConf,
)
TERMINATIONS = TermRegistry(
    "termination",
    "dune_rl.tasks.registry:TERMINATIONS",
    own={name: f"dune_rl.tasks.terminations:{target}" for name, target in _TERMINATIONS.items()},
    base=TerminationTermConf,
)


class StartSampler(Protocol):
    """Draws the starts and goals of agents from `draws`, in the free space that `spawner` knows.

    Sources are derived from `RegionStarts`, whose methods these are.
    """

    def draw_start(
        self,
        spawner: Spawner,
        draws: np.random.Generator,
        taken: Sequence[Placement],
        apart_m: Sequence[float],
    ) -> Placement:
        """A start and a goal, at `apart_m` [m] from those `taken`; raises `WorldError` without room."""
        ...

    def draw_goal(
        self, spawner: Spawner, draws: np.random.Generator, start: Array, taken: Array, apart_m: Array
    ) -> tuple[float, float]:
        """A new goal (x, y) [m] for an agent at `start` (2,), `apart_m` (K,) from points `taken` (K, 2)."""
        ...


START_SOURCES: Registry[Any] = Registry(
    "start source",
    "dune_rl.tasks.registry:START_SOURCES",
    own={"region": "dune_rl.env.starts.region:RegionStarts"},
    base=SpawnConf,
    product=StartSampler,
    form="a class derived from dune_rl.env.starts.region.RegionStarts, made with (context)",
    function_leading=None,
    class_leading=("context",),
    tag="source",
)


def _parse_spawn(value: Any) -> Any:
    """Settings of starts and goals from a mapping; without `source`, agents start and go in a region."""
    return START_SOURCES.parse_settings(
        {"source": "region", **value} if isinstance(value, Mapping) else value
    )


Spawn = Annotated[SerializeAsAny[SpawnConf], BeforeValidator(_parse_spawn)]

# Terms by name; an entry without `term` is the term that is registered by its name.
RewardTerms = Annotated[
    dict[str, Annotated[SerializeAsAny[RewardTermConf], BeforeValidator(REWARDS.parse_settings)]],
    BeforeValidator(REWARDS.tag_entries),
]
TerminationTerms = Annotated[
    dict[str, Annotated[SerializeAsAny[TerminationTermConf], BeforeValidator(TERMINATIONS.parse_settings)]],
    BeforeValidator(TERMINATIONS.tag_entries),
]
