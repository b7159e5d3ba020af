"""Frames of films: a large picture, and beside it a column of what the robot's sensors read and a map."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

# The widest of the usual values beside names.
_WIDEST = "00.00 m/s"
# Share of the width that the column takes.
_COLUMN = 0.3
_BACKGROUND, _PANEL, _RING = (14, 18, 24), (24, 30, 38), (62, 70, 80)
_TEXT, _RETURN, _GOAL, _AGENT = (240, 243, 246), (255, 196, 61), (64, 214, 122), (240, 243, 246)


@lru_cache(maxsize=8)
def _font(size: int) -> ImageFont.FreeTypeFont:
    # The font in matplotlib's package, and Pillow's own layout, so that every machine draws the same text.
    file = f"{matplotlib.get_data_path()}/fonts/ttf/DejaVuSans.ttf"
    return ImageFont.truetype(file, size, layout_engine=ImageFont.Layout.BASIC)


class FilmFrame:
    """The layout of a film's frames of `width` by `height` [px], with the `panels` of the column by title."""

    def __init__(self, width: int, height: int, panels: Sequence[str]) -> None:
        self._empty = np.full((height, width, 3), _BACKGROUND, np.uint8)
        column = round(_COLUMN * width) if panels else 0
        self.picture_size = width - column, height
        self._small, self._large = max(9, height // 54), max(9, height // 36)
        edges = np.linspace(0, height, len(panels) + 1).round().astype(int).tolist()
        self._boxes: dict[str, tuple[int, int, int, int]] = {}
        for title, top, bottom in zip(panels, edges[:-1], edges[1:], strict=True):
            left = width - column + max(1, height // 180)
            _write(self._empty, (left, top), [title], self._small)
            self._boxes[title] = left, min(top + 2 * self._small, bottom - 1), width, bottom

    def panel_size(self, title: str) -> tuple[int, int]:
        """Width and height [px] of a panel's picture."""
        left, top, right, bottom = self._boxes[title]
        return right - left, bottom - top

    def compose(
        self,
        picture: Picture,
        panels: Mapping[str, Picture],
        state: Sequence[tuple[str, str]] = (),
        headline: str = "",
    ) -> Picture:
        """The frame (height, width, 3): `picture` of `picture_size`, `panels` by title, each of its size,
        and upon the picture the names and values of a `state` and a `headline`.
        """
        frame = self._empty.copy()
        frame[:, : self.picture_size[0]] = picture
        for title, (left, top, right, bottom) in self._boxes.items():
            frame[top:bottom, left:right] = panels[title]
        if state:
            names, values = zip(*state, strict=True)
            _write(frame, (self._large, self._large), names, self._large, values)
        if headline:
            # As subtitles are: over the ground, where nobody's head is.
            middle = self.picture_size[0] // 2, len(frame) - 5 * self._large
            _write(frame, middle, [headline], 2 * self._large, share=0.5)
        return frame


def _write(
    frame: Picture,
    corner: tuple[int, int],
    lines: Sequence[str],
    size: int,
    values: Sequence[str] = (),
    *,
    share: float = 0.0,
) -> None:
    """Write `lines` on a darkened part of a frame at `corner` (left, top), moved left by a `share` of it.

    `values` stand in a column of their own, flush right.
    """
    text, pad, font = "\n".join(lines), size // 2, _font(size)
    ruler = ImageDraw.Draw(Image.new("RGB", (1, 1)))
    left, top, right, bottom = ruler.multiline_textbbox((0, 0), text, font=font)
    # So wide that it stays as it is while numbers change.
    column = max([font.getlength(value) for value in (_WIDEST, *values)]) + size if values else 0.0
    width, height = int(right - left + column) + 2 * pad, int(bottom - top) + 2 * pad
    x = max(0, corner[0] - round(share * width))
    part = frame[corner[1] : corner[1] + height, x : x + width]
    if not part.size:
        return
    image = Image.fromarray(part // 4 + np.array(_BACKGROUND, np.uint8) // 2)
    draw = ImageDraw.Draw(image)
    draw.multiline_text((pad - left, pad - top), text, font=font, fill=_TEXT)
    draw.multiline_text(
        (width - pad, pad - top), "\n".join(values), font=font, fill=_TEXT, anchor="ra", align="right"
    )
    part[:] = np.asarray(image)


def fit_picture(picture: Picture, size: tuple[int, int]) -> Picture:
    """A picture (H, W, 3), enlarged to the panel's `size` (width, height) without smoothing."""
    scale = min(size[0] / picture.shape[1], size[1] / picture.shape[0])
    shown = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
    canvas = Image.new("RGB", size, _PANEL)
    enlarged = Image.fromarray(picture).resize(shown, Image.Resampling.NEAREST)
    canvas.paste(enlarged, ((size[0] - shown[0]) // 2, (size[1] - shown[1]) // 2))
    return np.asarray(canvas)


def draw_scan(
    ranges: NDArray[np.floating], lidar: Any, goal: NDArray[np.generic] | None, size: tuple[int, int]
) -> Picture:
    """A scan from above, in a panel of `size` (width, height): ahead is up.

    `ranges` (S,) [m] are the segments of a LiDAR of the settings `lidar`, `goal` (2,) is the distance [m] and
    relative bearing [rad] of the goal.
    """
    image = Image.new("RGB", size, _PANEL)
    draw = ImageDraw.Draw(image)
    radius = 0.47 * min(size)
    middle = size[0] / 2, size[1] / 2
    for share in (1 / 3, 2 / 3, 1.0):
        r = radius * share
        draw.ellipse((middle[0] - r, middle[1] - r, middle[0] + r, middle[1] + r), outline=_RING)

    def at(distance: float, bearing: float) -> tuple[float, float]:
        r = min(distance / lidar.range_m, 1.0) * radius
        return middle[0] - r * float(np.sin(bearing)), middle[1] - r * float(np.cos(bearing))

    fov_rad = np.deg2rad(lidar.fov_deg)
    half = fov_rad / len(ranges) / 2
    for index, distance in enumerate(ranges.tolist()):
        if distance >= lidar.range_m * 0.999:
            continue
        # Segments are ordered counter-clockwise.
        bearing = -fov_rad / 2 + (2 * index + 1) * half
        ends = [at(distance, bearing - half * 0.9), at(distance, bearing + half * 0.9)]
        draw.line(ends, fill=_RETURN, width=max(2, min(size) // 50))
    if goal is not None:
        _dot(draw, at(float(goal[0]), float(goal[1])), max(3, min(size) // 36), _GOAL)
    long = max(4, min(size) // 24)
    x, y = middle
    draw.polygon([(x, y - long), (x - long * 0.7, y + long), (x + long * 0.7, y + long)], fill=_AGENT)
    return np.asarray(image)


def draw_map(
    ground: Picture,
    track: NDArray[np.floating],
    others: NDArray[np.floating],
    goal: NDArray[np.floating] | None,
) -> Picture:
    """A map: on the `ground` (H, W, 3) seen from above the way of a robot, where it is, others and the goal.

    `track` (T, 2), `others` (K, 2) and `goal` (2,) are columns and rows [px].
    """
    image = Image.fromarray(ground)
    draw = ImageDraw.Draw(image)
    size = max(2, min(image.size) // 60)
    if goal is not None:
        _dot(draw, tuple(goal.tolist()), 2 * size, _GOAL)
    for x, y in others.tolist():
        _dot(draw, (x, y), size + 1, _RETURN)
    if len(track) > 1:
        draw.line([tuple(point) for point in track.tolist()], fill=_AGENT, width=size)
    _dot(draw, tuple(track[-1].tolist()), 2 * size, _AGENT)
    return np.asarray(image)


def _dot(draw: ImageDraw.ImageDraw, at: tuple[float, ...], radius: float, colour: Colour) -> None:
    x, y = at
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour, outline=_BACKGROUND)
