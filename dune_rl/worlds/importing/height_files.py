"""Files of heights: GeoTIFF and other TIFF, PNG, and .npy arrays."""

import io
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import (
    ImportReport,
    first_line,
    open_image,
    raise_unreadable,
    read_bytes,
)
from dune_rl.geometry.arrays import Array

FORMATS = (".tif", ".tiff", ".png", ".npy")

_MAX_SAMPLES = 64_000_000
_PIXEL_SCALE_TAG, _GDAL_NODATA_TAG, _GEO_KEYS_TAG = 33550, 42113, 34735
_GT_MODEL_TYPE, _PROJECTED = 1024, 1
# Values outside these limits mark missing heights, in addition to the file's own marker.
_NO_DATA_BELOW, _NO_DATA_ABOVE = -1e5, 1e5


class HeightSamples(NamedTuple):
    """Samples (rows, columns), the first row farthest north; NaN for missing heights.

    If `metric`, they are metres, else brightness in [0, 1]. `pixel_m` is the spacing of samples along x and y
    [m], None if the file does not contain it.
    """

    samples: Array
    metric: bool
    pixel_m: tuple[float, float] | None


def read_heights(path: Path, report: ImportReport) -> HeightSamples:
    """The heights in a file, whose format follows from its extension; `WorldError` if it has none."""
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise WorldError(
            f"{path} has the ending {kind or '(none)'}; heights are read from {', '.join(FORMATS)}."
        )
    data = read_bytes(path)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            if kind == ".npy":
                heights = HeightSamples(load_npy(data), True, None)
            elif kind == ".png":
                heights = _read_png(data, report)
            else:
                heights = _read_tiff(data, report)
    except WorldError:
        raise
    except Exception as error:
        raise_unreadable(path.name, "height map", error)
    samples = np.where(np.isfinite(heights.samples), heights.samples, np.nan)
    if samples.ndim != 2 or min(samples.shape) < 2:
        raise WorldError(
            f"{path.name} has samples of shape {samples.shape}: heights are rows and columns, 2 or more."
        )
    if heights.metric:
        samples = np.where((samples > _NO_DATA_BELOW) & (samples < _NO_DATA_ABOVE), samples, np.nan)
    if np.isnan(samples).all():
        raise WorldError(f"{path.name} has no sample with a height: export it again.")
    return heights._replace(samples=samples)


def load_npy(data: bytes) -> Array:
    """The numbers in an .npy file of limited size; `ValueError` if it has none."""
    # The header is checked first, since it may claim any size. Pickles, which are code, are not read.
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    read_header = (
        np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read_header(file)
    if dtype.kind not in "fiu":
        raise ValueError(f"its values are {dtype}, not numbers")
    _check_size(shape)
    file.seek(0)
    return np.asarray(np.load(file, allow_pickle=False), np.float64)


def _read_png(data: bytes, report: ImportReport) -> HeightSamples:
    image = open_image(data)
    _check_size(image.size)
    return HeightSamples(_read_brightness(image, report), False, None)


def _read_brightness(image: Image.Image, report: ImportReport) -> Array:
    if image.mode in ("I;16", "I;16B", "I;16L", "I"):
        return np.asarray(image, np.float64) / 65535.0
    if image.mode not in ("L", "1"):
        report.warn("is a colour image; its brightness is used as height")
    elif image.mode == "L":
        report.warn("has 8 bits per sample: heights are steps of 1/255 of the relief; use 16 bits instead")
    return np.asarray(image.convert("L"), np.float64) / 255.0


def _read_tiff(data: bytes, report: ImportReport) -> HeightSamples:
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        if not len(file.pages):
            raise ValueError("it has no image")
        page = file.pages.first
        _check_size(page.shape)
        if page.compression not in (tifffile.COMPRESSION.NONE,):
            samples = _decompress(data, page)
        else:
            # The file must have the samples that its header claims.
            if int(np.prod(page.shape)) * np.dtype(page.dtype).itemsize > len(data) + 1024:
                raise ValueError(f"it claims {page.shape} samples, but is too short for them")
            samples = page.asarray()
        if samples.ndim == 3:
            report.warn("has several bands; the first is used as height")
            samples = samples[..., 0] if page.planarconfig == 1 else samples[0]
        tags = page.tags
        scale = tags[_PIXEL_SCALE_TAG].value if _PIXEL_SCALE_TAG in tags else None
        missing = str(tags[_GDAL_NODATA_TAG].value).strip("\0 ") if _GDAL_NODATA_TAG in tags else ""
        in_degrees = _is_in_degrees(tags[_GEO_KEYS_TAG].value if _GEO_KEYS_TAG in tags else None)
    heights = np.asarray(samples, np.float64)
    try:
        heights = np.where(heights == float(missing), np.nan, heights)
    except ValueError:
        if missing:
            report.warn(f"has the marker {first_line(missing)!r} for missing heights, which is no number")
    metric = samples.dtype.kind == "f" or samples.dtype.itemsize > 2 or scale is not None
    if not metric:
        heights /= 255.0 if samples.dtype.itemsize == 1 else 65535.0
    pixel = None
    if scale is not None and len(scale) >= 2 and scale[0] > 0 and scale[1] > 0 and not in_degrees:
        pixel = (float(scale[0]), float(scale[1]))
    return HeightSamples(heights, metric, pixel)


def _decompress(data: bytes, page: tifffile.TiffPage) -> NDArray[np.generic]:
    # tifffile needs a further package for most compressions; Pillow supports those of images.
    try:
        return np.asarray(page.asarray())
    except Exception:
        return np.asarray(open_image(data))


def _is_in_degrees(keys: tuple[int, ...] | None) -> bool:
    # A directory with a header of four numbers and four numbers per key.
    if keys is None:
        return False
    entries = [tuple(keys[k : k + 4]) for k in range(4, len(keys) - 3, 4)]
    return any(entry[0] == _GT_MODEL_TYPE and entry[3] != _PROJECTED for entry in entries)


def _check_size(shape: tuple[int, ...]) -> None:
    count = 1
    for side in shape:
        count *= int(side)
    if count > _MAX_SAMPLES:
        raise WorldError(
            f"the file has {count:,} samples, and at most {_MAX_SAMPLES:,} are read: make it coarser."
        )
