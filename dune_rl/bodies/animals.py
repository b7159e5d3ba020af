"""Cow, sheep and dog. docs/how_to/actors.md has the sources of their figures."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from dune_rl.bodies.fields import (
    Acceleration,
    Depth,
    Height,
    Length,
    Push,
    Slope,
    Speed,
    Stride,
    TurnRate,
    Width,
)
from dune_rl.bodies.settings import Quadruped
from dune_rl.bodies.solids import Colour, at, ball, box, middles, recoloured, tube, union
from dune_rl.geometry.arrays import Array
from dune_rl.rendering.scenery import ColouredMesh


class CowConf(Quadruped):
    """A black and white dairy cow."""

    name: Literal["cow"] = "cow"
    speed_mps: Speed = 1.4
    max_push_n: Push = 2_000.0
    max_slope_deg: Slope = 30.0
    max_water_m: Depth = 0.6
    length_m: Length = 2.4
    width_m: Width = 0.7
    height_m: Height = 1.6
    max_turn_radps: TurnRate = 1.0
    acceleration_mps2: Acceleration = 1.5
    stride_m_per_m: Stride = 0.63

    def picture(self, phase: float) -> ColouredMesh:
        """The cow at a phase of its stride."""
        return draw_cow(self, phase)


class SheepConf(Quadruped):
    """A woolly sheep."""

    name: Literal["sheep"] = "sheep"
    speed_mps: Speed = 1.5
    max_push_n: Push = 400.0
    max_slope_deg: Slope = 38.0
    max_water_m: Depth = 0.3
    length_m: Length = 1.25
    width_m: Width = 0.5
    height_m: Height = 0.95
    max_turn_radps: TurnRate = 2.0
    acceleration_mps2: Acceleration = 2.5
    stride_m_per_m: Stride = 0.75

    def picture(self, phase: float) -> ColouredMesh:
        """The sheep at a phase of its stride."""
        return draw_sheep(self, phase)


class DogConf(Quadruped):
    """A shepherd's dog."""

    name: Literal["dog"] = "dog"
    speed_mps: Speed = 4.0
    max_push_n: Push = 150.0
    max_slope_deg: Slope = 40.0
    max_water_m: Depth = 0.3
    length_m: Length = 1.05
    width_m: Width = 0.28
    height_m: Height = 0.78
    max_turn_radps: TurnRate = 4.0
    acceleration_mps2: Acceleration = 5.0
    stride_m_per_m: Stride = 0.95

    def picture(self, phase: float) -> ColouredMesh:
        """The dog at a phase of its stride."""
        return draw_dog(self, phase)


# A walk's footfalls, as shares of a stride: left fore, right fore, left hind, right hind.
_FOOTFALLS = (0.25, 0.75, 0.0, 0.5)
_SWING = 0.42


def _legs(
    conf: Quadruped,
    phase: float,
    top: float,
    thick: float,
    colours: tuple[Colour, Colour],
    reach: float = 0.30,
) -> list[ColouredMesh]:
    """Four legs from a height `top`, with hooves of the second colour; those in the air are bent.

    A leg is back to front in the air for a third of the stride.
    """
    parts = []
    for index, share in enumerate(_FOOTFALLS):
        fore, side = index < 2, 1.0 if index % 2 == 0 else -1.0
        turn = (phase + share) % 1.0
        if turn < 0.65:
            angle, bend = _SWING * (0.5 - turn / 0.65), 0.0
        else:
            part = (turn - 0.65) / 0.35
            angle, bend = _SWING * (part - 0.5), 0.7 * np.sin(np.pi * part)
        hip = np.array([(reach if fore else -reach) * conf.length_m, side * 0.24 * conf.width_m, top])
        length = top / np.cos(_SWING / 2)
        lean = 0.06 if fore else -0.06
        knee = hip + 0.52 * length * np.array(
            [np.sin(angle + bend / 2 + lean), 0.0, -np.cos(angle + bend / 2 + lean)]
        )
        ankle = knee + 0.40 * length * np.array(
            [np.sin(angle - bend - lean), 0.0, -np.cos(angle - bend - lean)]
        )
        foot = ankle.copy()
        foot[2] = max(0.0, foot[2] - 0.08 * length) if bend == 0.0 else foot[2] - 0.07 * length
        if bend == 0.0:
            foot[2] = 0.0
        wide = 1.2 if fore else 1.6
        parts += [
            tube(
                [
                    (hip, wide * thick, 1.3 * wide * thick),
                    (knee, thick, thick),
                    (ankle, 0.72 * thick, 0.72 * thick),
                ],
                colours[0],
                6,
            ),
            tube(
                [
                    (ankle + at(0, 0, 0.01), 0.72 * thick, 0.72 * thick),
                    (foot + at(0.3 * thick, 0, 0), 0.95 * thick, 1.1 * thick),
                ],
                colours[1],
                6,
            ),
        ]
    return parts


def _spotted(
    mesh: ColouredMesh, spots: Sequence[tuple[float, float, float, float]], colour: Colour
) -> ColouredMesh:
    """The mesh with faces in another colour that lie within spots: x, y, z and radius [m]."""
    places = middles(mesh)
    inside = np.zeros(len(places), bool)
    for x, y, z, radius in spots:
        inside |= np.linalg.norm(places - at(x, y, z), axis=1) < radius
    return recoloured(mesh, inside, colour)


def _ear(root: Array, tip: Array, thick: float, colour: Colour) -> ColouredMesh:
    return tube(
        [
            (root, 0.4 * thick, 0.4 * thick),
            ((root + tip) / 2, thick, 0.4 * thick),
            (tip, 0.2 * thick, 0.15 * thick),
        ],
        colour,
        5,
    )


def draw_cow(conf: Quadruped, phase: float) -> ColouredMesh:
    """A black and white cow with horns and an udder, at a phase of its stride in [0, 1)."""
    white, black, pink, horn = (0.90, 0.89, 0.86), (0.07, 0.06, 0.06), (0.85, 0.60, 0.56), (0.80, 0.75, 0.62)
    long, wide, tall = conf.size_m
    belly, back = 0.42 * tall, 0.90 * tall
    middle, half = (belly + back) / 2, (back - belly) / 2
    trunk = tube(
        [
            ((-0.40 * long, 0, middle + 0.10 * tall), 0.20 * wide, 0.45 * half),
            ((-0.37 * long, 0, middle + 0.06 * tall), 0.40 * wide, 0.80 * half),
            ((-0.28 * long, 0, middle + 0.02 * tall), 0.47 * wide, 0.95 * half),
            ((-0.14 * long, 0, middle - 0.01 * tall), 0.50 * wide, 1.02 * half),
            ((0.0, 0, middle - 0.01 * tall), 0.50 * wide, 1.02 * half),
            ((0.12 * long, 0, middle), 0.47 * wide, 0.98 * half),
            ((0.22 * long, 0, middle + 0.01 * tall), 0.42 * wide, 0.95 * half),
            ((0.28 * long, 0, middle + 0.03 * tall), 0.30 * wide, 0.75 * half),
        ],
        white,
        20,
        refine=2,
    )
    spots = [
        (-0.05 * long, 0.4 * wide, 0.82 * tall, 0.36), (-0.30 * long, 0.4 * wide, 0.70 * tall, 0.26),
        (0.20 * long, 0.4 * wide, 0.66 * tall, 0.24), (0.02 * long, -0.45 * wide, 0.62 * tall, 0.30),
        (-0.27 * long, -0.4 * wide, 0.82 * tall, 0.30), (0.22 * long, -0.3 * wide, 0.85 * tall, 0.26),
    ]  # fmt: skip
    nod = 0.012 * tall * np.sin(4 * np.pi * phase)
    poll = np.array([0.40 * long, 0.0, 0.93 * tall + nod])
    muzzle = np.array([0.50 * long - 0.03, 0.0, 0.74 * tall + nod])
    neck = tube(
        [
            ((0.22 * long, 0, middle + 0.06 * tall), 0.30 * wide, 0.75 * half),
            ((0.31 * long, 0, 0.80 * tall + nod), 0.20 * wide, 0.50 * half),
            (poll + at(-0.02, 0, -0.03), 0.17 * wide, 0.34 * half),
        ],
        black,
        10,
    )
    way = muzzle - poll
    head = tube(
        [
            (poll - 0.05 * way, 0.12 * wide, 0.09 * wide),
            (poll + 0.15 * way, 0.185 * wide, 0.18 * wide),
            (poll + 0.55 * way, 0.14 * wide, 0.15 * wide),
            (poll + 0.90 * way, 0.125 * wide, 0.12 * wide),
        ],
        black,
        8,
    )
    front = 0.155 * wide * np.array([-way[2], 0.0, way[0]]) / np.linalg.norm(way)
    blaze = tube(
        [
            (poll + 0.15 * way + 1.05 * front, 0.045 * wide, 0.03 * wide),
            (poll + 0.75 * way + 0.80 * front, 0.07 * wide, 0.03 * wide),
        ],
        white,
        6,
    )
    nose = ball(poll + 0.97 * way, (0.13 * wide, 0.135 * wide, 0.11 * wide), pink, 8, 4)
    parts = [_spotted(trunk, spots, black), neck, head, nose, blaze]
    for side in (-1.0, 1.0):
        root = poll + at(0.0, side * 0.11 * wide, 0.02 * tall)
        parts.append(
            tube(
                [
                    (root, 0.035, 0.035),
                    (root + at(0.02, side * 0.12, 0.05), 0.028, 0.028),
                    (root + at(0.07, side * 0.13, 0.15), 0.008, 0.008),
                ],
                horn,
                5,
            )
        )
        ear = poll + at(-0.02, side * 0.14 * wide, -0.02 * tall)
        parts.append(_ear(ear, ear + at(-0.05, side * 0.20, -0.05), 0.07, black))
        parts.append(
            ball(
                poll + 0.28 * way + at(0.05, side * 0.175 * wide, 0.02),
                (0.025, 0.018, 0.025),
                (0.02, 0.02, 0.02),
                5,
                3,
            )
        )
    parts.append(ball((-0.20 * long, 0, belly - 0.01 * tall), (0.19, 0.15, 0.13), pink, 8, 4))
    for x, y in ((-0.17, 0.07), (-0.17, -0.07), (-0.22, 0.07), (-0.22, -0.07)):
        parts.append(box((x * long, y, belly - 0.10 * tall), (0.035, 0.035, 0.09), pink))
    tail = [
        ((-0.40 * long, 0, 0.86 * tall), 0.03, 0.03),
        ((-0.435 * long, 0, 0.70 * tall), 0.022, 0.022),
        ((-0.43 * long, 0, 0.45 * tall), 0.018, 0.018),
    ]
    parts += [tube(tail, white, 5), ball((-0.43 * long, 0, 0.38 * tall), (0.04, 0.04, 0.12), black, 6, 4)]
    return union([*parts, *_legs(conf, phase, middle, 0.062, (white, (0.15, 0.13, 0.12)))])


def draw_sheep(conf: Quadruped, phase: float) -> ColouredMesh:
    """A white woolly sheep with a black face and legs, at a phase of its stride in [0, 1)."""
    wool, black = (0.90, 0.87, 0.78), (0.10, 0.09, 0.09)
    long, wide, tall = conf.size_m
    middle = 0.62 * tall
    fleece = ball((-0.06 * long, 0, middle), (0.40 * long, 0.46 * wide, 0.30 * tall), wool, 16, 10)
    # Locks: every other vertex stands out.
    way = fleece.vertices - [-0.06 * long, 0, middle]
    count = np.arange(len(way))
    out = 1.0 + 0.09 * np.where((count + count // 16) % 2 == 0, 1.0, -0.6)
    parts = [
        ColouredMesh(
            [-0.06 * long, 0, middle] + way * out[:, None], fleece.faces, fleece.albedo, fleece.segments
        )
    ]
    shade = (0.82, 0.78, 0.68)
    rng = np.random.default_rng(7)
    for x in (-0.32, -0.18, -0.04, 0.10, 0.22):
        for angle in (0.5, 1.1, 1.57, 2.04, 2.64):
            lock = np.array([x * long, 0.40 * wide * np.cos(angle), middle + 0.24 * tall * np.sin(angle)])
            lock[:2] *= 0.97
            size = 0.075 + 0.015 * rng.uniform()
            parts.append(
                ball(lock, (1.1 * size, size, 0.8 * size), wool if rng.uniform() < 0.7 else shade, 6, 3)
            )
    nod = 0.012 * tall * np.sin(4 * np.pi * phase)
    poll = np.array([0.36 * long, 0.0, 0.93 * tall + nod])
    muzzle = np.array([0.49 * long, 0.0, 0.73 * tall + nod])
    face = muzzle - poll
    parts += [
        tube(
            [
                ((0.20 * long, 0, 0.66 * tall), 0.26 * wide, 0.20 * tall),
                (poll + at(-0.03, 0, -0.06), 0.20 * wide, 0.12 * tall),
            ],
            wool,
            9,
        ),
        ball(poll + at(-0.03, 0, 0.0), (0.10, 0.095, 0.075), wool, 8, 4),
        tube(
            [
                (poll, 0.13 * wide, 0.12 * wide),
                (poll + 0.4 * face, 0.15 * wide, 0.15 * wide),
                (muzzle, 0.09 * wide, 0.085 * wide),
            ],
            black,
            8,
        ),
        ball((-0.47 * long, 0, 0.62 * tall), (0.05, 0.05, 0.11), wool, 6, 4),
    ]
    for side in (-1.0, 1.0):
        root = poll + 0.1 * face + at(-0.01, side * 0.11 * wide, 0.0)
        parts.append(_ear(root, root + at(-0.02, side * 0.14, -0.02), 0.045, black))
        parts.append(
            ball(
                poll + 0.33 * face + at(0.03, side * 0.145 * wide, 0.01),
                (0.014, 0.012, 0.014),
                (0.85, 0.75, 0.3),
                5,
                3,
            )
        )
    return union([*parts, *_legs(conf, phase, 0.45 * tall, 0.032, (black, (0.05, 0.05, 0.05)), 0.24)])


def draw_dog(conf: Quadruped, phase: float) -> ColouredMesh:
    """A shepherd's dog with pointed ears and a bushy tail, at a phase of its stride in [0, 1)."""
    tan, saddle, dark = (0.62, 0.42, 0.22), (0.12, 0.10, 0.09), (0.05, 0.05, 0.05)
    long, wide, tall = conf.size_m
    back, chest = 0.76 * tall, 0.36 * tall
    middle, half = (back + chest) / 2, (back - chest) / 2
    trunk = tube(
        [
            ((-0.29 * long, 0, middle + 0.05 * tall), 0.22 * wide, 0.45 * half),
            ((-0.24 * long, 0, middle + 0.04 * tall), 0.40 * wide, 0.72 * half),
            ((-0.08 * long, 0, middle + 0.06 * tall), 0.40 * wide, 0.66 * half),
            ((0.08 * long, 0, middle + 0.02 * tall), 0.48 * wide, 0.92 * half),
            ((0.18 * long, 0, middle + 0.01 * tall), 0.48 * wide, 0.98 * half),
            ((0.25 * long, 0, middle + 0.05 * tall), 0.32 * wide, 0.70 * half),
        ],
        tan,
        10,
    )
    trunk = recoloured(trunk, middles(trunk)[:, 2] > middle + 0.25 * half, saddle)
    nod = 0.01 * tall * np.sin(4 * np.pi * phase)
    skull = np.array([0.35 * long, 0.0, 0.86 * tall + nod])
    nose = np.array([0.50 * long, 0.0, 0.78 * tall + nod])
    parts = [
        trunk,
        tube(
            [
                ((0.20 * long, 0, middle + 0.10 * tall), 0.34 * wide, 0.55 * half),
                ((0.28 * long, 0, 0.78 * tall + nod), 0.30 * wide, 0.36 * half),
                (skull + at(-0.01, 0, 0), 0.22 * wide, 0.20 * half),
            ],
            tan,
            8,
        ),
        ball(skull, (0.10, 0.072, 0.07), tan, 8, 5),
        tube(
            [(skull + at(0.05, 0, -0.015), 0.055, 0.055), (nose + at(-0.02, 0, 0), 0.034, 0.032)], saddle, 7
        ),
        ball(nose, (0.022, 0.024, 0.02), dark, 6, 3),
        tube(
            [(skull + at(0.06, 0, -0.05), 0.04, 0.016), (nose + at(-0.03, 0, -0.035), 0.026, 0.012)], tan, 6
        ),
    ]
    for side in (-1.0, 1.0):
        root = skull + at(-0.02, side * 0.045, 0.04)
        parts.append(_ear(root, root + at(-0.005, side * 0.02, 0.095), 0.034, saddle))
        parts.append(ball(skull + at(0.078, side * 0.036, 0.022), (0.012, 0.010, 0.011), dark, 5, 3))
    wag = 0.08 * np.sin(4 * np.pi * phase)
    parts.append(
        tube(
            [
                ((-0.28 * long, 0, 0.70 * tall), 0.03, 0.03),
                ((-0.38 * long, 0.5 * wag, 0.60 * tall), 0.045, 0.05),
                ((-0.46 * long, wag, 0.56 * tall), 0.045, 0.05),
                ((-0.52 * long, 1.3 * wag, 0.60 * tall), 0.012, 0.012),
            ],
            saddle,
            6,
        )
    )
    return union([*parts, *_legs(conf, phase, 0.52 * tall, 0.025, (tan, tan), 0.22)])
