"""A trained policy that drives one robot, out of a checkpoint or an ONNX file, and what it reads."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import ValidationError
from tensordict import TensorDict

from dune_rl.clients.policy_interface import PolicyInterface
from dune_rl.core.errors import ConfigError
from dune_rl.learning.checkpoint import interpreting, read_policy_file
from dune_rl.learning.group_policy import Deterministic, GroupPolicy
from dune_rl.learning.networks.policy import BEGINS
from dune_rl.learning.onnx_policy import OnnxPolicy
from dune_rl.learning.policy_spec import PolicySpec
from dune_rl.learning.saved_policies import read_saved_policy, saved_entry
from dune_rl.ros.codecs.choice import make_codec
from dune_rl.ros.codecs.codec import ArrayCodec, SensorCodec
from dune_rl.ros.codecs.motion import GoalCodec
from dune_rl.ros.past_scans import PastSource
from dune_rl.ros.readings import ReadingSource
from dune_rl.sensors.lidar import LidarConf
from dune_rl.sensors.past_scan import LidarPastConf
from dune_rl.sensors.sensor import Reading
from dune_rl.sensors.settings import SensorSettings

# An action (A,) in its own units, for the readings of one robot by name; a memory is emptied at a beginning.
Act = Callable[[Mapping[str, Reading], bool], NDArray[np.float32]]


@dataclass(frozen=True)
class DrivenPolicy:
    """A policy for one robot, what is known of it, and its file."""

    act: Act
    interface: PolicyInterface
    file: Path

    def sources(self) -> dict[str, ReadingSource]:
        """Where each part that it reads comes from, by the settings of the robot's sensors."""
        settings, codecs = self.interface.sensors, dict[str, SensorCodec]()
        for name, conf in settings.items():
            codec = make_codec(name, conf, {}, step_s=self.interface.control_step_s)
            codecs |= dict.fromkeys(codec.sources, codec)
        return {
            key: ReadingSource(
                ArrayCodec({key: (part.shape, np.dtype(part.dtype))}),
                codecs.get(key),
                _past_of(settings.get(key), settings),
            )
            for key, part in self.interface.observation.items()
        }


def goal_source(name: str) -> ReadingSource:
    """Where the distance and the bearing of the goal come from, as the part `name`."""
    codec = GoalCodec(name)
    return ReadingSource(codec, codec)


def load_driven_policy(
    checkpoint: str | Path | None = None, onnx: str | Path | None = None, robot: str | None = None
) -> DrivenPolicy:
    """The policy of a run's folder or a file of weights, or else of an ONNX file, for the robot `robot`.

    Raises CheckpointError or ConfigError for a file without a policy of a robot of that name.
    """
    if onnx is not None:
        return _of_onnx(Path(onnx))
    assert checkpoint is not None
    return _of_checkpoint(Path(checkpoint), robot)


def _of_onnx(path: Path) -> DrivenPolicy:
    policy = OnnxPolicy(path)
    described = policy.description
    try:
        interface = PolicyInterface.model_validate(
            {name: described[name] for name in PolicyInterface.model_fields}
        )
    except (KeyError, ValidationError):
        raise ConfigError(
            f"policy={path} does not say what it reads and for which robot; write it anew by "
            "python -m dune_rl.export checkpoint=PATH out=FILE.onnx"
        ) from None

    def act(observation: Mapping[str, Reading], begins: bool) -> NDArray[np.float32]:
        rows = {key: np.asarray(value)[None] for key, value in observation.items()}
        return np.asarray(policy.act(rows, np.array([begins]))[0], np.float32)

    return DrivenPolicy(act, interface, path)


def _of_checkpoint(path: Path, robot: str | None) -> DrivenPolicy:
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
    policy = Deterministic(GroupPolicy(group, spec, saved.make_network()))

    def act(observation: Mapping[str, Reading], begins: bool) -> NDArray[np.float32]:
        parts: dict[str, Any] = {
            key: torch.from_numpy(np.array(value))[None, None] for key, value in observation.items()
        }
        inputs = TensorDict({group: TensorDict({}, batch_size=[1, 1])}, batch_size=[1])
        inputs[group, "observation"] = TensorDict(parts, batch_size=[1, 1])
        inputs[group, BEGINS] = torch.full((1, 1, 1), begins)
        action: NDArray[np.float32] = policy(inputs)[group, "action"][0, 0].numpy()
        return action

    return DrivenPolicy(act, PolicyInterface.of_run(spec, group, saved.config), file)


def _past_of(conf: SensorSettings | None, settings: Mapping[str, SensorSettings]) -> PastSource | None:
    """What a past scan of the settings `conf` follows from, where a LiDAR's scans are enough for it."""
    if not isinstance(conf, LidarPastConf):
        return None
    lidar = settings.get(conf.lidar)
    # Rings are seen in the level plane, of which messages tell nothing.
    if not isinstance(lidar, LidarConf) or lidar.rings_deg:
        return None
    return PastSource(conf.lidar, lidar, conf.past_s)
