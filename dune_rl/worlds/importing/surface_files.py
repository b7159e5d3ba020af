"""Surface maps from files, for imported worlds: PNG or .npy of integers, with a legend."""

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import Field

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import open_image, raise_unreadable, read_bytes
from dune_rl.worlds.importing.height_files import load_npy
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.surface_map import Rectangle, SurfaceMap
from dune_rl.worlds.surfaces import SURFACE_NAMES, SurfaceName

_FORMATS = (".png", ".npy")


class ImportedWorldConf(WorldSettings):
    """File of an imported world, and surface materials of its ground."""

    disk_cached = "world"
    path: str
    surface_map: str | None = Field(
        default=None,
        min_length=1,
        description="a surface's name, or a .png or .npy file of surface numbers over the ground, "
        "first row north; None: uniform friction",
    )
    surface_legend: tuple[SurfaceName, ...] = Field(
        default=SURFACE_NAMES, min_length=1, description="surfaces of the numbers 0, 1, ..."
    )
    sinkage: bool = Field(default=False, description="wheels sink in soft surfaces")


def read_surfaces(conf: ImportedWorldConf, extent: Rectangle) -> SurfaceMap | None:
    """The surface map over `extent`, None if there is none; `WorldError` if it cannot be read."""
    if conf.surface_map is None:
        if conf.sinkage:
            raise WorldError(
                "world.sinkage=true needs a surface material: "
                f"set world.surface_map to a file, or to one of {', '.join(SURFACE_NAMES)}."
            )
        return None
    if conf.surface_map in SURFACE_NAMES:
        numbers = np.array([[SURFACE_NAMES.index(conf.surface_map)]])
        return SurfaceMap(numbers, extent, sinkage=conf.sinkage)
    numbers = _read_numbers(conf.surface_map)
    unknown = np.setdiff1d(numbers, np.arange(len(conf.surface_legend)))
    if len(unknown):
        raise WorldError(
            f"world.surface_map={conf.surface_map} has the number {unknown[0]}, and world.surface_legend "
            f"names the numbers 0 to {len(conf.surface_legend) - 1} ({', '.join(conf.surface_legend)}): "
            "add names, or change the file."
        )
    meaning = np.array([SURFACE_NAMES.index(name) for name in conf.surface_legend], np.uint8)
    # The first row of the file is north, that of the map south.
    return SurfaceMap(meaning[numbers[::-1]], extent, sinkage=conf.sinkage)


def _read_numbers(name: str) -> NDArray[np.integer]:
    path = Path(name).expanduser()
    kind = path.suffix.lower()
    if kind not in _FORMATS or not path.exists():
        fault = "there is no such file" if kind in _FORMATS else "it is neither"
        raise WorldError(
            f"world.surface_map={name} must be one of {', '.join(SURFACE_NAMES)}, "
            f"or a file that ends in {' or '.join(_FORMATS)}: {fault}."
        )
    data = read_bytes(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            numbers = load_npy(data) if kind == ".npy" else _image_numbers(open_image(data))
    except WorldError:
        raise
    except Exception as error:
        raise_unreadable(path.name, "map of surfaces", error)
    whole = numbers.dtype.kind in "iu" or bool((numbers == np.round(numbers)).all())
    if numbers.ndim != 2 or not numbers.size or not whole:
        raise WorldError(
            f"{path.name} holds {numbers.dtype} of shape {numbers.shape}: "
            "a map of surfaces is rows and columns of whole numbers."
        )
    return numbers.astype(np.int64)


def _image_numbers(image: Image.Image) -> NDArray[np.integer]:
    """Values of a grey image, or palette indices of a coloured one."""
    if image.mode not in ("L", "P", "1", "I", "I;16"):
        raise ValueError(f"its pixels are {image.mode} colours; save it as grey or with a palette")
    return np.asarray(image).astype(np.int64)
