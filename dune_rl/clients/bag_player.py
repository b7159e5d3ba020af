"""Actions of a trained policy for what a bag of ROS 2 has recorded of a robot."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from dune_rl.config.commands import ViewConf
from dune_rl.config.compose import compose
from dune_rl.core.errors import ConfigError
from dune_rl.learning.checkpoint import interpreting, read_policy_file
from dune_rl.learning.group_policy import Deterministic, GroupPolicy
from dune_rl.learning.networks.policy import BEGINS
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.saved_policies import read_saved_policy, saved_entry
from dune_rl.ros.codecs import ArrayCodec, SensorCodec
from dune_rl.ros.library import require_rosbags
from dune_rl.ros.readings import BagReadings, ReadingSource
from dune_rl.ros.sensor_topics import make_codec
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.past_scan import LidarPastConf
from dune_rl.sensors.sensor import Reading
from dune_rl.sensors.settings import SensorSettings


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
    checkpoint: str | Path,
    *,
    topics: Mapping[str, str] | None = None,
    robot: str | None = None,
    base: str | None = None,
    period_s: float | None = None,
) -> BagActions:
    """What the policy of `checkpoint` (a run's folder or a file of weights) does at each moment of a bag.

    Each observation has the latest message of each topic. The policy acts every `period_s`: by default as
    often as it did in a bag of an evaluation, and in other bags as often as in its run. `topics` names the
    topics of sensors that are not the default ones, `robot` the namespace of the robot, and `base` the frame
    of its body (base_link).

    Raises ConfigError, which says which topic is missing, and CheckpointError for a file without a policy.
    """
    require_rosbags("reading bags")
    policy, settings, step_s, decision_s = _read_policy(Path(checkpoint), robot)
    parts = reading_sources(policy.policy_spec, settings, step_s)
    readings = BagReadings(Path(bag), parts, topics or {}, robot=robot, base=base)
    told_s = readings.told.get("decision_s")
    period = period_s or (float(told_s) if isinstance(told_s, int | float) and told_s > 0.0 else decision_s)
    act = Deterministic(policy)
    found = [
        (time_ns, _act(act, policy, observation, begins=not number))
        for number, (time_ns, observation) in enumerate(readings.decisions(period))
    ]
    if not found:
        raise ConfigError(f"{bag} ends before there is a message of each topic that the policy reads")
    times, actions = zip(*found, strict=True)
    return BagActions(np.array(times, np.int64), np.stack(actions))


def reading_sources(
    spec: PolicySpec, settings: Mapping[str, SensorSettings], step_s: float
) -> dict[str, ReadingSource]:
    """Where each part that a policy reads comes from, by the settings of the robot's sensors."""
    codecs: dict[str, SensorCodec] = {}
    for name, conf in settings.items():
        codec = make_codec(name, conf, {}, step_s=step_s)
        codecs |= dict.fromkeys(codec.sources, codec)
    found = {}
    for key in spec.keys:
        part = spec.part(key)
        array = ArrayCodec({key: (part.shape, np.uint8 if part.uint8 else np.float32)})
        found[key] = ReadingSource(array, codecs.get(key), _past_of(settings.get(key), settings))
    return found


def _past_of(
    conf: SensorSettings | None, settings: Mapping[str, SensorSettings]
) -> tuple[str, LidarConf, float] | None:
    """The LiDAR, its settings and the age [s] of a past scan that can be found from the LiDAR's scans."""
    if not isinstance(conf, LidarPastConf):
        return None
    lidar = settings.get(conf.lidar)
    # Rings are seen in the level plane, of which a bag tells nothing.
    if not isinstance(lidar, LidarConf) or lidar.rings_deg:
        return None
    return conf.lidar, lidar, conf.past_s


def _read_policy(
    path: Path, robot: str | None
) -> tuple[GroupPolicy, Mapping[str, SensorSettings], float, float]:
    """The policy, its robot's sensors, and the lengths [s] of a control step and of an action in its run."""
    file, content = read_policy_file(path)
    names = list(content["groups"])
    asked = "" if robot is None else robot.strip("/").rpartition("_")[0]
    if len(names) > 1 and not asked:
        raise ConfigError(
            f"{file} has policies of {', '.join(names)}: set robot=NAME to choose one, such as {names[0]}_0"
        )
    group = names[0] if len(names) == 1 else asked
    entry = saved_entry(content["groups"], file, group)
    with interpreting(file):
        spec = PolicySpec.from_plain(entry["spec"])
    saved = read_saved_policy(path, group, spec, allow_more=False)
    conf = compose(ViewConf, [], (), saved.config)
    groups = {each.name: each for each in conf.external_groups}
    chosen = groups.get(group, conf.external_groups[0])
    step_s = conf.physics.control_step_s
    sensors = {name: each for name, each in (chosen.sensors or {}).items() if each.observed}
    policy = GroupPolicy(group, spec, saved.make_network())
    return policy, sensors, step_s, step_s * conf.physics.action_repeat


def _act(
    act: Deterministic, policy: GroupPolicy, observation: Mapping[str, Reading], *, begins: bool
) -> NDArray[np.float32]:
    """The action (A,) for one robot's readings; a recurrent policy's memory is empty where it `begins`."""
    parts: dict[str, Any] = {
        key: torch.from_numpy(np.array(value))[None, None] for key, value in observation.items()
    }
    inputs = TensorDict({policy.group: TensorDict({}, batch_size=[1, 1])}, batch_size=[1])
    inputs[policy.group, "observation"] = TensorDict(parts, batch_size=[1, 1])
    inputs[policy.group, BEGINS] = torch.full((1, 1, 1), begins)
    action: NDArray[np.float32] = act(inputs)[policy.group, "action"][0, 0].numpy()
    return action
