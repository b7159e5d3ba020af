"""Files of grids: heights (GeoTIFF and other TIFF, PNG, .npy), and numbers of surfaces (PNG, .npy)."""

import io
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from dune_rl.core.errors import WorldError
from dune_rl.core.untrusted_files import ImportReport, first_line, load_npy, open_image, read_bytes, reading
from dune_rl.geometry.arrays import Array

HEIGHT_FORMATS, SURFACE_FORMATS = (".tif", ".tiff", ".png", ".npy"), (".png", ".npy")

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
    pixel_m: tuple[float, float] | None = None


def read_heights(path: Path, report: ImportReport) -> HeightSamples:
    """The heights in a file, whose format follows from its extension; `WorldError` if it has none."""
    kind = path.suffix.lower()
    if kind not in HEIGHT_FORMATS:
        known = ", ".join(HEIGHT_FORMATS)
        raise WorldError(f"{path} has the ending {kind or '(none)'}; heights are read from {known}.")
    data = read_bytes(path)
    with reading(path.name, "height map"):
        if kind == ".npy":
            heights = HeightSamples(_load_npy(data), metric=True)
        elif kind == ".png":
            image = open_image(data)
            _check_size(image.size)
            heights = HeightSamples(_read_brightness(image, report), metric=False)
        else:
            heights = _read_tiff(data, report)
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


def read_surface_numbers(path: Path) -> NDArray[np.int64]:
    """The whole numbers (rows, columns) in a file: values of grey, palette indices, or those of an array."""
    data = read_bytes(path)
    with reading(path.name, "map of surfaces"):
        if path.suffix.lower() == ".npy":
            numbers = _load_npy(data)
        else:
            image = open_image(data)
            if image.mode not in ("L", "P", "1", "I", "I;16"):
                raise ValueError(f"its pixels are {image.mode} colours; save it as grey or with a palette")
            numbers = np.asarray(image).astype(np.int64)
    if numbers.ndim != 2 or not numbers.size or not (numbers == np.round(numbers)).all():
        raise WorldError(
            f"{path.name} holds {numbers.dtype} of shape {numbers.shape}: "
            "a map of surfaces is rows and columns of whole numbers."
        )
    return numbers.astype(np.int64)


def _load_npy(data: bytes) -> Array:
    """The numbers in an .npy file of limited size; `ValueError` if it has none."""
    numbers = load_npy(data)
    _check_size(numbers.shape)
    return numbers.astype(np.float64)


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
        # The file must have the samples that its header claims.
        is_plain = page.compression == tifffile.COMPRESSION.NONE
        if is_plain and int(np.prod(page.shape)) * np.dtype(page.dtype).itemsize > len(data) + 1024:
            raise ValueError(f"it claims {page.shape} samples, but is too short for them")
        try:
            samples = np.asarray(page.asarray())
        except Exception:
            if is_plain:
                raise
            # tifffile needs a further package for most compressions; Pillow supports those of images.
            samples = np.asarray(open_image(data))
        if samples.ndim == 3:
            report.warn("has several bands; the first is used as height")
            samples = samples[..., 0] if page.planarconfig == 1 else samples[0]
        tags = page.tags
        scale = tags[_PIXEL_SCALE_TAG].value if _PIXEL_SCALE_TAG in tags else None
        missing = str(tags[_GDAL_NODATA_TAG].value).strip("\0 ") if _GDAL_NODATA_TAG in tags else ""
        keys = tags[_GEO_KEYS_TAG].value if _GEO_KEYS_TAG in tags else ()
    heights = np.asarray(samples, np.float64)
    try:
        heights = np.where(heights == float(missing), np.nan, heights)
    except ValueError:
        if missing:
            report.warn(f"has the marker {first_line(missing)!r} for missing heights, which is no number")
    metric = samples.dtype.kind == "f" or samples.dtype.itemsize > 2 or scale is not None
    if not metric:
        heights /= 255.0 if samples.dtype.itemsize == 1 else 65535.0
    # A directory with a header of four numbers and four numbers per key.
    entries = [keys[k : k + 4] for k in range(4, len(keys) - 3, 4)]
    in_degrees = any(entry[0] == _GT_MODEL_TYPE and entry[3] != _PROJECTED for entry in entries)
    pixel = None
    if scale is not None and len(scale) >= 2 and scale[0] > 0 and scale[1] > 0 and not in_degrees:
        pixel = (float(scale[0]), float(scale[1]))
    return HeightSamples(heights, metric, pixel)


def _check_size(shape: tuple[int, ...]) -> None:
    count = math.prod(map(int, shape))
    if count > _MAX_SAMPLES:
        raise WorldError(
            f"the file has {count:,} samples, and at most {_MAX_SAMPLES:,} are read: make it coarser."
        )
