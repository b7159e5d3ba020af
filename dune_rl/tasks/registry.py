"""The reward and termination terms there are: ours, those of packages, and those that a program registers."""

from typing import Annotated

from pydantic import BeforeValidator, Field, SerializeAsAny

from dune_rl.terms import TermConf, TermRegistry

_OWN_REWARDS = (
    "collision",
    "contact",
    "distance",
    "ended_by",
    "heading",
    "near_miss",
    "progress",
    "velocity",
)
_OWN_TERMINATIONS = {
    "flipped": "flipped",
    "goal_reached": "goal_reached",
    "out_of_world": "out_of_world",
    "stuck": "Stuck",
    "time_limit": "time_limit",
}


class RewardTermConf(TermConf):
    """A reward term: its value times `weight`, in steps in which no reward named in `unless` has a value."""

    weight: float = 1.0
    unless: tuple[str, ...] = Field((), description="rewards that come instead of this one where they pay")


class TerminationTermConf(TermConf):
    """A termination term: it terminates; with `truncates` it truncates, with `renew` it draws a new goal."""

    truncates: bool = False
    renew: bool = Field(False, description="whether to draw a new goal and go on instead of ending")


REWARDS = TermRegistry(
    "reward",
    f"{__name__}:REWARDS",
    own={name: f"dune_rl.tasks.rewards:{name}" for name in _OWN_REWARDS},
    base=RewardTermConf,
)
TERMINATIONS = TermRegistry(
    "termination",
    f"{__name__}:TERMINATIONS",
    own={name: f"dune_rl.tasks.terminations:{target}" for name, target in _OWN_TERMINATIONS.items()},
    base=TerminationTermConf,
)

RewardTerms = Annotated[
    dict[str, Annotated[SerializeAsAny[RewardTermConf], BeforeValidator(REWARDS.parse_settings)]],
    BeforeValidator(REWARDS.tag_entries),
]
TerminationTerms = Annotated[
    dict[str, Annotated[SerializeAsAny[TerminationTermConf], BeforeValidator(TERMINATIONS.parse_settings)]],
    BeforeValidator(TERMINATIONS.tag_entries),
]
