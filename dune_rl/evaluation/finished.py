"""A finished episode, as processes pass it on and folders keep it."""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class FinishedEpisode:
    """An episode of a policy (by number): rows by group, one for each agent with metrics, and its steps.

    `attempts` are those at goals, where the protocol records them.
    """

    policy: int
    episode: int
    rows: dict[str, list[dict[str, Any]]]
    steps: list[dict[str, Any]]
    attempts: list[dict[str, Any]] = field(default_factory=list)
