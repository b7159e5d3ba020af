"""Blocks of episodes, which processes run one by one: results do not depend on how they are shared out."""

from collections.abc import Collection
from dataclasses import dataclass


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
    longest = (
        episodes if processes == 1 else max(1, -(-episodes * policies // (3 * processes * scenes))) * scenes
    )
    found: list[EpisodeBlock] = []
    for policy in range(policies):
        for first in range(0, episodes, scenes):
            numbers = range(first, min(first + scenes, episodes))
            if all((policy, number) in done for number in numbers):
                continue
            last = found[-1] if found else None
            follows = last is not None and last.policy == policy and last.first + last.count == first
            if last is not None and follows and last.count + len(numbers) <= longest:
                found[-1] = EpisodeBlock(policy, last.first, last.count + len(numbers))
            else:
                found.append(EpisodeBlock(policy, first, len(numbers)))
    return found
