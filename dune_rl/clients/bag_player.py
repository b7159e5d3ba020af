"""Actions of a trained policy for what a bag of ROS 2 has recorded of a robot."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dune_rl.clients.driven_policy import load_driven_policy
from dune_rl.core.errors import ConfigError, DuneWarning
from dune_rl.ros.bag_readings import BagReadings
from dune_rl.ros.library import require_rosbags


@dataclass(frozen=True)
class BagActions:
    """Actions (T, A), in their physical units, and the times (T,) [ns] in the bag at which it chose them."""

    times_ns: NDArray[np.int64]
    actions: NDArray[np.float32]

    @property
    def times_s(self) -> NDArray[np.float64]:
        return self.times_ns / 1e9

    def rows(self) -> list[dict[str, float]]:
        """A row for each action: `time_s`, and `action_0` and so on."""
        return [
            {"time_s": time_s, **{f"action_{index}": value for index, value in enumerate(action)}}
            for time_s, action in zip(self.times_s.tolist(), self.actions.tolist(), strict=True)
        ]


def actions_from_bag(
    bag: str | Path,
    checkpoint: str | Path | None = None,
    *,
    onnx: str | Path | None = None,
    topics: Mapping[str, str] | None = None,
    robot: str | None = None,
    base: str | None = None,
    period_s: float | None = None,
) -> BagActions:
    """What the policy of `checkpoint` (a run's folder or a file of weights) does at each moment of a bag.

    In place of a checkpoint `onnx` is a file that `python -m dune_rl.export` has written. Each observation
    has the latest message of each topic. The policy acts every `period_s`: by default as
    often as it did in a bag of an evaluation, and in other bags as often as in its run. `topics` names the
    topics of sensors that are not the default ones, `robot` the namespace of the robot, and `base` the frame
    of its body (base_link).

    Raises ConfigError, which says which topic is missing, and CheckpointError for a file without a policy;
    warns of topics that fall silent, and of sensors that are mounted elsewhere than the policy's were.
    """
    require_rosbags("reading bags")
    policy = load_driven_policy(checkpoint, onnx, robot)
    readings = BagReadings(Path(bag), policy.sources(), topics or {}, robot=robot, base=base)
    default_s = readings.metadata.get("decision_s")
    if not (isinstance(default_s, int | float) and default_s > 0.0):
        default_s = policy.interface.decision_s
    period = period_s or float(default_s)
    found = [
        (time_ns, policy.act(observation, not number))
        for number, (time_ns, observation) in enumerate(readings.decisions(period))
    ]
    if not found:
        raise ConfigError(f"{bag} ends before there is a message of each topic that the policy reads")
    for line in (*readings.silent(), *readings.misplaced()):
        warnings.warn(line, DuneWarning, stacklevel=2)
    times, actions = zip(*found, strict=True)
    return BagActions(np.array(times, np.int64), np.stack(actions))
