"""Metric terms of the battery's use."""

import numpy as np

from dune_rl.core.errors import ConfigError
from dune_rl.geometry.arrays import Array, Flags
from dune_rl.state.state import GroupState, State


def energy_wh(state: State, group: GroupState) -> Array:
    """Energy drawn from the battery in this step [W h]."""
    if group.energy is None:
        raise ConfigError(
            f"the energy of {group.name} is not measured: set metrics.energy=true, for a robot with a battery"
        )
    # The work of diverged physics may be anything.
    work_j = np.where(group.motion.diverged, 0.0, group.energy.work_j)
    return group.energy.battery.drawn_wh(work_j, group.episode.step_s)


class BatteryShare:
    """Share of the battery's capacity that the episode has used."""

    def __init__(self, num_rows: int) -> None:
        self._drawn_wh = np.zeros(num_rows)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Nothing has been drawn in the episodes of the agents in `mask` (N,)."""
        self._drawn_wh[mask] = 0.0

    def __call__(self, state: State, group: GroupState) -> Array:
        """Shares (N,); to be called once a control step."""
        self._drawn_wh += energy_wh(state, group)
        assert group.energy is not None
        return self._drawn_wh / group.energy.battery.capacity_wh


class BatteryRange:
    """Distance [km] that a full battery lasts for, at the use and over the way of the episode.

    The way is counted level; NaN before anything is drawn.
    """

    def __init__(self, num_rows: int) -> None:
        self._share = BatteryShare(num_rows)
        self._way_m = np.zeros(num_rows)

    def reset(self, mask: Flags, group: GroupState) -> None:
        """Nothing has been drawn, and no way made, in the episodes of the agents in `mask` (N,)."""
        self._share.reset(mask, group)
        self._way_m[mask] = 0.0

    def __call__(self, state: State, group: GroupState) -> Array:
        """Ranges (N,); to be called once a control step."""
        share = self._share(state, group)
        velocity = group.motion.velocity_w
        self._way_m += np.hypot(velocity[:, 0], velocity[:, 1]) * group.episode.step_s
        ranges = np.full(len(share), np.nan)
        np.divide(self._way_m / 1000.0, share, out=ranges, where=share > 0.0)
        return ranges
