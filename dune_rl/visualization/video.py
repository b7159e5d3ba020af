"""Videos: sensor readings and the state of the episode drawn on frames, and frames written to an MP4 file."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import av
import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dune_rl.core.files import write_atomically

Picture = NDArray[np.uint8]
AddFrame = Callable[[Picture], None]

_PANEL = (14, 18, 24, 170)
_RING, _TEXT = (255, 255, 255, 60), (240, 243, 246, 255)
_RETURN, _GOAL, _AGENT = (255, 196, 61, 255), (64, 214, 122, 255), (240, 243, 246, 255)
_MARGIN = 14


@lru_cache(maxsize=8)
def _font(size: int) -> ImageFont.FreeTypeFont:
    # The font in matplotlib's package, so that every machine draws the same text.
    return ImageFont.truetype(f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans.ttf", size)


def draw_overlays(
    frame: Picture,
    observation: Mapping[str, NDArray[np.generic]],
    lidar: Any,
    lines: list[str],
    headline: str = "",
) -> Picture:
    """`frame` (H, W, 3) with the camera's picture, the scan from above, and text drawn on it.

    `observation` has one agent's readings by name; what it lacks is left out. `lidar` are the settings of its
    LiDAR, if it has one.
    """
    canvas = Image.fromarray(frame).convert("RGBA")
    layer = Image.new("RGBA", canvas.size)
    draw = ImageDraw.Draw(layer)
    width, height = canvas.size
    side = height // 3
    if "camera_rgb" in observation:
        picture = np.asarray(observation["camera_rgb"], np.uint8)
        _draw_picture(layer, picture, width - side - _MARGIN, _MARGIN, side)
    if "lidar" in observation:
        corner = (width - side - _MARGIN, height - side - _MARGIN)
        goal = observation.get("goal")
        _draw_scan(draw, corner, side, np.asarray(observation["lidar"], float), lidar, goal)
    _draw_text(draw, lines, height)
    if headline:
        font = _font(height // 14)
        box = draw.textbbox((0, 0), headline, font=font)
        left, top = (width - box[2]) // 2, height // 7
        draw.rounded_rectangle(
            (left - 18, top - 10, left + box[2] + 18, top + box[3] + 12), radius=10, fill=_PANEL
        )
        draw.text((left, top), headline, font=font, fill=_TEXT)
    return np.asarray(Image.alpha_composite(canvas, layer).convert("RGB"))


def _draw_picture(layer: Image.Image, picture: Picture, left: int, top: int, side: int) -> None:
    height, width = picture.shape[:2]
    size = (side, max(1, round(side * height / width)))
    image = Image.fromarray(picture).resize(size, Image.Resampling.NEAREST).convert("RGBA")
    frame = Image.new("RGBA", (size[0] + 4, size[1] + 4), _TEXT)
    layer.paste(frame, (left - 2, top - 2))
    layer.paste(image, (left, top))


def _draw_scan(
    draw: ImageDraw.ImageDraw,
    corner: tuple[int, int],
    side: int,
    ranges: NDArray[np.floating],
    lidar: Any,
    goal: NDArray[np.generic] | None,
) -> None:
    left, top = corner
    radius = side / 2
    centre = np.array([left + radius, top + radius])
    draw.ellipse((left, top, left + side, top + side), fill=_PANEL)
    for share in (1 / 3, 2 / 3, 1.0):
        r = radius * share
        draw.ellipse((centre[0] - r, centre[1] - r, centre[0] + r, centre[1] + r), outline=_RING)

    range_m = lidar.range_m

    def at(distance: float, bearing: float) -> tuple[float, float]:
        r = min(distance / range_m, 1.0) * radius
        # Ahead is up, left is left.
        return float(centre[0] - r * np.sin(bearing)), float(centre[1] - r * np.cos(bearing))

    fov_rad = np.deg2rad(lidar.fov_deg)
    half = fov_rad / len(ranges) / 2
    for index, distance in enumerate(ranges):
        if distance >= range_m * 0.999:
            continue
        # Segments are ordered counter-clockwise.
        bearing = -fov_rad / 2 + (2 * index + 1) * half
        draw.line(
            [at(float(distance), bearing - half * 0.9), at(float(distance), bearing + half * 0.9)],
            fill=_RETURN,
            width=max(2, side // 50),
        )
    if goal is not None:
        x, y = at(float(goal[0]), float(goal[1]))
        r = max(3, side // 36)
        draw.ellipse((x - r, y - r, x + r, y + r), fill=_GOAL)
    size = max(5, side // 24)
    x, y = centre
    draw.polygon([(x, y - size), (x - size * 0.7, y + size), (x + size * 0.7, y + size)], fill=_AGENT)


def _draw_text(draw: ImageDraw.ImageDraw, lines: list[str], height: int) -> None:
    if not lines:
        return
    font = _font(max(11, height // 30))
    text = "\n".join(lines)
    left, top, right, bottom = draw.multiline_textbbox((_MARGIN + 10, _MARGIN + 8), text, font=font)
    draw.rounded_rectangle((left - 10, top - 8, right + 10, bottom + 8), radius=8, fill=_PANEL)
    draw.multiline_text((_MARGIN + 10, _MARGIN + 8), text, font=font, fill=_TEXT)


@contextmanager
def open_video(path: Path, frames_per_s: float, width: int, height: int) -> Iterator[AddFrame]:
    """Open an MP4 file (H.264); yields a function that adds a frame (height, width, 3).

    The file gets its name when the block ends, and only if it ends without an exception. `width` and `height`
    [px] must be even, since the codec halves the resolution of colours.
    """
    if width % 2 or height % 2:
        raise ValueError(f"a video's width and height must be even (got {width} by {height})")
    with write_atomically(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(frames_per_s).limit_denominator(1000))
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "25", "preset": "medium"}

        def add(frame: Picture) -> None:
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            for packet in stream.encode(picture):
                container.mux(packet)

        yield add
        for packet in stream.encode():
            container.mux(packet)
