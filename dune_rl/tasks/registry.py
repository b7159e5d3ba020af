"""The registries of reward and termination terms, and the settings that every term has."""

from dune_rl.settings import Settings
from dune_rl.terms import TermRegistry


class RewardTermConf(Settings):
    """A reward term: `weight` multiplies its value.

    It earns 0 in a step in which one of the reward terms named in `unless` is not 0, before its weight.
    """

    term: str
    weight: float = 1.0
    unless: tuple[str, ...] = ()


class TerminationTermConf(Settings):
    """A termination term, which ends an agent's episode; with `truncates` as time does.

    `renew` gives the agent another goal instead of ending its episode.
    """

    term: str
    truncates: bool = False
    renew: bool = False


REWARDS = TermRegistry("reward", "dune_rl.tasks.registry:REWARDS", own={}, base=RewardTermConf)
TERMINATIONS = TermRegistry(
    "termination", "dune_rl.tasks.registry:TERMINATIONS", own={}, base=TerminationTermConf
)
