"""Whether a world is sound, as one that a user's code has made may not be."""

import warnings

import numpy as np

from dune_rl.errors import WorldError
from dune_rl.worlds.importing.import_files import WorldWarning
from dune_rl.worlds.importing.topology import joined_faces, open_edges, weld_vertices
from dune_rl.worlds.world import Prop, World


def check_world(world: World) -> None:
    """Raise `WorldError` with a line for each thing that cannot be.

    Warns (`WorldWarning`) of solid props that are not closed, or inside out:
    rays and wheels may pass them.
    """
    faults = [*_figures(world), *(fault for prop in world.props for fault in _mesh_faults(prop))]
    if faults:
        raise WorldError("\n".join(f"the world {world.name!r}: {fault}" for fault in faults))
    for prop in world.props:
        weakness = _weakness(prop) if prop.solid else None
        if weakness is not None:
            warnings.warn(f"the world {world.name!r}: {weakness}", WorldWarning, stacklevel=2)


def _figures(world: World) -> list[str]:
    found = []
    region, extent = np.asarray(world.region, dtype=np.float64), np.asarray(world.extent)
    if region.shape != (4,) or not (region[0] < region[1] and region[2] < region[3]):
        found.append(f"region must be (xmin, xmax, ymin, ymax) with min < max, not {world.region}")
    elif (region[[0, 2]] < extent[[0, 2]]).any() or (region[[1, 3]] > extent[[1, 3]]).any():
        found.append(
            f"region {_rectangle(region)} reaches outside the terrain, which covers {_rectangle(extent)}"
        )
    if not 0.0 < world.friction <= 5.0:
        found.append(f"friction must be above 0 and at most 5, not {world.friction}")
    return found


def _mesh_faults(prop: Prop) -> list[str]:
    vertices, faces, who = prop.vertices, prop.faces, f"prop {prop.name!r}"
    if not (isinstance(vertices, np.ndarray) and isinstance(faces, np.ndarray)):
        return [f"{who}: vertices and faces must be NumPy arrays"]
    found = []
    if vertices.ndim != 2 or vertices.shape[1] != 3 or vertices.dtype.kind != "f":
        found.append(
            f"{who}: vertices must be floats of shape (V, 3), not {vertices.dtype} of {vertices.shape}"
        )
    elif not np.isfinite(vertices).all():
        found.append(f"{who}: vertices must be finite")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu" or not len(faces):
        found.append(
            f"{who}: faces must be integers of shape (F, 3), F > 0, not {faces.dtype} of {faces.shape}"
        )
    elif faces.min() < 0 or faces.max() >= len(vertices):
        found.append(
            f"{who}: faces must name vertices 0 to {len(vertices) - 1}, not {faces.min()} to {faces.max()}"
        )
    colour = np.asarray(prop.colour, dtype=np.float64)
    if colour.shape != (3,) or not ((colour >= 0.0) & (colour <= 1.0)).all():
        found.append(f"{who}: colour must be three numbers from 0 to 1, not {prop.colour}")
    return found


def _weakness(prop: Prop) -> str | None:
    ids = weld_vertices(prop.vertices, prop.faces)
    _, index, ids = np.unique(ids, return_index=True, return_inverse=True)
    ids = ids.reshape(-1, 3)
    gaps = len(open_edges(ids)[0])
    if gaps:
        return (
            f"the solid prop {prop.name!r} is not closed ({gaps} edges have one face only), so that rays and "
            "wheels may pass it: close its mesh, or set solid=False"
        )
    points = prop.vertices[prop.faces.reshape(-1)[index]]
    a, b, c = np.moveaxis(points[ids] - points.mean(axis=0), 1, 0)
    volumes = np.bincount(joined_faces(ids), np.einsum("ij,ij->i", a, np.cross(b, c)))
    if (volumes < 0).any():
        return (
            f"the solid prop {prop.name!r} is inside out: its faces must run counter-clockwise seen from "
            "outside, so turn them round (faces[:, ::-1])"
        )
    return None


def _rectangle(sides: np.ndarray) -> str:
    return "({:g}, {:g}, {:g}, {:g})".format(*sides)
