"""The driver `oracle`: as `planner`, with the future of those whose ways are fixed."""

import numpy as np

from dune_rl.behaviours.drivers.planner import Planner
from dune_rl.geometry.arrays import Array
from dune_rl.sensors.perception.dynamic_window import STEP_S, STEPS

# A forecast that does not begin this near to where an actor is now is of one that is not there [m].
_THERE_M = 1.0
# A slow body needs longer to get out of a way that it knows: this far is simulated, at most for so long.
_AHEAD_M = 1.6
_LONGEST_AHEAD_S = 5.0


class Oracle(Planner):
    """As `Planner`, and knows where actors on paths and trajectories will be, whatever holds them up.

    As a teacher it labels commands with what they will cost, of which a policy learns the mean over all that
    it cannot tell apart. All other actors are predicted as by `Planner`. Where the top speed is below
    0.64 m/s, it looks further ahead than 2.5 s, at most 5 s.
    """

    @property
    def _steps(self) -> int:
        ahead_s = _AHEAD_M / min(self.context.vehicle.max_speed_mps, self._speed_mps)
        return max(STEPS, round(min(ahead_s, _LONGEST_AHEAD_S) / STEP_S))

    def _predict(self, actors: Array) -> Array:
        places = super()._predict(actors)
        forecast = self.context.forecast
        if forecast is None:
            return places
        known = np.moveaxis(forecast(STEP_S, self._steps), 1, 2)
        apart = np.linalg.norm(known[:, :1] - actors[:, None, :, :2], axis=-1, keepdims=True)
        # False of NaN.
        found: Array = np.where(apart < _THERE_M, known, places)
        return found
