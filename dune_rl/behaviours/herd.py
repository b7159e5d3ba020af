"""The behaviour `herd`: animals that stay together, walk from pasture to pasture, and flee from robots."""

from typing import Annotated

import numpy as np
from pydantic import Field

from dune_rl.behaviours.destinations import DestinedBehaviour
from dune_rl.behaviours.steering import PauseRange, Places, Range, Speed, nearest_of
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.geometry.frames import unit_vectors
from dune_rl.state.state import GroupState, State

Weight = Annotated[float, Field(ge=0.0, le=100.0, description="weight of this part")]

# Largest change of velocity [m/s²], and the slowest walk [m/s]: an animal that wants less stands.
_ACCELERATION_MPS2 = 2.0
_SLOWEST_MPS = 0.15


class Herd(DestinedBehaviour):
    """Boids: cohesion, alignment and separation, with an urge to migrate and flight from robots.

    After Reynolds, "Flocks, herds and schools" (1987). The wanted velocity is the weighted sum of: the way to
    the middle of the herd members in sight, over 2 s, as far as it is beyond `spacing_m`; their mean
    velocity; the sum of (spacing_m / d - 1) away from each member that is nearer than `spacing_m`; and the
    speed of walking to the pasture, which is that of the first member that is there. Robots nearer than
    `flight_m` are run away from.
    """

    stream_name = "herd"

    def __init__(
        self,
        num_rows: int,
        *,
        speed_mps: Speed = 0.6,
        run_mps: Speed = 1.5,
        cohesion: Weight = 1.0,
        alignment: Weight = 0.3,
        separation: Weight = 1.0,
        migration: Weight = 0.7,
        sight_m: Annotated[float, Field(gt=0.0, le=1_000.0, description="how far members see [m]")] = 20.0,
        spacing_m: Annotated[float, Field(gt=0.0, le=100.0, description="between two centres [m]")] = 1.2,
        flight_m: Annotated[float, Field(ge=0.0, le=100.0, description="nearer robots scare [m]")] = 2.5,
        places: Places = (),
        range_m: Range = 10.0,
        pause_s: PauseRange = (4.0, 12.0),
    ) -> None:
        super().__init__(num_rows, speed_mps, places, range_m, pause_s)
        self._run_mps, self._sight_m, self._spacing_m = run_mps, sight_m, spacing_m
        self._flight_m = flight_m
        self._weights = cohesion, alignment, separation, migration

    def want(self, state: State, group: GroupState) -> Array:
        """The weighted sum, at the speed of a walk, or of a run in flight."""
        cohesion, alignment, separation, migration = self._weights
        target, pauses = self.targets(state, group)
        first = np.arange(self._num_rows) // group.count * group.count
        if group.absent is not None:
            first += np.repeat(group.by_scene(~group.absent).argmax(axis=1), group.count)
        walk = np.where(pauses[first], 0.0, self._speed_mps)
        to_middle, mean_velocity, from_others = self._neighbours(group)
        wanted = (
            migration * self.arrive(target[first], walk, group)
            + cohesion * to_middle
            + alignment * mean_velocity
            + separation * from_others
        )
        direction, speed = unit_vectors(wanted)
        wanted = direction * np.minimum(np.where(speed < _SLOWEST_MPS, 0.0, speed), self._speed_mps)[:, None]
        robot, velocity, _, distance = nearest_of(state, group, "robots")
        away, _ = unit_vectors(group.motion.position_w[:, :2] - robot - velocity)
        flees = distance < self._flight_m
        wanted = np.where(flees[:, None], away * self._run_mps, wanted)
        before = group.motion.velocity_w[:, :2]
        change, size = unit_vectors(wanted - before)
        most = _ACCELERATION_MPS2 * group.episode.step_s
        return before + change * np.minimum(size, most)[:, None]

    def _neighbours(self, group: GroupState) -> tuple[Array, Array, Array]:
        """The three parts (N, 2) [m/s] that depend on the other members."""
        places = group.by_scene(group.motion.position_w[:, :2])
        velocities = group.by_scene(group.motion.velocity_w[:, :2])
        offset = places[:, None] - places[:, :, None]
        direction, distance = unit_vectors(offset)
        sees: Flags = (distance < self._sight_m) & ~np.eye(group.count, dtype=bool)
        number = np.maximum(sees.sum(axis=2), 1)[..., None]
        middle, far = unit_vectors((offset * sees[..., None]).sum(axis=2) / number)
        to_middle = middle * np.maximum(far - self._spacing_m, 0.0)[..., None] / 2.0
        mean_velocity = (velocities[:, None] * sees[..., None]).sum(axis=2) / number
        near = np.maximum(self._spacing_m / np.maximum(distance, 0.05) - 1.0, 0.0) * sees
        from_others = -(direction * near[..., None]).sum(axis=2)
        size = (self._num_rows, 2)
        return to_middle.reshape(size), mean_velocity.reshape(size), from_others.reshape(size)
