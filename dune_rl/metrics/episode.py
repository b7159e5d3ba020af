"""The paper's navigation metrics, accumulated over each episode of a batch."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dune_rl.settings import Settings

Array = NDArray[np.float64]

METRICS = (
    "episode",
    "steps",
    "return",
    "success",
    "reached",
    "goals",
    "collisions",
    "time_to_goal",
    "clearance",
    "min_clearance",
    "vertical_roughness",
    "vort",
    "smoothness",
    "diverged",
    "stuck",
    "flipped",
    "out_of_world",
    "timeout",
)
# Beside these, where the battery's use is measured.
ENERGY_METRICS = ("energy_wh", "battery_share", "range_km")


class MetricsConf(Settings):
    """Thresholds of the metrics, and whether the battery's use is one: it asks physics for joints' states,
    which makes a step some 4 % slower.
    """

    # Clearance counts up to this; the paper's LiDAR range, which it reports where there is no obstacle.
    max_clearance_m: float = Field(12.0, gt=0.0)
    # A rover tilted more than this is on uneven ground.
    uneven_tilt_rad: float = Field(np.deg2rad(5.0), ge=0.0)
    energy: bool = False


class EpisodeMetrics:
    """Running values for M scenes; a row is final when its episode is.

    Definitions (Vice & Sukthankar 2025, section 2.5; gravity is left out of
    accelerations): `clearance` is OC, the mean over time of the distance from
    the hull to the nearest obstacle or actor [m]; `vertical_roughness` VR, the
    mean of |z acceleration| [m/s²]; `vort` VORT, the mean of the horizontal
    speed on uneven ground [m/s], NaN where there was none; `smoothness` TSR,
    the mean of |acceleration| + |angular velocity|. `success` is to reach a
    goal without collision, `time_to_goal` the time of the first [s],
    `energy_wh` what was taken from the battery [W h], where it is measured;
    `battery_share` is that over its capacity, `capacity_wh`, and `range_km` how far a full one lasts at
    the episode's own use over its own way, which is counted level [km], NaN before anything is used.
    """

    def __init__(self, conf: MetricsConf, num_scenes: int, capacity_wh: float = np.nan) -> None:
        self._conf = conf
        self._capacity_wh = capacity_wh
        self._way_m = np.zeros(num_scenes)
        self._sums = np.zeros((num_scenes, 4))
        self._uneven = np.zeros(num_scenes)
        self.names = (*METRICS, *ENERGY_METRICS) if conf.energy else METRICS
        self.values = np.zeros((num_scenes, len(self.names)))
        self._column = {name: index for index, name in enumerate(self.names)}

    def reset(self, mask: NDArray[np.bool_], episodes: NDArray[np.int64]) -> None:
        """Start episodes with ids `episodes` (M,) in the scenes in `mask` (M,)."""
        self._sums[mask] = 0.0
        self._uneven[mask] = 0.0
        self._way_m[mask] = 0.0
        self.values[mask] = 0.0
        self.values[mask, self._column["episode"]] = episodes[mask]
        for name in ("time_to_goal", "vort"):
            self.values[mask, self._column[name]] = np.nan
        if self._conf.energy:
            self.values[mask, self._column["range_km"]] = np.nan
        for name in ("clearance", "min_clearance"):
            self.values[mask, self._column[name]] = self._conf.max_clearance_m

    def update(
        self,
        *,
        steps: NDArray[np.int64],
        step_s: float,
        reward: Array,
        clearance: Array,
        acceleration_b: Array,
        angular_b: Array,
        ground_speed: Array,
        tilt: Array,
        new_collisions: NDArray[np.int64],
        reached: NDArray[np.bool_],
        flags: dict[str, NDArray[np.bool_]],
        energy_wh: Array | None = None,
    ) -> None:
        """Add one control step of all scenes; arrays have the leading axis M.

        `energy_wh` is what was drawn from the battery, where that is measured.
        """
        values, column = self.values, self._column
        near = np.minimum(clearance, self._conf.max_clearance_m)
        uneven = tilt > self._conf.uneven_tilt_rad
        acceleration = np.sqrt(np.einsum("ij,ij->i", acceleration_b, acceleration_b))
        turning = np.sqrt(np.einsum("ij,ij->i", angular_b, angular_b))
        sums = self._sums
        sums[:, 0] += near
        sums[:, 1] += np.abs(acceleration_b[:, 2])
        sums[:, 2] += acceleration + turning
        sums[:, 3] += np.where(uneven, ground_speed, 0.0)
        self._uneven += uneven
        values[:, column["steps"]] = steps
        values[:, column["return"]] += reward
        values[:, column["collisions"]] += new_collisions
        if reached.any():
            first = reached & (values[:, column["reached"]] == 0.0)
            values[first, column["time_to_goal"]] = steps[first] * step_s
            values[:, column["goals"]] += reached
            values[reached, column["reached"]] = 1.0
        clean = values[:, column["collisions"]] == 0.0
        values[:, column["success"]] = values[:, column["reached"]] * clean
        means = sums[:, :3] / np.maximum(steps, 1)[:, None]
        values[:, column["clearance"]] = means[:, 0]
        values[:, column["vertical_roughness"]] = means[:, 1]
        values[:, column["smoothness"]] = means[:, 2]
        lowest = column["min_clearance"]
        values[:, lowest] = np.minimum(values[:, lowest], near)
        np.divide(sums[:, 3], self._uneven, out=values[:, column["vort"]], where=self._uneven > 0)
        for name, flag in flags.items():
            values[:, column[name]] = flag
        if energy_wh is not None:
            values[:, column["energy_wh"]] += energy_wh
            share = values[:, column["energy_wh"]] / self._capacity_wh
            values[:, column["battery_share"]] = share
            self._way_m += ground_speed * step_s
            np.divide(self._way_m / 1000.0, share, out=values[:, column["range_km"]], where=share > 0)
