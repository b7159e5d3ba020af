"""Lenses: in which direction each pixel of a camera looks."""

from functools import cached_property
from typing import Literal, Self

import numpy as np
import scipy
from pydantic import Field, model_validator

from dune_rl.core.settings import Settings
from dune_rl.geometry.arrays import Array

_WIDEST_PINHOLE_DEG = 170.0
# Angles from the axis up to which a projection is tabulated [rad].
_LARGEST_RAD = {"pinhole": np.deg2rad(89.0), "fisheye": np.pi}
_TABLE_SIZE = 8192
# Rounds after which the tangential part of a distortion has settled.
_ROUNDS = 20


class LensConf(Settings):
    """Size of the picture, projection, field of view and distortion.

    `fov_deg` is the angle between the left and the right edge of the picture at half its height, distortion
    included. `distortion` holds OpenCV's coefficients: k1, k2, p1, p2, k3 of a `pinhole`, k1 to k4 of a
    `fisheye` (equidistant); those left out are 0.
    """

    width: int = Field(64, ge=1, le=8192, description="[px]")
    height: int = Field(64, ge=1, le=8192, description="[px]")
    projection: Literal["pinhole", "fisheye"] = Field("pinhole", description="or fisheye (equidistant)")
    fov_deg: float = Field(60.0, ge=0.5, le=180.0, description="angle from the left to the right edge [deg]")
    distortion: tuple[float, ...] = Field(
        (), max_length=5, description="OpenCV's k1, k2, p1, p2, k3 of a pinhole, k1 to k4 of a fisheye"
    )

    @model_validator(mode="after")
    def _sound(self) -> Self:
        if self.projection == "pinhole" and self.fov_deg > _WIDEST_PINHOLE_DEG:
            raise ValueError(
                f"fov_deg of a pinhole must be at most {_WIDEST_PINHOLE_DEG:g} (got {self.fov_deg:g}); "
                "projection=fisheye reaches farther"
            )
        if self.projection == "fisheye" and len(self.distortion) > 4:
            raise ValueError(f"distortion of a fisheye has at most 4 numbers (got {len(self.distortion)})")
        Lens(self)
        return self


class Lens:
    """The projection of a `LensConf`, both ways; raises ValueError where its distortion folds the picture.

    Camera frame: x forward, y left, z up. A picture's first row is its top, its first column its left.
    Formulae: OpenCV, "Camera Calibration and 3D Reconstruction" and "Fisheye camera model".
    """

    def __init__(self, conf: LensConf) -> None:
        self.conf = conf
        self._fov_rad = float(np.deg2rad(conf.fov_deg))
        self._k = np.array([*conf.distortion, *[0.0] * (5 - len(conf.distortion))])
        # Radii at ever larger angles, as far as they grow: beyond that the picture would fold over.
        angle = np.linspace(0.0, _LARGEST_RAD[conf.projection], _TABLE_SIZE)
        plain = np.tan(angle) if conf.projection == "pinhole" else angle
        seen = plain * self._radial(plain)
        shrinks = np.flatnonzero(np.diff(seen) <= 0.0)
        end = int(shrinks[0]) + 1 if len(shrinks) else _TABLE_SIZE
        self._angle, self._plain, self._seen = angle[:end], plain[:end], seen[:end]
        if self._fov_rad / 2 > self._angle[-1]:
            raise ValueError(self._fold())
        # The centre is half a pixel from the grid's middle lines, and the edge half a width from it.
        self.focal_px = conf.width / 2 / float(np.interp(self._fov_rad / 2, self._angle, self._seen))
        self._fit_decentred()
        self.look(np.array([[0.0, 0.0], [conf.width, 0.0], [0.0, conf.height], [conf.width, conf.height]]))

    def _fit_decentred(self) -> None:
        """Find the focal length at which a lens with p1 or p2 spans its field of view, edge to edge."""
        if self.conf.projection == "fisheye" or not self._k[2:4].any():
            return
        plain, middle = self.focal_px, self.conf.height / 2
        edges = np.array([[0.0, middle], [float(self.conf.width), middle]])

        def excess(focal_px: float) -> float:
            self.focal_px = focal_px
            left, right = self.look(edges)
            return float(np.arccos(np.clip(left @ right, -1.0, 1.0))) - self._fov_rad

        # A longer focal length sees less; one that is too short may fold.
        low = high = plain
        for _ in range(40):
            if excess(high) <= 0.0:
                break
            high *= 1.02
        for _ in range(40):
            if excess(low) >= 0.0:
                break
            low /= 1.02
        self.focal_px = plain if low == high else float(scipy.optimize.brentq(excess, low, high, xtol=1e-10))

    @cached_property
    def directions(self) -> Array:
        """Unit vectors (height, width, 3) in which the pixels' centres look, camera frame."""
        rows, columns = np.mgrid[0 : self.conf.height, 0 : self.conf.width] + 0.5
        return self.look(np.stack([columns, rows], axis=-1))

    def look(self, at_px: Array) -> Array:
        """Unit vectors (..., 3), camera frame, toward points (..., 2) of the picture: column and row [px]."""
        seen = (at_px - self._centre) / self.focal_px
        plain = seen
        for _ in range(_ROUNDS):
            radial = seen - self._tangential(plain)
            radius = np.linalg.norm(radial, axis=-1, keepdims=True)
            # Written so that NaN, which compares false, is refused.
            if not radius.max() <= self._seen[-1]:
                raise ValueError(self._fold())
            plain = radial * (np.interp(radius, self._seen, self._plain) / np.maximum(radius, 1e-12))
        if self.conf.projection == "pinhole":
            forward = np.ones_like(plain[..., :1])
        else:
            angle = np.linalg.norm(plain, axis=-1, keepdims=True)
            forward, plain = np.cos(angle), plain * np.sinc(angle / np.pi)
        directions = np.concatenate([forward, -plain], axis=-1)
        return directions / np.linalg.norm(directions, axis=-1, keepdims=True)

    def project(self, points: Array) -> Array:
        """Where points (..., 3), camera frame, appear: column and row (..., 2) [px], NaN if out of reach."""
        aside = -points[..., 1:]
        distance = np.linalg.norm(aside, axis=-1, keepdims=True)
        angle = np.arctan2(distance, points[..., :1])
        angle = np.where(angle <= self._angle[-1], angle, np.nan)
        radius = np.tan(angle) if self.conf.projection == "pinhole" else angle
        plain = aside / np.maximum(distance, 1e-12) * radius
        return (plain * self._radial(radius) + self._tangential(plain)) * self.focal_px + self._centre

    @property
    def _centre(self) -> Array:
        return np.array([self.conf.width, self.conf.height]) / 2

    def _radial(self, r: Array) -> Array:
        """Seen over plain radius `r`: the tangent of the angle, of a fisheye the angle itself."""
        k, s = self._k, r * r
        if self.conf.projection == "pinhole":
            return 1.0 + s * (k[0] + s * (k[1] + s * k[4]))
        return 1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3])))

    def _tangential(self, plain: Array) -> Array:
        if self.conf.projection == "fisheye":
            return np.zeros_like(plain)
        p1, p2 = self._k[2:4]
        x, y = plain[..., 0], plain[..., 1]
        s = x * x + y * y
        return np.stack(
            [2 * p1 * x * y + p2 * (s + 2 * x * x), p1 * (s + 2 * y * y) + 2 * p2 * x * y], axis=-1
        )

    def _fold(self) -> str:
        conf = self.conf
        if not any(conf.distortion):
            return (
                f"a picture of {conf.width} by {conf.height} pixels at fov_deg={conf.fov_deg:g} reaches "
                f"beyond {np.rad2deg(self._angle[-1]):.0f} degrees from its axis; lessen fov_deg or height"
            )
        return (
            f"distortion {list(conf.distortion)} folds the picture over "
            f"{np.rad2deg(self._angle[-1]):.0f} degrees from its axis, which "
            f"{conf.width} by {conf.height} pixels at fov_deg={conf.fov_deg:g} reach; lessen one of them"
        )
