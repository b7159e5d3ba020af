"""What sensors are built from: the body that carries them, and what there is to be sensed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dune_rl.geometry.batched import BatchedHeightFields, BatchedRayScenes
from dune_rl.rendering.beam_surface import BatchedBeamSurfaces
from dune_rl.rendering.moving_mesh import MovingMesh
from dune_rl.rendering.participating_media import BeamMedia
from dune_rl.sensors.camera import CameraConf, Cameras
from dune_rl.state.sensor_carrier import SensorCarrier


@dataclass(frozen=True)
class SensorContext:
    """What the sensors of one group are built from, for N = M * G rows in M scenes.

    Of each of the M scenes `solid` has the rays through all that is solid and still, `surfaces` its segments
    and brightness, `terrain` the bare ground, and `air` the haze and the grass that beams pass. `meshes` are
    the moving bodies in the order of the columns of `GroupState.neighbours`. Agents of any scene stay in the
    rectangle `extent` (xmin, xmax, ymin, ymax) and between `heights` (zmin, zmax) [m]. `make_cameras` builds
    the cameras of all scenes for given settings. A control step takes `step_s`.
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

    @property
    def diagonal_m(self) -> float:
        """Largest horizontal distance between two points of the extent [m]."""
        xmin, xmax, ymin, ymax = self.extent
        return float(np.hypot(xmax - xmin, ymax - ymin))
