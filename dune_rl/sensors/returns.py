"""Where the beams of LiDARs end in the world, by their readings."""

import numpy as np

from dune_rl.geometry.arrays import Array, Floats
from dune_rl.geometry.frames import rotation_from_yaw
from dune_rl.sensors.beams import fan
from dune_rl.sensors.lidar import LidarConf, ScannerConf, beam_angles
from dune_rl.sensors.lidar_3d import Lidar3dConf
from dune_rl.sensors.sensor import mount_position


def find_returns(
    conf: ScannerConf, ranges: Floats, position_w: Array, rotation: Array
) -> tuple[Array, Array]:
    """Where beams start (3,), and where those end that return, (K, 3), in the world [m].

    `ranges` are the reading of one robot at `position_w` (3,), turned by `rotation` (3, 3): of a planar LiDAR
    (n_segments,), each in the middle of its segment, of one with rings (n_rings, n_beams, 1).
    """
    origin = position_w + rotation @ mount_position(conf.mount_b)
    if isinstance(conf, LidarConf):
        middles = beam_angles(conf).reshape(conf.n_segments, -1).mean(axis=1)
        directions = fan(middles, np.zeros(1))[0]
        if conf.rings_deg:
            # Its ranges are distances in the level plane.
            rotation = rotation_from_yaw(np.arctan2(rotation[1, 0], rotation[0, 0]))
    elif isinstance(conf, Lidar3dConf):
        directions = conf.directions().reshape(-1, 3)
    else:
        raise TypeError(f"{type(conf).__name__} is no LiDAR")
    along = ranges.reshape(-1, 1)
    returns = along[:, 0] < np.float32(conf.range_m)
    return origin, origin + (directions[returns] * along[returns]) @ rotation.T
