"""Car, truck and tractor. docs/how_to/actors.md has the sources of their figures."""

from itertools import pairwise
from typing import Literal

import numpy as np

from dune_rl.bodies import fields
from dune_rl.bodies.settings import Vehicle
from dune_rl.bodies.solids import Colour, ball, box, disc, prism, rod, tube, wheel
from dune_rl.rendering.scenery import ColouredMesh, join_meshes

_GLASS = (0.10, 0.14, 0.18)
_DARK = (0.12, 0.12, 0.13)
_STEEL = (0.62, 0.63, 0.65)
_LAMP = (0.96, 0.95, 0.85)
_TAIL = (0.75, 0.06, 0.05)
_AMBER = (0.95, 0.55, 0.08)


def _wheels(conf: Vehicle, width: float, rim: Colour) -> list[ColouredMesh]:
    """The four wheels, their outer sides just outside of the body."""
    radius, side = conf.wheel_radius_m, 0.51 * conf.width_m - width / 2
    return [wheel((x, np.sign(y) * side, radius), radius, width, rim) for x, y in conf.supports_b]


class CarConf(Vehicle):
    """A compact passenger car at the speed of a works yard."""

    name: Literal["car"] = "car"
    speed_mps: fields.Speed = 5.0
    max_push_n: fields.Push = 9_000.0
    max_slope_deg: fields.Slope = 18.0
    max_water_m: fields.Depth = 0.25
    length_m: fields.Length = 4.3
    width_m: fields.Width = 1.8
    height_m: fields.Height = 1.5
    wheelbase_m: fields.Wheelbase = 2.65
    track_m: fields.Track = 1.55
    wheel_radius_m: fields.WheelRadius = 0.32
    overhang_m: fields.Overhang = 0.8
    turning_circle_m: fields.TurningCircle = 10.9
    clearance_m: fields.Clearance = 0.16
    acceleration_mps2: fields.Acceleration = 2.0
    braking_mps2: fields.Braking = 4.0

    def picture(self, phase: float) -> ColouredMesh:
        """A red hatchback; nothing of it moves."""
        paint = (0.70, 0.08, 0.07)
        long, wide, tall = self.size_m
        low, belt = self.clearance_m, 0.60 * tall
        front, rear = long / 2, -long / 2
        hull = [
            (rear + 0.10, low), (front - 0.20, low), (front, low + 0.18), (front - 0.02, 0.44 * tall),
            (front - 0.30, 0.54 * tall), (0.22 * long, belt), (rear + 0.12, belt + 0.03), (rear, 0.50 * tall),
            (rear, low + 0.2),
        ]  # fmt: skip
        # The cabin: dark glass all round, with a painted roof and pillars over it.
        cabin = [
            (-0.45 * long, belt), (0.22 * long, belt),
            (0.06 * long, 0.97 * tall), (-0.30 * long, 0.97 * tall),
        ]  # fmt: skip
        roof = [
            (-0.33 * long, 0.945 * tall), (0.08 * long, 0.945 * tall),
            (0.05 * long, tall), (-0.29 * long, tall),
        ]  # fmt: skip
        parts = [
            prism(hull, wide, paint, top_width=0.94 * wide),
            prism(cabin, 0.90 * wide, _GLASS, top_width=0.72 * wide),
            prism(roof, 0.76 * wide, paint, top_width=0.66 * wide),
        ]
        for side in (-1.0, 1.0):
            for low_x, high_x, thick in ((0.225, 0.065, 0.05), (-0.10, -0.11, 0.05), (-0.445, -0.31, 0.09)):
                start = np.array([low_x * long, side * 0.45 * wide, belt - 0.02])
                end = np.array([high_x * long, side * 0.365 * wide, 0.96 * tall])
                parts.append(tube([(start, 0.035, thick), (end, 0.03, 0.8 * thick)], paint, 4))
            parts += [
                box((0.17 * long, side * 0.52 * wide, belt + 0.06), (0.12, 0.14, 0.12), paint),
                box((front - 0.07, side * 0.36 * wide, 0.43 * tall), (0.16, 0.34, 0.14), _LAMP),
                box((rear + 0.03, side * 0.38 * wide, 0.52 * tall), (0.09, 0.26, 0.17), _TAIL),
                # A door's edge and handle.
                box((-0.06 * long, side * 0.475 * wide, 0.40 * tall), (0.015, 0.06, 0.30 * tall), _DARK),
                box((-0.10 * long, side * 0.475 * wide, 0.52 * tall), (0.16, 0.05, 0.03), _DARK),
            ]
            for x, _ in self.supports_b[::2]:
                radius = 1.1 * self.wheel_radius_m
                arch = (x, side * 0.447 * wide, self.wheel_radius_m + 0.05)
                parts.append(disc(arch, radius, 0.11 * wide, _DARK, 14))
        parts.append(box((front - 0.01, 0, low + 0.17), (0.06, 0.62 * wide, 0.16), _DARK))
        parts.append(box((rear + 0.01, 0, 0.38 * tall), (0.04, 0.52, 0.12), (0.92, 0.90, 0.80)))
        return join_meshes([*parts, *_wheels(self, 0.21, _STEEL)])


class TruckConf(Vehicle):
    """A light two-axle tipper truck."""

    name: Literal["truck"] = "truck"
    speed_mps: fields.Speed = 4.0
    max_push_n: fields.Push = 40_000.0
    max_slope_deg: fields.Slope = 18.0
    max_water_m: fields.Depth = 0.5
    length_m: fields.Length = 5.9
    width_m: fields.Width = 2.2
    height_m: fields.Height = 2.6
    wheelbase_m: fields.Wheelbase = 3.3
    track_m: fields.Track = 1.8
    wheel_radius_m: fields.WheelRadius = 0.42
    overhang_m: fields.Overhang = 1.35
    turning_circle_m: fields.TurningCircle = 13.4
    clearance_m: fields.Clearance = 0.22
    acceleration_mps2: fields.Acceleration = 1.0
    braking_mps2: fields.Braking = 3.0

    def picture(self, phase: float) -> ColouredMesh:
        """A tipper with a white cab over the engine and an open orange bed."""
        paint, bed = (0.92, 0.92, 0.90), (0.85, 0.42, 0.08)
        long, wide, tall = self.size_m
        front, rear = long / 2, -long / 2
        frame = self.clearance_m + 0.42
        cab = 0.29 * long
        cabin = [
            (front - cab, frame - 0.12), (front - 0.04, frame - 0.12), (front, frame + 0.15),
            (front, 0.62 * tall), (front - 0.16, 0.97 * tall), (front - 0.30, tall), (front - cab, tall),
        ]  # fmt: skip
        windscreen = [
            (front - 0.12, 0.62 * tall), (front + 0.012, 0.62 * tall),
            (front - 0.125, 0.91 * tall), (front - 0.24, 0.91 * tall),
        ]  # fmt: skip
        window = [
            (front - 0.75 * cab, 0.63 * tall), (front - 0.20, 0.63 * tall),
            (front - 0.30, 0.90 * tall), (front - 0.75 * cab, 0.90 * tall),
        ]  # fmt: skip
        parts = [
            box((-0.03 * long, 0, frame), (0.90 * long, 0.40 * wide, 0.22), _DARK),
            prism(cabin, 0.92 * wide, paint, top_width=0.86 * wide),
            prism(windscreen, 0.80 * wide, _GLASS, top_width=0.74 * wide),
            # Grille, bumper and plate.
            box((front, 0, frame + 0.28), (0.03, 0.60 * wide, 0.30), _DARK),
            box((front - 0.05, 0, frame - 0.10), (0.20, 0.96 * wide, 0.24), _DARK),
            box((front - cab - 0.09, 0, frame + 0.55), (0.10, 0.7 * wide, 0.9), _DARK),
        ]
        for side in (-1.0, 1.0):
            parts += [
                prism(window, 0.06, _GLASS, y=side * 0.425 * wide),
                box((front - 0.02, side * 0.36 * wide, frame + 0.12), (0.06, 0.26, 0.16), _LAMP),
                box((front - 0.02, side * 0.45 * wide, frame + 0.30), (0.07, 0.10, 0.10), _AMBER),
                box((front - 0.10, side * 0.53 * wide, 0.72 * tall), (0.10, 0.10, 0.42), _DARK),
                box((rear + 0.06, side * 0.38 * wide, frame), (0.06, 0.30, 0.14), _TAIL),
            ]
        # The bed: a floor and four walls with ribs.
        start, end = rear + 0.05, front - cab - 0.18
        length, middle = end - start, (start + end) / 2
        floor, top = frame + 0.20, 0.70 * tall
        side_height, high = (floor + top) / 2, top - floor
        parts.append(box((middle, 0, floor), (length, 0.98 * wide, 0.12), bed))
        for side in (-1.0, 1.0):
            parts.append(box((middle, side * 0.475 * wide, side_height), (length, 0.07, high), bed))
            for share in (0.04, 0.28, 0.52, 0.76, 0.96):
                place = (start + share * length, side * 0.492 * wide, side_height)
                parts.append(box(place, (0.09, 0.06, high), (0.62, 0.30, 0.06)))
        parts.append(box((end - 0.04, 0, side_height + 0.18), (0.07, 0.95 * wide, high + 0.36), bed))
        parts.append(box((start + 0.04, 0, side_height), (0.07, 0.95 * wide, high), bed))
        # What it carries.
        parts.append(
            ball((middle, 0, top - 0.22), (0.46 * length, 0.42 * wide, 0.36), (0.45, 0.36, 0.26), 10, 5)
        )
        return join_meshes([*parts, *_wheels(self, 0.34, (0.80, 0.80, 0.78))])


class TractorConf(Vehicle):
    """A farm tractor with a cab and no trailer."""

    name: Literal["tractor"] = "tractor"
    speed_mps: fields.Speed = 3.0
    max_push_n: fields.Push = 25_000.0
    max_slope_deg: fields.Slope = 20.0
    max_water_m: fields.Depth = 0.6
    length_m: fields.Length = 4.0
    width_m: fields.Width = 2.0
    height_m: fields.Height = 2.6
    wheelbase_m: fields.Wheelbase = 2.2
    track_m: fields.Track = 1.6
    wheel_radius_m: fields.WheelRadius = 0.75
    overhang_m: fields.Overhang = 0.95
    turning_circle_m: fields.TurningCircle = 8.2
    clearance_m: fields.Clearance = 0.45
    acceleration_mps2: fields.Acceleration = 1.0
    braking_mps2: fields.Braking = 3.0

    def picture(self, phase: float) -> ColouredMesh:
        """Green, with large yellow-rimmed wheels behind, small wheels in front, and a cab."""
        paint, rim = (0.10, 0.38, 0.12), (0.93, 0.76, 0.10)
        long, wide, tall = self.size_m
        front, rear = self.supports_b[0, 0], self.supports_b[2, 0]
        big, small = self.wheel_radius_m, 0.60 * self.wheel_radius_m
        nose = long / 2 - 0.06
        deck = 0.48 * tall
        # The hood over the engine, narrower than the wheels are apart, and its exhaust.
        hood = [
            (rear + 0.35, 0.72 * deck), (nose - 0.05, 0.72 * deck), (nose, 0.85 * deck),
            (nose - 0.06, 1.12 * deck), (nose - 0.5, 1.22 * deck), (rear + 0.35, 1.30 * deck),
        ]  # fmt: skip
        mouth = (front - 0.55, 0.10 * wide, 1.75 * deck)
        parts = [
            prism(hood, 0.34 * wide, paint, top_width=0.27 * wide),
            box((nose - 0.01, 0, 0.95 * deck), (0.05, 0.24 * wide, 0.36), _DARK),
            box(((front + rear) / 2, 0, 0.60 * deck), (front - rear + 0.3, 0.20 * wide, 0.36), _DARK),
            box((front, 0, small), (0.14, 0.66 * wide, 0.14), _DARK),
            box((rear, 0, big), (0.26, 0.62 * wide, 0.26), _DARK),
            rod((front - 0.55, 0.10 * wide, 1.15 * deck), mouth, 0.045, _DARK, 7),
            box((rear - 0.45, 0, 0.45 * deck), (0.55, 0.30 * wide, 0.10), _DARK),
        ]
        # The cab: glass below a roof, on posts.
        low, back, ahead = 0.86 * deck, rear - 0.42, rear + 0.86
        middle, length = (back + ahead) / 2, ahead - back
        glass = (0.93 * length, 0.46 * wide, tall - low - 0.1)
        parts += [
            box((middle, 0, low), (length, 0.50 * wide, 0.30), paint),
            box((middle, 0, (low + tall) / 2), glass, _GLASS, (0.93, 0.93)),
            box((middle, 0, tall - 0.08), (length + 0.12, 0.60 * wide, 0.16), paint, (0.92, 0.9)),
            box((back + 0.15, 0.2 * wide, tall - 0.0), (0.12, 0.12, 0.10), _AMBER),
        ]
        for side in (-1.0, 1.0):
            for x in (back + 0.05, ahead - 0.05, middle - 0.08):
                foot, roof = (x, side * 0.245 * wide, low), (0.95 * x - 0.03, side * 0.225 * wide, tall - 0.1)
                parts.append(rod(foot, roof, 0.035, paint, 5))
            # Mudguards over the rear wheels.
            inner, outer = big + 0.03, big + 0.10
            for start, end in pairwise(np.linspace(0.2, np.pi - 0.1, 7)):
                corners = [
                    (rear + radius * np.cos(angle), big + radius * np.sin(angle))
                    for radius, angle in ((inner, start), (outer, start), (outer, end), (inner, end))
                ]
                parts.append(prism(corners, 0.20 * wide, paint, y=side * 0.37 * wide))
            y = side * self.track_m / 2
            parts.append(wheel((rear, y, big), big, 0.40, rim, 20))
            parts.append(wheel((front, y, small), small, 0.28, rim, 16))
            # Treads that stand out at the side.
            for angle in np.arange(14) * 2 * np.pi / 14:
                at = (rear + 0.94 * big * np.cos(angle), y, big + 0.94 * big * np.sin(angle))
                parts.append(box(at, (0.10, 0.43, 0.10), (0.10, 0.10, 0.10)))
            parts.append(box((nose - 0.03, side * 0.10 * wide, 1.02 * deck), (0.06, 0.14, 0.12), _LAMP))
        return join_meshes(parts)
