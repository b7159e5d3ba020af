"""The camera as a sensor: the latest pictures of every agent of a group."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dune_rl.geometry.arrays import Flags
from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.camera import CameraConf
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.sensor import Bounds, Reading
from dune_rl.state.state import GroupState, State


class CameraSensor:
    """The readings "<name>_<output>", (N, height, width, channels)."""

    def __init__(self, name: str, context: SensorContext, conf: CameraConf) -> None:
        num_rows = context.num_rows
        self._camera, self._name = context.make_cameras(conf), name
        self._agents = num_rows // len(self._camera)
        self._frames: dict[str, NDArray[Any]] = {
            name: np.zeros((num_rows, *low.shape), low.dtype) for name, (low, _) in self.bounds().items()
        }

    def bounds(self) -> dict[str, Bounds]:
        """Bytes, metres up to the range, and components of unit vectors."""
        conf = self._camera.conf
        limits: dict[str, tuple[int, float, float, type]] = {
            "rgb": (3, 0, 255, np.uint8),
            "grey": (1, 0, 255, np.uint8),
            "segmentation": (1, 0, max(Segment), np.uint8),
            "depth": (1, 0.0, conf.range_m, np.float32),
            "normals": (3, -1.001, 1.001, np.float32),
        }
        found: dict[str, Bounds] = {}
        for name in conf.outputs:
            channels, low, high, kind = limits[name]
            shape = (conf.height, conf.width, channels)
            found[f"{self._name}_{name}"] = (np.full(shape, low, kind), np.full(shape, high, kind))
        return found

    def begin(self, mask: Flags, now: GroupState, state: State) -> None:
        """Take pictures in the rows in `mask` (N,); the others keep theirs."""
        rows = np.flatnonzero(mask)
        if not len(rows):
            return
        camera = self._camera.select_scenes(rows // self._agents)
        frames = camera.frames(now.motion.position_w[rows], now.motion.rotation[rows], now.neighbours[rows])
        for name, frame in frames.items():
            self._frames[f"{self._name}_{name}"][rows] = frame

    def measure(self, now: GroupState, state: State) -> None:
        """Take new pictures."""
        frames = self._camera.frames(now.motion.position_w, now.motion.rotation, now.neighbours)
        self._frames = {f"{self._name}_{name}": frame for name, frame in frames.items()}

    def read(self) -> dict[str, Reading]:
        """The latest pictures."""
        return {name: frame.copy() for name, frame in self._frames.items()}
