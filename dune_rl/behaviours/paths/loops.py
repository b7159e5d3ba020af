"""Loops over agents on paths, compiled: S scenes of G agents each.

`paths` are the poses (P, 4: x, y, z, yaw) of closed loops, end to end, where each begins, (B,), and how many
poses it has, (B,); `spacing_m` is the distance between poses. See `PathBank`.
"""

from typing import Any

import numpy as np

from dune_rl.geometry.compiled import compile_function


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
