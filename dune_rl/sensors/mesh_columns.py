"""Which columns of a group's neighbours have which mesh."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dune_rl.rendering.moving_mesh import MovingMesh


def columns_by_mesh(meshes: Sequence[MovingMesh]) -> list[tuple[MovingMesh, NDArray[np.int64]]]:
    """Each different mesh, with the columns of the bodies that have it."""
    return [(mesh, np.flatnonzero([mesh is other for other in meshes])) for mesh in dict.fromkeys(meshes)]
