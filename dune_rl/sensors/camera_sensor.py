"""The camera as a sensor: the latest pictures of every agent of a group."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.rendering.scenery import Segment
from dune_rl.sensors.camera import CameraConf
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.sensor import PictureSensor, Reading
from dune_rl.state.state import GroupState


class CameraSensor(PictureSensor):
    """The readings "<name>_<output>", (N, height, width, channels)."""

    def __init__(self, name: str, context: SensorContext, conf: CameraConf) -> None:
        limits: dict[str, tuple[int, float, float, type]] = {
            "rgb": (3, 0, 255, np.uint8),
            "grey": (1, 0, 255, np.uint8),
            "segmentation": (1, 0, max(Segment), np.uint8),
            "depth": (1, 0.0, conf.range_m, np.float32),
            "normals": (3, -1.001, 1.001, np.float32),
        }
        shape = (conf.height, conf.width)
        super().__init__(name, context.num_rows, shape, {each: limits[each] for each in conf.outputs})
        self._camera = context.make_cameras(conf)
        self._agents = context.num_rows // len(self._camera)

    def _look(self, rows: NDArray[np.int64] | None, now: GroupState) -> dict[str, Reading]:
        motion = now.motion
        if rows is None:
            return self._camera.frames(motion.position_w, motion.rotation, now.neighbours)
        camera = self._camera.select_scenes(rows // self._agents)
        return camera.frames(motion.position_w[rows], motion.rotation[rows], now.neighbours[rows])
