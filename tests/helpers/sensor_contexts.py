"""Contexts for sensors that are built without a simulation, and LiDARs with their past scans."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scenes import STEP_S

from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.participating_media import ParticipatingMedia
from dune_rl.sensors.context import SensorContext
from dune_rl.sensors.lidar import LidarConf, LidarSensor
from dune_rl.sensors.past_scan import LidarPast, LidarPastConf
from dune_rl.state.sensor_carrier import SensorCarrier
from dune_rl.worlds.world import World

ORIGIN = (0.0, 0.0, 0.0)


def carrier_of(**fields: Any) -> SensorCarrier:
    return SensorCarrier(ORIGIN, ORIGIN, ORIGIN, **fields)


def context_of(num_rows: int = 1, *, farthest_m: float = 1.0, **fields: Any) -> SensorContext:
    """A context of `num_rows` agents with these `fields`; what a sensor does not read is None."""
    unread: Any = None
    known = {
        "step_s": STEP_S,
        "carrier": carrier_of(),
        **dict.fromkeys(("solid", "surfaces", "terrain", "make_cameras"), unread),
        "meshes": (),
        "extent": (0.0, farthest_m, 0.0, 0.0),
        "heights": (0.0, 0.0),
        "air": ParticipatingMedia(),
    }
    return SensorContext(num_rows, **{**known, **fields})


def rays_of(world: World) -> RayScene:
    solid = world.solid_mesh()
    return RayScene(solid.vertices, solid.faces)


class ScanPair:
    """The sensors "lidar" and "lidar_past", which is `delay` steps old, measured one after the other."""

    def __init__(
        self,
        world: World,
        conf: LidarConf,
        num_rows: int = 1,
        delay: int = 2,
        meshes: Sequence[MovingMesh] = (),
        **fields: Any,
    ) -> None:
        context = context_of(num_rows, solid=rays_of(world), meshes=meshes, **fields)
        lidar = LidarSensor("lidar", context, conf)
        past = LidarPastConf(past_s=delay * STEP_S)
        self._sensors = (lidar, LidarPast("lidar_past", replace(context, sensor_of=lambda _: lidar), past))

    def begin(self, mask: np.ndarray, now: Any, state: Any) -> None:
        for sensor in self._sensors:
            sensor.begin(mask, now, state)

    def measure(self, now: Any, state: Any) -> None:
        for sensor in self._sensors:
            sensor.measure(now, state)

    def read(self) -> dict[str, np.ndarray]:
        return self._sensors[0].read() | self._sensors[1].read()
