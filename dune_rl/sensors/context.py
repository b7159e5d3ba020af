"""What sensors are built from: the body that carries them, and what there is to be sensed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dune_rl.geometry.shared_per_scene import BatchedHeightFields, BatchedRayScenes
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.participating_media import BeamMedia
from dune_rl.rendering.scenery import BatchedBeamSurfaces
from dune_rl.sensors.camera import CameraConf, Cameras
from dune_rl.sensors.navigation import Navigation
from dune_rl.sensors.sensor import Reading, Sensor
from dune_rl.state.sensor_carrier import SensorCarrier


def _no_sensors(name: str) -> Any:
    raise LookupError(f"no sensor {name!r} is at hand")


@dataclass(frozen=True)
class SensorContext:
    """What the sensors of one group are built from, for N = M * G rows in M scenes.

    Of each of the M scenes `solid` has the rays through all that is solid and still, `surfaces` its segments
    and brightness, `terrain` the bare ground, and `air` the haze and the grass that beams pass. `meshes` are
    the moving bodies in the order of the columns of `GroupState.neighbours`. Agents of any scene stay in the
    rectangle `extent` (xmin, xmax, ymin, ymax) and between `heights` (zmin, zmax) [m]. `make_cameras` builds
    the cameras of all scenes for given settings. A control step takes `step_s`; an action of the group has
    `action_size` numbers.

    A sensor reads other sensors of the same agents by `sensor_of`, given their names, without their rate and
    latency: they have been measured before it. `reading_of` gives a function that returns a sensor's latest
    reading as the robot has it, with rate, latency and faults. `settings_of` has the settings of the sensor
    that is called after a kind, or the kind's defaults. `navigation` is what the robots know of their own
    motion where any sensor has the faults of a real device, and None for a sensor that is true but
    for faults of its own.
    """

    num_rows: int
    step_s: float
    carrier: SensorCarrier
    solid: BatchedRayScenes
    surfaces: BatchedBeamSurfaces
    meshes: Sequence[MovingMesh]
    terrain: BatchedHeightFields
    extent: tuple[float, float, float, float]
    heights: tuple[float, float]
    make_cameras: Callable[[CameraConf], Cameras]
    air: BeamMedia
    action_size: int = 0
    sensor_of: Callable[[str], Sensor] = _no_sensors
    settings_of: Callable[[str], Any] = _no_sensors
    reading_of: Callable[[str], Callable[[], Reading]] = _no_sensors
    navigation: Navigation | None = None

    @property
    def diagonal_m(self) -> float:
        """Largest horizontal distance between two points of the extent [m]."""
        xmin, xmax, ymin, ymax = self.extent
        return float(np.hypot(xmax - xmin, ymax - ymin))
