"""Signs that a mesh file's unit or up axis is not what was assumed, and the settings to try."""

from collections.abc import Sequence

import numpy as np

from dune_rl.geometry.arrays import Array
from dune_rl.rendering.mesh_files.parts import MeshPart

# Sites beyond these sides are unusual, though there are some.
_LARGE_M, _SMALL_M, _LEAST_SITE_M = 1_500.0, 1.5, 3.0
_SMALLER_UNITS = (("millimetre", 0.001), ("centimetre", 0.01))
# A ground on its side has so many times more area that faces sideways than up, and is so many times higher
# than deep.
_SIDEWAYS, _UPRIGHT = 4.0, 2.0
_FACES = np.cos(np.deg2rad(40.0))


def frame_hints(parts: Sequence[MeshPart], unit_m: float, is_y_up: bool) -> dict[str, str]:
    """What to try, by "unit" and "axis", for `parts` in metres and z up.

    They were read with `unit_m`, and as y up or z up.
    """
    vertices = np.concatenate([part.vertices for part in parts])
    size = np.ptp(vertices, axis=0)
    hints = {"unit": _unit_hint(size, unit_m), "axis": _axis_hint(parts, size, is_y_up)}
    return {about: hint for about, hint in hints.items() if hint}


def has_usual_size(extent: tuple[float, float, float, float]) -> bool:
    """Whether a ground is as large as sites are, though a dome for the sky over it may be larger."""
    return _SMALL_M <= max(extent[1] - extent[0], extent[3] - extent[2]) <= _LARGE_M


def _unit_hint(size: Array, unit_m: float) -> str:
    largest = float(size.max())
    said = f"it is {_metres(size[0])} by {_metres(size[1])} by {_metres(size[2])} m"
    if largest > _LARGE_M:
        units = [
            f"world.unit_m={unit_m * factor:g} if the file's unit is a {name}"
            for name, factor in _SMALLER_UNITS
            if largest * factor > _LEAST_SITE_M
        ]
        return f"{said}: if that is too large, try {', or '.join(units)}"
    if largest < _SMALL_M:
        return f"{said}: if that is too small, try world.unit_m={unit_m * 1000.0:g}"
    return ""


def _metres(length: float) -> str:
    return f"{length:,.0f}" if length >= 10.0 else f"{length:.2g}"


def _axis_hint(parts: Sequence[MeshPart], size: Array, is_y_up: bool) -> str:
    corners = np.concatenate([part.vertices[part.faces] for part in parts])
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(doubled, axis=1)
    facing = np.abs(doubled) > _FACES * length[:, None]
    along = (length[:, None] * facing).sum(axis=0)
    # Sheets that face x have no setting: y or z of the file is up.
    if along[1] <= _SIDEWAYS * max(along[2], along[0]) or size[2] < _UPRIGHT * size[1]:
        return ""
    return f"its faces stand upright, as if it were on its side: try world.up={'z' if is_y_up else 'y'}"
