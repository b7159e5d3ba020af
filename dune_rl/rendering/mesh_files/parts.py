"""Named, coloured meshes as read from files, with guesses from their names."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dune_rl.core.untrusted_files import ImportReport
from dune_rl.geometry.arrays import Array, Flags, Floats
from dune_rl.rendering.mesh_texture import MeshTexture, join_textures

GREY = (0.6, 0.6, 0.6)

# Colours of objects without a texture, by a word in their names; the first match counts.
_COLOURS: tuple[tuple[str, tuple[float, float, float]], ...] = (
    ("solar", (0.10, 0.16, 0.38)),
    ("water", (0.20, 0.42, 0.55)),
    ("red", (0.55, 0.20, 0.15)),
    ("white", (0.82, 0.81, 0.78)),
    ("wood", (0.50, 0.36, 0.22)),
    ("plank", (0.50, 0.36, 0.22)),
    ("bark", (0.36, 0.27, 0.20)),
    ("leaf", (0.28, 0.38, 0.16)),
    ("tree", (0.28, 0.38, 0.16)),
    ("grass", (0.38, 0.42, 0.22)),
    ("metal", (0.58, 0.59, 0.60)),
    ("steel", (0.58, 0.59, 0.60)),
    ("brick", (0.60, 0.36, 0.28)),
    ("concrete", (0.66, 0.65, 0.62)),
    ("rock", (0.52, 0.49, 0.45)),
    ("sand", (0.76, 0.68, 0.52)),
)
_WATER = {"water", "lake", "pond", "river", "sea", "ocean"}
# Words of names that say nothing about the kind of an object.
_MEANINGLESS = {
    *("cube", "plane", "mesh", "object", "node", "geometry", "gltf", "cylinder", "sphere", "cone", "group"),
    *("default", "obj", "material", "mat", "part", "shape", "empty", "scene", "root", "model", "link"),
    *("collision", "visual", "box", "polysurface", "defaultobject", "geom", "untitled", "world"),
    *("stl", "ply", "glb", "dae", "thing", "unit", "static", "body", "base"),
}  # fmt: skip
# Upright objects that are thinner than this are walls.
_WALL_M = 0.5
# Sites beyond these sides are unusual, though there are some.
_LARGE_M, _SMALL_M, _LEAST_SITE_M = 1_500.0, 1.5, 3.0
_SMALLER_UNITS = (("millimetre", 0.001), ("centimetre", 0.01))
# A ground on its side has so many times more area that faces sideways than up, and is so many times higher
# than deep.
_SIDEWAYS, _UPRIGHT = 4.0, 2.0
_FACES = np.cos(np.deg2rad(40.0))


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Triangles of one object in a file: `vertices` (V, 3) [m], `faces` (F, 3), `colours` (F, 3) in sRGB.

    `about` has further words about it, such as its material. `ground` says whether it is ground, None if
    that is to be determined. A part that is not `solid` is only visible, and a `drivable` one is a deck above
    the ground.
    """

    name: str
    vertices: Array
    faces: NDArray[np.int32]
    colours: Floats
    about: str = ""
    ground: bool | None = None
    solid: bool = True
    texture: MeshTexture | None = None
    drivable: bool = False

    @classmethod
    def from_triangles(
        cls,
        name: str,
        vertices: ArrayLike,
        faces: ArrayLike,
        colours: ArrayLike | None = None,
        about: str = "",
        *,
        ground: bool | None = None,
        solid: bool = True,
        texture: MeshTexture | None = None,
    ) -> "MeshPart":
        """A part; `colours` is (3,) for all faces, (F, 3), or None for a guess from the name."""
        corners = np.asarray(faces, np.int32).reshape(-1, 3)
        rgb = guess_colour(f"{name} {about}") if colours is None else colours
        each = np.broadcast_to(np.clip(np.asarray(rgb, np.float32), 0.0, 1.0), (len(corners), 3))
        points = np.asarray(vertices, np.float64).reshape(-1, 3)
        return cls(name, points, corners, np.ascontiguousarray(each), about, ground, solid, texture)

    def transform(self, matrix: Array) -> "MeshPart":
        """The part transformed by `matrix` (4, 4); the faces of a mirrored part are reversed."""
        if np.array_equal(matrix, np.eye(4)):
            return self
        vertices = self.vertices @ matrix[:3, :3].T + matrix[:3, 3]
        faces = self.faces[:, ::-1].copy() if np.linalg.det(matrix[:3, :3]) < 0 else self.faces
        texture = None if self.texture is None else self.texture.transform(matrix)
        return replace(self, vertices=vertices, faces=faces, texture=texture)

    def select_faces(self, faces: NDArray[Any]) -> "MeshPart":
        """Some faces, given by indices or a mask, and the vertices that they use."""
        # Unused vertices may be NaN, or far away.
        used, index = np.unique(self.faces[faces], return_inverse=True)
        return replace(
            self,
            vertices=self.vertices[used],
            faces=index.reshape(-1, 3).astype(np.int32),
            colours=self.colours[faces],
            texture=None if self.texture is None else self.texture.select_faces(faces),
        )

    @property
    def is_named_water(self) -> bool:
        return not _WATER.isdisjoint(_words(f"{self.name} {self.about}"))

    @property
    def kind(self) -> str:
        """One or two words for its kind, from its name or `about`; "wall" or "obstacle" by its shape if these
        say nothing.
        """
        for text in (self.name, self.about):
            words = [w for w in dict.fromkeys(_words(text)) if w not in _MEANINGLESS and len(w) > 1]
            if words:
                return " ".join(words[:2])
        if len(self.vertices) < 3:
            return "obstacle"
        across = self.vertices[:, :2] - self.vertices[:, :2].mean(axis=0)
        length, width = np.ptp(across @ np.linalg.svd(across, full_matrices=False)[2].T, axis=0)
        is_wall = width < _WALL_M and length > 3.0 * width and np.ptp(self.vertices[:, 2]) > width
        return "wall" if is_wall else "obstacle"


def guess_colour(text: str) -> tuple[float, float, float]:
    """A guess at the colour (sRGB) of an object from its name; grey without a known word."""
    low = text.lower()
    return next((colour for word, colour in _COLOURS if word in low), GREY)


def drop_faulty_triangles(parts: Sequence[MeshPart], report: ImportReport) -> list[MeshPart]:
    """The parts without triangles of no area or with invalid vertices, which are reported."""
    valid: list[MeshPart] = []
    for part in parts:
        inside = np.all((part.faces >= 0) & (part.faces < len(part.vertices)), axis=1)
        good: Flags = np.array(inside, bool)
        if inside.any():
            corners = part.vertices[part.faces[inside]]
            with np.errstate(all="ignore"):
                doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
                # Embree and the engines use single precision.
                finite = (np.abs(corners) < 1e7).all(axis=(1, 2)) & np.isfinite(doubled).all(axis=1)
                good[inside] = finite & (np.abs(doubled).max(axis=1) > 1e-12)
            if not finite.all():
                report.warn("has vertices that are NaN or infinite; the triangles with them are left out")
        if not inside.all():
            report.warn("has triangles whose vertices do not exist; they are left out")
        if good.any():
            valid.append(part.select_faces(good))
    return valid


def join_parts(parts: Sequence[MeshPart]) -> MeshPart:
    """The triangles of `parts` as one part, which is otherwise like the first."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return replace(
        parts[0],
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + s for part, s in zip(parts, starts, strict=True)], dtype=np.int32),
        colours=np.concatenate([part.colours for part in parts]),
        texture=join_textures([part.texture for part in parts], [len(part.faces) for part in parts]),
    )


def mean_face_colours(image: NDArray[np.uint8], uv: Array) -> Floats:
    """Mean colours (F, 3) of triangles with `uv` (F, 3, 2), from the lower left, in an image."""
    rows, columns = image.shape[:2]
    # All samples are inside the triangle, or the opposite edge of the image would show at seams.
    weights = np.array([[8, 2, 2], [2, 8, 2], [2, 2, 8], [4, 4, 4], [5, 5, 2], [2, 5, 5], [5, 2, 5]]) / 12.0
    uv = np.nan_to_num(uv, nan=0.0, posinf=0.0, neginf=0.0)
    at = np.einsum("pc,fcx->fpx", weights, uv)
    at -= np.floor(at)
    column = np.minimum((at[..., 0] * columns).astype(np.intp), columns - 1)
    row = np.minimum(((1.0 - at[..., 1]) * rows).astype(np.intp), rows - 1)
    colours = image[row, column].mean(axis=1)
    # A triangle that repeats the image has the mean of the image, not that of a few texels.
    tiled = np.ptp(uv, axis=1).prod(axis=1) > 0.5
    colours[tiled] = image.mean(axis=(0, 1))
    return colours.astype(np.float32) / np.float32(255.0)


def _words(text: str) -> list[str]:
    split = re.sub(r"([a-z])([A-Z])", r"\1 \2", text)
    return [word for word in re.split(r"[^a-z]+", split.lower()) if word]


def frame_hints(parts: Sequence[MeshPart], unit_m: float, is_y_up: bool) -> dict[str, str]:
    """What to try, by "unit" and "axis", for `parts` in metres and z up.

    They were read with `unit_m`, and as y up or z up.
    """
    size = np.ptp(np.concatenate([part.vertices for part in parts]), axis=0)
    hints = {"unit": _unit_hint(size, unit_m), "axis": _axis_hint(parts, size, is_y_up)}
    return {about: hint for about, hint in hints.items() if hint}


def has_usual_size(extent: tuple[float, float, float, float]) -> bool:
    """Whether a ground is as large as sites are, though a dome for the sky over it may be larger."""
    return _SMALL_M <= max(extent[1] - extent[0], extent[3] - extent[2]) <= _LARGE_M


def _unit_hint(size: Array, unit_m: float) -> str:
    largest = float(size.max())
    sides = " by ".join(f"{side:,.0f}" if side >= 10.0 else f"{side:.2g}" for side in size)
    said = f"it is {sides} m"
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
