"""Which sensors a rover carries, and what they give."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from dune_rl.errors import ConfigError
from dune_rl.geometry.batched import BatchedHeightFields, BatchedRayScenes
from dune_rl.rendering.beam_surface import BatchedBeamSurfaces
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.participating_media import BeamMedia
from dune_rl.sensors.camera import CameraConf, Cameras, CameraSensor
from dune_rl.sensors.currents import Currents, CurrentsConf
from dune_rl.sensors.depth_strip import DepthStrip, DepthStripConf
from dune_rl.sensors.encoders import Encoders, EncodersConf
from dune_rl.sensors.height_scan import HeightScan, HeightScanConf
from dune_rl.sensors.imu import Imu, ImuConf, ImuSensor
from dune_rl.sensors.lidar import Lidar, LidarConf
from dune_rl.sensors.lidar_3d import Lidar3d, Lidar3dConf
from dune_rl.sensors.medium import InTurn, RangeEffect, effects_of
from dune_rl.sensors.odometry import DriveGeometry, Odometry, OdometryConf
from dune_rl.sensors.position import Position, PositionConf
from dune_rl.sensors.realism.camera import CameraRealismConf, realistic_camera
from dune_rl.sensors.realism.lidar import BeamFaults, LidarRealismConf
from dune_rl.sensors.realism.pipeline import (
    EncoderRealismConf,
    ImuRealismConf,
    OdometryRealismConf,
    PositionRealismConf,
    ReadingRealismConf,
    RealismConf,
    SpeedRealismConf,
    realistic,
)
from dune_rl.sensors.scanner import Scanner
from dune_rl.sensors.sensor import Sensor
from dune_rl.sensors.speed import Speed
from dune_rl.settings import Settings

Place = tuple[float, float, float]
SensorName = Literal[
    "lidar",
    "lidar_past",
    "lidar_3d",
    "depth_strip",
    "height_scan",
    "camera",
    "imu",
    "goal",
    "velocity",
    "encoders",
    "odometry",
    "currents",
    "position",
]


class SensorRealismConf(Settings):
    """The faults of real parts, for the sensors that have any; null is a perfect one.

    A name alone (`imu: bno055`) is a part that is known, with all its figures.
    """

    imu: ImuRealismConf | None = None
    lidar: LidarRealismConf | None = None
    lidar_3d: LidarRealismConf | None = None
    depth_strip: ReadingRealismConf | None = None
    height_scan: ReadingRealismConf | None = None
    camera: CameraRealismConf | None = None
    velocity: SpeedRealismConf | None = None
    encoders: EncoderRealismConf | None = None
    odometry: OdometryRealismConf | None = None
    currents: ReadingRealismConf | None = None
    position: PositionRealismConf | None = None

    def check(self, step_s: float) -> None:
        """Raise ValueError where a rate or a latency does not fit control steps of `step_s`."""
        for name in type(self).model_fields:
            conf: RealismConf | None = getattr(self, name)
            if conf is not None:
                try:
                    conf.steps(step_s)
                except ValueError as error:
                    raise ValueError(f"sensors.realism.{name}: {error}") from None


class SensorsConf(Settings):
    """The sensors whose readings make the observation, in this order, and their settings.

    `lidar_past` is the scan of `past_s` ago, carried into the present sensor
    frame: where it differs from the present scan, something has moved. Mounts
    that are None are the robot's own.
    """

    enabled: tuple[SensorName, ...] = ("lidar", "lidar_past", "imu", "goal", "velocity")
    lidar: LidarConf = LidarConf()
    past_s: float = Field(0.5, gt=0.0, le=5.0)
    lidar_3d: Lidar3dConf = Lidar3dConf()
    depth_strip: DepthStripConf = DepthStripConf()
    height_scan: HeightScanConf = HeightScanConf()
    camera: CameraConf = CameraConf()
    imu: ImuConf = ImuConf()
    encoders: EncodersConf = EncodersConf()
    odometry: OdometryConf = OdometryConf()
    currents: CurrentsConf = CurrentsConf()
    position: PositionConf = PositionConf()
    realism: SensorRealismConf = SensorRealismConf()

    def on(
        self,
        *,
        scanner_b: Place,
        camera_b: Place,
        camera_pitch_rad: float,
        imu_b: Place,
        standing_height_m: float,
    ) -> "SensorsConf":
        """The same on a robot that carries its scanners, camera and inertial unit there.

        What has a place of its own keeps it.
        """
        places = {"lidar": scanner_b, "lidar_3d": scanner_b, "depth_strip": scanner_b}
        changes: dict[str, Settings] = {}
        for name, place in {**places, "camera": camera_b, "imu": imu_b}.items():
            conf: Settings = getattr(self, name)
            own = (
                {"mount_b": place, "pitch_rad": camera_pitch_rad} if name == "camera" else {"mount_b": place}
            )
            changes[name] = _completed(conf, own)
        changes["height_scan"] = _completed(self.height_scan, {"standing_height_m": standing_height_m})
        return self.model_copy(update=changes)

    def readings(self) -> list[str]:
        """Names of the readings, in order: a camera and a 3D LiDAR have one for each output."""
        several = {"camera": self.camera.outputs, "lidar_3d": self.lidar_3d.outputs}
        names: list[str] = []
        for name in self.enabled:
            names += [f"{name}_{output}" for output in several[name]] if name in several else [name]
        return names


def _completed(conf: Settings, values: Mapping[str, object]) -> Settings:
    """The settings with `values` for those that are None."""
    return conf.model_copy(
        update={name: value for name, value in values.items() if getattr(conf, name) is None}
    )


@dataclass(frozen=True)
class Surroundings:
    """What sensors look at, of each of M scenes, and the body that they sit on.

    `solid` is all that is solid and still, and `surfaces` what it looks like,
    `figures` are the actors', `extent` (xmin, xmax, ymin, ymax) and `heights`
    (zmin, zmax) [m] where a rover can be in any of them, `wheels` its drive,
    None where it walks, `air` what lies in between. `cameras` is called only
    where a camera is enabled.
    """

    solid: BatchedRayScenes
    surfaces: BatchedBeamSurfaces
    figures: Sequence[MovingMesh]
    terrain: BatchedHeightFields
    extent: tuple[float, float, float, float]
    heights: tuple[float, float]
    num_wheels: int
    wheels: DriveGeometry | None
    cameras: Callable[[CameraConf], Cameras]
    air: BeamMedia


def make_sensors(
    conf: SensorsConf, around: Surroundings, imu: Imu, num_scenes: int, step_s: float
) -> list[Sensor]:
    """The sensors that `conf` enables, each once, for M scenes with control steps of `step_s`.

    Those that `conf.realism` names are wrapped in the faults of a real part.

    `imu` is made by the caller, who measures by it too: it is always among them.
    """
    real = conf.realism

    def scanner() -> Sensor:
        lidar = Lidar(conf.lidar, around.solid, [figure.rays for figure in around.figures])
        wanted = [name for name in conf.enabled if name in ("lidar", "lidar_past")]
        limits_m = (conf.lidar.min_range_m, conf.lidar.range_m)
        effects: list[RangeEffect] = [
            *effects_of(around.air, "lidar", lidar.directions_b, conf.lidar.mount_b, limits_m)
        ]
        if real.lidar is not None:
            effects.append(BeamFaults(real.lidar, conf.lidar))
        faults = InTurn(effects) if effects else None
        scans = Scanner(lidar, wanted, num_scenes, max(1, round(conf.past_s / step_s)), faults)
        return realistic(scans, real.lidar, num_scenes, step_s)

    def camera() -> Sensor:
        pictures = CameraSensor(around.cameras(conf.camera), num_scenes)
        return realistic_camera(pictures, real.camera, num_scenes, step_s)

    def plain(sensor: Sensor, faults: RealismConf | None) -> Sensor:
        return realistic(sensor, faults, num_scenes, step_s)

    def rings() -> Sensor:
        scan, faults = conf.lidar_3d, None
        if real.lidar_3d is not None:
            limits_m = (scan.min_range_m, scan.range_m)
            faults = BeamFaults.of_rings(real.lidar_3d, limits_m, scan.n_rings * scan.n_beams)
        lidar = Lidar3d(scan, solid, around.surfaces, figures, num_scenes, around.air, faults)
        return plain(lidar, real.lidar_3d)

    def odometry() -> Sensor:
        if around.wheels is None:
            raise ConfigError(
                "odometry is of wheels, and this robot has none; leave it out of sensors.enabled"
            )
        told = Odometry(conf.odometry, conf.encoders, around.wheels, num_scenes, wheels, step_s)
        return plain(told, real.odometry)

    solid, figures, wheels = around.solid, around.figures, around.num_wheels
    makers: dict[str, Callable[[], Sensor]] = {
        "lidar": scanner,
        "lidar_3d": rings,
        "depth_strip": lambda: plain(
            DepthStrip(conf.depth_strip, solid, figures, num_scenes, around.air), real.depth_strip
        ),
        "height_scan": lambda: plain(
            HeightScan(conf.height_scan, solid, around.terrain, num_scenes), real.height_scan
        ),
        "camera": camera,
        "velocity": lambda: plain(Speed(num_scenes), real.velocity),
        "encoders": lambda: plain(Encoders(conf.encoders, num_scenes, wheels, step_s), real.encoders),
        "odometry": odometry,
        "currents": lambda: plain(Currents(conf.currents, num_scenes, wheels), real.currents),
        "position": lambda: plain(
            Position(conf.position, around.extent, around.heights, num_scenes, step_s), real.position
        ),
    }
    instruments = dict.fromkeys("lidar" if name == "lidar_past" else name for name in conf.enabled)
    sensors: list[Sensor] = [realistic(ImuSensor(imu, num_scenes, step_s), real.imu, num_scenes, step_s)]
    return sensors + [makers[name]() for name in instruments if name in makers]
