"""Blocks of episodes, which processes run one by one, and episodes that are finished."""

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class EpisodeBlock:
    """Consecutive episodes `first` to `first + count - 1` of a policy, by its number."""

    policy: int
    first: int
    count: int


def missing_blocks(
    policies: int, episodes: int, done: Collection[tuple[int, int]], scenes: int, processes: int
) -> list[EpisodeBlock]:
    """Blocks of all episodes that are not `done` (pairs of policy and episode).

    Blocks start at multiples of `scenes`, so that an episode runs in the same row of a batch of the same size
    whatever the blocks: matrix products of another shape differ in their last bits.
    """
    # Long blocks waste less at their ends; several for each process even out what they take.
    longest = episodes
    if processes > 1:
        longest = max(1, -(-episodes * policies // (3 * processes * scenes))) * scenes
    found: list[EpisodeBlock] = []
    for policy in range(policies):
        for first in range(0, episodes, scenes):
            numbers = range(first, min(first + scenes, episodes))
            if all((policy, number) in done for number in numbers):
                continue
            last = found[-1] if found else EpisodeBlock(-1, 0, 0)
            count = last.count + len(numbers)
            if last.policy == policy and last.first + last.count == first and count <= longest:
                found[-1] = EpisodeBlock(policy, last.first, count)
            else:
                found.append(EpisodeBlock(policy, first, len(numbers)))
    return found


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
