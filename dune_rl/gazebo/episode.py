"""An episode of one scene in which robots stand, recorded as the trajectories of its actors."""

from dataclasses import dataclass

import numpy as np

from dune_rl.env.agent_group import AgentGroup
from dune_rl.env.simulation import VectorSimulation
from dune_rl.geometry.arrays import Array
from dune_rl.rendering.scenery import ColouredMesh

# Time between two recorded poses [s].
_EVERY_S = 0.2


@dataclass(frozen=True, eq=False)
class RecordedActor:
    """An actor called `name` that looks like `shape`, at `poses` (T, 6) at `times` (T,) [s].

    Poses are x, y, z [m], roll, pitch and yaw [rad] of the shape's origin.
    """

    name: str
    shape: ColouredMesh
    times: Array
    poses: Array


def record_actors(simulation: VectorSimulation, duration_s: float) -> list[RecordedActor]:
    """The actors of the first scene, which has just been reset, over `duration_s` of standing robots.

    Actors that come and go are left out.
    """
    groups = [group for group in simulation.groups if is_recorded(group)]
    step_s = simulation.physics.control_step_s
    every = max(1, round(_EVERY_S / step_s))
    shapes = [
        picture.shape
        for group in groups
        for agent in range(group.count)
        for picture in group.body.pictures(agent)
    ]
    rest = {
        group.name: np.broadcast_to(
            group.body.rest_action(), (simulation.num_scenes, group.count, group.action_size)
        )
        for group in simulation.external
    }
    steps = every * int(np.ceil(duration_s / step_s / every)) if groups else 0
    times, poses = [0.0], [_poses(groups)]
    for step in range(1, steps + 1):
        simulation.step(rest)
        if step % every == 0:
            times.append(step * step_s)
            poses.append(_poses(groups))
    names = [name for group in groups for name in group.names]
    found = np.stack(poses, axis=1)
    return [
        RecordedActor(name, shape, np.array(times), own)
        for name, shape, own in zip(names, shapes, found, strict=True)
    ]


def is_recorded(group: AgentGroup) -> bool:
    """Whether the agents of a group are actors that are there all the time."""
    return not group.description.is_robot and group.presence is None


def _poses(groups: list[AgentGroup]) -> Array:
    """Poses (A, 6) of the groups' agents in the first scene."""
    found = [np.zeros((0, 6))]
    for group in groups:
        motion = group.body.motion
        both = np.concatenate([motion.position_w, motion.roll_pitch_yaw], axis=1)
        found.append(both[: group.count])
    return np.concatenate(found)
