"""Loops over agents on paths and their stops, compiled: S scenes of G agents each.

`paths` are the poses (P, 4: x, y, z, yaw) of closed loops, end to end, where each begins, (B,), and how many
poses it has, (B,); `spacing_m` is the distance between poses. See `PathBank`.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from dune_rl.geometry.arrays import Array, Counts
from dune_rl.geometry.compiled import compile_function

# Ways are equal within this [m].
_SAME_M = 1e-9


@compile_function
def interpolate_path(paths: Any, loop: int, travelled_m: float, spacing_m: float, found: Any) -> None:
    """Pose `found` (4,) on a loop after `travelled_m`, between two of its poses."""
    poses, starts, lengths = paths
    place = travelled_m / spacing_m
    whole = np.floor(place)
    part, index = place - whole, np.int64(whole)
    here = poses[starts[loop] + index % lengths[loop]]
    there = poses[starts[loop] + (index + 1) % lengths[loop]]
    for axis in range(3):
        found[axis] = here[axis] + part * (there[axis] - here[axis])
    found[3] = here[3]


@compile_function
def interpolate_paths(paths: Any, loops: Any, travelled_m: Any, spacing_m: float, found: Any) -> None:
    """Poses `found` (N, 4) on `loops` (N,) after `travelled_m` (N,)."""
    for row in range(len(loops)):
        interpolate_path(paths, loops[row], travelled_m[row], spacing_m, found[row])


@compile_function
def advance_on_paths(
    paths: Any, scenes: Any, loops: Any, distances_m: Any, spacing_m: float, agents: Any
) -> None:
    """Move the agents of `scenes` (S,) by `distances_m` (M, G), back to their `loops` (M, G) first, then
    along them.

    `agents` are of all M scenes and are changed: ways travelled (M, G) and last steps (M, G) on the loops,
    offsets from them (M, G, 2) [m], and the poses on them, (M, G, 4).
    """
    travelled, steps, offsets, targets = agents
    for scene in scenes:
        for agent in range(loops.shape[1]):
            offset, distance_m = offsets[scene, agent], distances_m[scene, agent]
            length = np.hypot(offset[0], offset[1])
            back = min(length, distance_m)
            if length > 0.0:
                offset *= 1.0 - back / length
            steps[scene, agent] = distance_m - back
            travelled[scene, agent] += distance_m - back
            interpolate_path(
                paths, loops[scene, agent], travelled[scene, agent], spacing_m, targets[scene, agent]
            )


@compile_function
def hold_back_on_paths(
    paths: Any, scenes: Any, loops: Any, reached_xy: Any, spacing_m: float, agents: Any
) -> None:
    """Put the agents of `scenes` (S,) at `reached_xy` (S, G, 2) [m]; see `advance_on_paths`.

    What lacks of an agent's step is still to be travelled, and what is aside of its loop is an offset.
    """
    travelled, steps, offsets, targets = agents
    place = np.empty(4)
    for row in range(len(scenes)):
        scene = scenes[row]
        for agent in range(loops.shape[1]):
            target, xy = targets[scene, agent], reached_xy[row, agent]
            ahead = (target[0] - xy[0]) * np.cos(target[3]) + (target[1] - xy[1]) * np.sin(target[3])
            travelled[scene, agent] -= min(max(ahead, 0.0), steps[scene, agent])
            interpolate_path(paths, loops[scene, agent], travelled[scene, agent], spacing_m, place)
            for axis in range(2):
                offsets[scene, agent, axis] = xy[axis] - place[axis]


class LoopStops(NamedTuple):
    """The stops of B loops, end to end: `at` (S,) [m] of way, rising in each loop, from 0 to its length.

    Loop b has `counts[b]` of them from `starts[b]`, and is `lengths[b]` [m] long; nobody goes beyond
    `ends[b]`.
    """

    at: Array
    starts: Counts
    counts: Counts
    lengths: Array
    ends: Array

    @classmethod
    def of(cls, stops: Sequence[Array], lengths: Sequence[float], ends: Sequence[float]) -> "LoopStops":
        """Those of loops with `stops`, each (S,)."""
        counts = np.array([len(each) for each in stops])
        at = np.concatenate([*stops, np.zeros(0)])
        return cls(at, np.cumsum(counts) - counts, counts, np.array(lengths, float), np.array(ends, float))


@compile_function
def next_stop(stops: Any, loop: int, travelled_m: float) -> float:
    """The way at the first stop after `travelled_m`; inf without stops."""
    at, starts, counts, lengths, _ = stops
    first, count, length = starts[loop], counts[loop], lengths[loop]
    if count == 0:
        return np.inf
    before = np.floor((travelled_m + _SAME_M) / length) * length
    for number in range(count):
        if before + at[first + number] > travelled_m + _SAME_M:
            return before + at[first + number]
    return before + length + at[first]


@compile_function
def limit_steps(
    stops: Any, scenes: Any, loops: Any, travelled: Any, pause_m: float, agents: Any, distances: Any
) -> None:
    """Shorten the steps `distances` (M, G) [m] of the agents of `scenes` (S,), which pause at their stops.

    `agents` are the next stops and what is left of pauses, (M, G) each, which change; pauses are given as the
    way [m] that agents would walk in that time.
    """
    next_m, pause_left = agents
    for scene in scenes:
        for agent in range(loops.shape[1]):
            loop, way = loops[scene, agent], travelled[scene, agent]
            if way >= next_m[scene, agent] - _SAME_M:
                pause_left[scene, agent] = pause_m
                next_m[scene, agent] = next_stop(stops, loop, way)
            rest = min(pause_left[scene, agent], distances[scene, agent])
            pause_left[scene, agent] -= rest
            most = min(next_m[scene, agent], stops[4][loop]) - way
            distances[scene, agent] = min(distances[scene, agent] - rest, max(most, 0.0))
