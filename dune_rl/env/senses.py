"""What rovers sense: their instruments read once a control step, and the observation made of the readings."""

import numpy as np
from numpy.typing import NDArray

from dune_rl.actors.actor import Actors
from dune_rl.actors.shapes import ray_shapes
from dune_rl.env.motion import Motion
from dune_rl.geometry.rays import RayScene
from dune_rl.physics.interface import PhysicsConf
from dune_rl.sensors.imu import Imu
from dune_rl.sensors.lidar import Lidar
from dune_rl.sensors.past_scan import PastScan
from dune_rl.sensors.suite import SensorsConf
from dune_rl.worlds.world import World

Array = NDArray[np.float64]
Floats = NDArray[np.float32]


class Senses:
    """The instruments of M rovers. What no enabled sensor needs is not measured."""

    def __init__(
        self, conf: SensorsConf, world: World, actors: Actors, physics: PhysicsConf, num_scenes: int
    ) -> None:
        solid = world.solid_mesh()
        self._conf = conf
        self._imu = Imu(conf.imu, num_scenes)
        self._lidar = Lidar(conf.lidar, RayScene(solid.vertices, solid.faces), ray_shapes(actors.confs))
        self._past = PastScan(conf.lidar, num_scenes, max(1, round(conf.past_s * physics.control_hz)))
        self._scan = np.zeros((num_scenes, conf.lidar.n_segments), np.float32)
        self._step_s = physics.control_step_s

    @property
    def acceleration_b(self) -> Array:
        """Acceleration without gravity in the body frame [m/s²], (M, 3), over the last control step."""
        return self._imu.acceleration_b

    def begin(self, mask: NDArray[np.bool_], motion: Motion, actor_poses: Array) -> None:
        """Read the instruments at the start of the episodes in `mask` (M,), which have no past."""
        self._imu.begin(mask, motion.rotation, motion.velocity_w, motion.angular_w)
        ends_w = self._look(motion, actor_poses)
        if ends_w is not None:
            self._past.restart(mask, ends_w)

    def measure(self, motion: Motion, actor_poses: Array) -> None:
        """Read the instruments at the end of a control step, once; `actor_poses` (M, K, 4)."""
        self._imu.measure(motion.rotation, motion.velocity_w, motion.angular_w, self._step_s)
        ends_w = self._look(motion, actor_poses)
        if ends_w is not None:
            self._past.push(ends_w)

    def _look(self, motion: Motion, actor_poses: Array) -> Array | None:
        """Scan, if a sensor asks for it; where the beams end (M, n_beams, 3), if the past is asked for."""
        enabled = self._conf.enabled
        if "lidar" not in enabled and "lidar_past" not in enabled:
            return None
        ranges = self._lidar.ranges(motion.position_w, motion.rotation, actor_poses)
        self._scan = self._lidar.segments(ranges)
        if "lidar_past" not in enabled:
            return None
        origin = self._lidar.origin(motion.position_w, motion.rotation)
        return self._lidar.ends(origin, motion.rotation, ranges)

    def observe(self, motion: Motion, goal: Array) -> dict[str, Floats]:
        """The observation, each part (M, n), for `goal` (M, 2): its distance [m] and bearing [rad].

        Asking twice gives the same.
        """
        out: dict[str, Floats] = {}
        for name in self._conf.enabled:
            if name == "lidar":
                out[name] = self._scan.copy()
            elif name == "lidar_past":
                origin = self._lidar.origin(motion.position_w, motion.rotation)
                out[name] = self._past.seen_from(origin, motion.rotation)
            elif name == "imu":
                out[name] = self._imu.reading(motion.rotation, motion.angular_b, motion.roll_pitch_yaw)
            elif name == "goal":
                out[name] = goal.astype(np.float32)
            else:
                out[name] = motion.sensed_velocity()
        return out
