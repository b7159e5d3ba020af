"""Files of heights: GeoTIFF and other TIFF, PNG and other grey pictures, and .npy arrays."""

import io
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from dune_rl.errors import WorldError
from dune_rl.worlds.importing.untrusted_files import (
    ImportReport,
    first_line,
    open_image,
    raise_unreadable,
    read_bytes,
)

Array = NDArray[np.float64]

FORMATS = (".tif", ".tiff", ".png", ".npy")

_MAX_SAMPLES = 64_000_000
_PIXEL_SCALE_TAG, _GDAL_NODATA_TAG, _GEO_KEYS_TAG = 33550, 42113, 34735
_GT_MODEL_TYPE, _PROJECTED = 1024, 1
# What surveys write where they know nothing, beside what a file says itself.
_NO_DATA_BELOW, _NO_DATA_ABOVE = -1e5, 1e5


class HeightSamples(NamedTuple):
    """Samples (rows, columns), the first row farthest north; NaN where there is none.

    `metric` is whether they are metres; else they are brightness in [0, 1]. `pixel_m` is the size of a sample
    along x and y [m], None where the file does not say.
    """

    samples: Array
    metric: bool
    pixel_m: tuple[float, float] | None


def read_heights(path: Path, report: ImportReport) -> HeightSamples:
    """The heights in a file, of a kind told by its ending; `WorldError` where there are none to be read."""
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
                found = HeightSamples(load_npy(data), True, None)
            elif kind == ".png":
                found = _picture(data, report)
            else:
                found = _tiff(data, report)
    except WorldError:
        raise
    except Exception as error:
        raise_unreadable(path.name, "height map", error)
    samples = np.where(np.isfinite(found.samples), found.samples, np.nan)
    if samples.ndim != 2 or min(samples.shape) < 2:
        raise WorldError(
            f"{path.name} has samples of shape {samples.shape}: heights are rows and columns, 2 or more."
        )
    if found.metric:
        samples = np.where((samples > _NO_DATA_BELOW) & (samples < _NO_DATA_ABOVE), samples, np.nan)
    if np.isnan(samples).all():
        raise WorldError(f"{path.name} has no sample with a height: export it again.")
    return found._replace(samples=samples)


def load_npy(data: bytes) -> Array:
    """The numbers in an .npy file, of bounded size; `ValueError` where it holds none."""
    # The header is read first, since an array may claim any size; pickles are code and never read.
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


def _picture(data: bytes, report: ImportReport) -> HeightSamples:
    image = open_image(data)
    _check_size(image.size)
    return HeightSamples(_grey(image, report), False, None)


def _grey(image: Image.Image, report: ImportReport) -> Array:
    if image.mode in ("I;16", "I;16B", "I;16L", "I"):
        return np.asarray(image, np.float64) / 65535.0
    if image.mode not in ("L", "1"):
        report.warn("is a colour picture; its brightness is taken for the height")
    elif image.mode == "L":
        report.warn("has 8 bits a sample: heights are steps of 1/255 of the relief; a 16-bit PNG is smoother")
    return np.asarray(image.convert("L"), np.float64) / 255.0


def _tiff(data: bytes, report: ImportReport) -> HeightSamples:
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        if not len(file.pages):
            raise ValueError("it has no picture")
        page = file.pages.first
        _check_size(page.shape)
        if page.compression not in (tifffile.COMPRESSION.NONE,):
            samples = _compressed(data, page)
        else:
            # What the header claims must be in the file.
            if int(np.prod(page.shape)) * np.dtype(page.dtype).itemsize > len(data) + 1024:
                raise ValueError(f"it claims {page.shape} samples and is too short for them")
            samples = page.asarray()
        if samples.ndim == 3:
            report.warn("has several bands; the first is taken for the height")
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
            report.warn(f"says that {first_line(missing)!r} stands for no height, which is no number")
    metric = samples.dtype.kind == "f" or samples.dtype.itemsize > 2 or scale is not None
    if not metric:
        heights /= 255.0 if samples.dtype.itemsize == 1 else 65535.0
    pixel = None
    if scale is not None and len(scale) >= 2 and scale[0] > 0 and scale[1] > 0 and not in_degrees:
        pixel = (float(scale[0]), float(scale[1]))
    return HeightSamples(heights, metric, pixel)


def _compressed(data: bytes, page: tifffile.TiffPage) -> NDArray[np.generic]:
    # Common compressions need a codec package; Pillow has those of pictures, and deflate needs none.
    try:
        return np.asarray(page.asarray())
    except Exception:
        return np.asarray(open_image(data))


def _is_in_degrees(keys: tuple[int, ...] | None) -> bool:
    # A directory of four numbers a key, after four of its own.
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
