"""Validation of worlds built by users' code."""

import warnings

import numpy as np

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import WorldWarning
from dune_rl.worlds.importing.topology import (
    label_face_components,
    open_edges,
    renumber_welded,
    signed_volumes,
)
from dune_rl.worlds.world import Prop, World


def check_world(world: World) -> None:
    """Raise `WorldError` with one line per fault.

    Issues a `WorldWarning` for each solid prop that is not closed or is inside
    out, since rays and wheels may pass through it.
    """
    faults = [*_world_faults(world), *(fault for prop in world.props for fault in _prop_faults(prop))]
    if faults:
        raise WorldError("\n".join(f"the world {world.name!r}: {fault}" for fault in faults))
    for leak in (_describe_leak(prop) for prop in world.props if prop.solid):
        if leak is not None:
            warnings.warn(f"the world {world.name!r}: {leak}", WorldWarning, stacklevel=2)


def _world_faults(world: World) -> list[str]:
    faults = []
    region, extent = np.asarray(world.region, dtype=np.float64), np.asarray(world.extent)
    if region.shape != (4,) or not (region[0] < region[1] and region[2] < region[3]):
        faults.append(f"region must be (xmin, xmax, ymin, ymax) with min < max, not {world.region}")
    elif (region[[0, 2]] < extent[[0, 2]]).any() or (region[[1, 3]] > extent[[1, 3]]).any():
        inner, outer = ("({:g}, {:g}, {:g}, {:g})".format(*sides) for sides in (region, extent))
        faults.append(f"region {inner} reaches outside the terrain, which covers {outer}")
    if not 0.0 < world.friction <= 5.0:
        faults.append(f"friction must be above 0 and at most 5, not {world.friction}")
    return faults


def _prop_faults(prop: Prop) -> list[str]:
    vertices, faces, who = prop.vertices, prop.faces, f"prop {prop.name!r}"
    if not (isinstance(vertices, np.ndarray) and isinstance(faces, np.ndarray)):
        return [f"{who}: vertices and faces must be NumPy arrays"]
    faults = []
    if vertices.ndim != 2 or vertices.shape[1] != 3 or vertices.dtype.kind != "f":
        given = f"{vertices.dtype} of {vertices.shape}"
        faults.append(f"{who}: vertices must be floats of shape (V, 3), not {given}")
    elif not np.isfinite(vertices).all():
        faults.append(f"{who}: vertices must be finite")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu" or not len(faces):
        given = f"{faces.dtype} of {faces.shape}"
        faults.append(f"{who}: faces must be integers of shape (F, 3), F > 0, not {given}")
    elif faces.min() < 0 or faces.max() >= len(vertices):
        given = f"{faces.min()} to {faces.max()}"
        faults.append(f"{who}: faces must index vertices 0 to {len(vertices) - 1}, not {given}")
    colour = np.asarray(prop.colour, dtype=np.float64)
    if colour.shape != (3,) or not ((colour >= 0.0) & (colour <= 1.0)).all():
        faults.append(f"{who}: colour must be three numbers from 0 to 1, not {prop.colour}")
    return faults


def _describe_leak(prop: Prop) -> str | None:
    ids, index = renumber_welded(prop.vertices, prop.faces)
    gaps = len(open_edges(ids)[0])
    if gaps:
        return (
            f"the solid prop {prop.name!r} is not closed ({gaps} edges have one face only), so rays and "
            "wheels may pass through it: close its mesh, or set solid=False"
        )
    volumes = signed_volumes(prop.vertices[index], ids)
    if (np.bincount(label_face_components(ids), volumes) < 0).any():
        return (
            f"the solid prop {prop.name!r} is inside out: its faces must run counter-clockwise seen from "
            "outside, so reverse them (faces[:, ::-1])"
        )
    return None
