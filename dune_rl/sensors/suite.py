"""Which sensors a rover carries, and what they give."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from dune_rl.geometry.rays import RayScene
from dune_rl.rendering.baked import Baked
from dune_rl.rendering.moving import Figure
from dune_rl.sensors.camera import Camera, CameraConf, CameraSensor
from dune_rl.sensors.imu import Imu, ImuConf, ImuSensor
from dune_rl.sensors.lidar import Lidar, LidarConf
from dune_rl.sensors.scanner import Scanner
from dune_rl.sensors.sensor import Sensor
from dune_rl.sensors.speed import Speed
from dune_rl.settings import Settings

SensorName = Literal["lidar", "lidar_past", "imu", "goal", "velocity", "camera"]


class SensorsConf(Settings):
    """The sensors whose readings make the observation, in this order, and their settings.

    `lidar_past` is the scan of `past_s` ago, carried into the present sensor
    frame: where it differs from the present scan, something has moved.
    """

    enabled: tuple[SensorName, ...] = ("lidar", "lidar_past", "imu", "goal", "velocity")
    lidar: LidarConf = LidarConf()
    past_s: float = Field(0.5, gt=0.0, le=5.0)
    imu: ImuConf = ImuConf()
    camera: CameraConf = CameraConf()

    def readings(self) -> list[str]:
        """Names of the readings, in order: a camera has one for each output."""
        names: list[str] = []
        for name in self.enabled:
            names += [f"camera_{output}" for output in self.camera.outputs] if name == "camera" else [name]
        return names


@dataclass(frozen=True)
class Surroundings:
    """What sensors look at: all that is solid and still, a figure for each actor, all that is seen.

    `appearance` is called only where a camera asks for it, since it takes a moment to work out.
    """

    solid: RayScene
    figures: Sequence[Figure]
    appearance: Callable[[], Baked]


def make_sensors(
    conf: SensorsConf, around: Surroundings, imu: Imu, num_scenes: int, step_s: float
) -> list[Sensor]:
    """The sensors that `conf` enables, each once, for M scenes with control steps of `step_s`.

    `imu` is made by the caller, who measures by it too.
    """
    enabled = conf.enabled
    sensors: list[Sensor] = [ImuSensor(imu, num_scenes, step_s)]
    scans = [name for name in enabled if name in ("lidar", "lidar_past")]
    if scans:
        lidar = Lidar(conf.lidar, around.solid, [figure.rays for figure in around.figures])
        sensors.append(Scanner(lidar, scans, num_scenes, max(1, round(conf.past_s / step_s))))
    if "velocity" in enabled:
        sensors.append(Speed(num_scenes))
    if "camera" in enabled:
        sensors.append(CameraSensor(Camera(conf.camera, around.appearance(), around.figures), num_scenes))
    return sensors
