"""Cow, sheep and dog. docs/how_to/actors.md has the sources of their figures."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from dune_rl.bodies import fields
from dune_rl.bodies.settings import Quadruped
from dune_rl.bodies.solids import Colour, Ring, at, ball, box, middles, recoloured, tube
from dune_rl.geometry.arrays import Array
from dune_rl.rendering.scenery import ColouredMesh, join_meshes

# A walk's footfalls, as shares of a stride: left fore, right fore, left hind, right hind.
_FOOTFALLS = (0.25, 0.75, 0.0, 0.5)
_SWING = 0.42


def _legs(
    conf: Quadruped, phase: float, top: float, thick: float, colours: tuple[Colour, Colour], reach: float
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
        knee = hip + 0.52 * length * _down(angle + bend / 2 + lean)
        ankle = knee + 0.40 * length * _down(angle - bend - lean)
        foot = ankle.copy()
        foot[2] = 0.0 if bend == 0.0 else foot[2] - 0.07 * length
        wide = 1.2 if fore else 1.6
        shin, hoof = ankle + at(0, 0, 0.01), foot + at(0.3 * thick, 0, 0)
        leg = [(hip, wide, 1.3 * wide), (knee, 1.0, 1.0), (ankle, 0.72, 0.72)]
        parts.append(tube(leg, colours[0], 6, wide=thick, high=thick))
        parts.append(tube([(shin, 0.72, 0.72), (hoof, 0.95, 1.1)], colours[1], 6, wide=thick, high=thick))
    return parts


def _down(angle: float) -> Array:
    """The direction (3,) of a limb that is swung forward by `angle`."""
    return np.array([np.sin(angle), 0.0, -np.cos(angle)])


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
    rings = [(root, 0.4, 0.4), ((root + tip) / 2, 1.0, 0.4), (tip, 0.2, 0.15)]
    return tube(rings, colour, 5, wide=thick, high=thick)


class CowConf(Quadruped):
    """A black and white dairy cow."""

    name: Literal["cow"] = "cow"
    speed_mps: fields.Speed = 1.4
    max_push_n: fields.Push = 2_000.0
    max_slope_deg: fields.Slope = 30.0
    max_water_m: fields.Depth = 0.6
    length_m: fields.Length = 2.4
    width_m: fields.Width = 0.7
    height_m: fields.Height = 1.6
    max_turn_radps: fields.TurnRate = 1.0
    acceleration_mps2: fields.Acceleration = 1.5
    stride_m_per_m: fields.Stride = 0.63

    def picture(self, phase: float) -> ColouredMesh:
        """The cow, with horns and an udder, at a phase of its stride."""
        white, black = (0.90, 0.89, 0.86), (0.07, 0.06, 0.06)
        pink, horn = (0.85, 0.60, 0.56), (0.80, 0.75, 0.62)
        long, wide, tall = self.size_m
        belly, back = 0.42 * tall, 0.90 * tall
        middle, half = (belly + back) / 2, (back - belly) / 2
        trunk = [
            ((-0.40 * long, 0, middle + 0.10 * tall), 0.20, 0.45),
            ((-0.37 * long, 0, middle + 0.06 * tall), 0.40, 0.80),
            ((-0.28 * long, 0, middle + 0.02 * tall), 0.47, 0.95),
            ((-0.14 * long, 0, middle - 0.01 * tall), 0.50, 1.02),
            ((0.0, 0, middle - 0.01 * tall), 0.50, 1.02),
            ((0.12 * long, 0, middle), 0.47, 0.98),
            ((0.22 * long, 0, middle + 0.01 * tall), 0.42, 0.95),
            ((0.28 * long, 0, middle + 0.03 * tall), 0.30, 0.75),
        ]
        spots = [
            (-0.05 * long, 0.4 * wide, 0.82 * tall, 0.36), (-0.30 * long, 0.4 * wide, 0.70 * tall, 0.26),
            (0.20 * long, 0.4 * wide, 0.66 * tall, 0.24), (0.02 * long, -0.45 * wide, 0.62 * tall, 0.30),
            (-0.27 * long, -0.4 * wide, 0.82 * tall, 0.30), (0.22 * long, -0.3 * wide, 0.85 * tall, 0.26),
        ]  # fmt: skip
        nod = 0.012 * tall * np.sin(4 * np.pi * phase)
        poll = np.array([0.40 * long, 0.0, 0.93 * tall + nod])
        way = np.array([0.50 * long - 0.03, 0.0, 0.74 * tall + nod]) - poll
        neck: list[Ring] = [
            ((0.22 * long, 0, middle + 0.06 * tall), 0.30, 0.75),
            ((0.31 * long, 0, 0.80 * tall + nod), 0.20, 0.50),
            (poll + at(-0.02, 0, -0.03), 0.17, 0.34),
        ]
        head = [
            (poll - 0.05 * way, 0.12, 0.09), (poll + 0.15 * way, 0.185, 0.18),
            (poll + 0.55 * way, 0.14, 0.15), (poll + 0.90 * way, 0.125, 0.12),
        ]  # fmt: skip
        front = 0.155 * wide * np.array([-way[2], 0.0, way[0]]) / np.linalg.norm(way)
        blaze = [
            (poll + 0.15 * way + 1.05 * front, 0.045, 0.03),
            (poll + 0.75 * way + 0.80 * front, 0.07, 0.03),
        ]
        parts = [
            _spotted(tube(trunk, white, 20, refine=2, wide=wide, high=half), spots, black),
            tube(neck, black, 10, wide=wide, high=half),
            tube(head, black, wide=wide, high=wide),
            ball(poll + 0.97 * way, (0.13 * wide, 0.135 * wide, 0.11 * wide), pink, 8, 4),
            tube(blaze, white, 6, wide=wide, high=wide),
        ]
        for side in (-1.0, 1.0):
            root = poll + at(0.0, side * 0.11 * wide, 0.02 * tall)
            bend, tip = root + at(0.02, side * 0.12, 0.05), root + at(0.07, side * 0.13, 0.15)
            ear = poll + at(-0.02, side * 0.14 * wide, -0.02 * tall)
            eye = poll + 0.28 * way + at(0.05, side * 0.175 * wide, 0.02)
            parts += [
                tube([(root, 0.035, 0.035), (bend, 0.028, 0.028), (tip, 0.008, 0.008)], horn, 5),
                _ear(ear, ear + at(-0.05, side * 0.20, -0.05), 0.07, black),
                ball(eye, (0.025, 0.018, 0.025), (0.02, 0.02, 0.02), 5, 3),
            ]
        parts.append(ball((-0.20 * long, 0, belly - 0.01 * tall), (0.19, 0.15, 0.13), pink, 8, 4))
        for x, y in ((-0.17, 0.07), (-0.17, -0.07), (-0.22, 0.07), (-0.22, -0.07)):
            parts.append(box((x * long, y, belly - 0.10 * tall), (0.035, 0.035, 0.09), pink))
        tail = [
            ((-0.40 * long, 0, 0.86 * tall), 0.03, 0.03),
            ((-0.435 * long, 0, 0.70 * tall), 0.022, 0.022),
            ((-0.43 * long, 0, 0.45 * tall), 0.018, 0.018),
        ]
        parts += [tube(tail, white, 5), ball((-0.43 * long, 0, 0.38 * tall), (0.04, 0.04, 0.12), black, 6, 4)]
        return join_meshes([*parts, *_legs(self, phase, middle, 0.062, (white, (0.15, 0.13, 0.12)), 0.30)])


class SheepConf(Quadruped):
    """A woolly sheep."""

    name: Literal["sheep"] = "sheep"
    speed_mps: fields.Speed = 1.5
    max_push_n: fields.Push = 400.0
    max_slope_deg: fields.Slope = 38.0
    max_water_m: fields.Depth = 0.3
    length_m: fields.Length = 1.25
    width_m: fields.Width = 0.5
    height_m: fields.Height = 0.95
    max_turn_radps: fields.TurnRate = 2.0
    acceleration_mps2: fields.Acceleration = 2.5
    stride_m_per_m: fields.Stride = 0.75

    def picture(self, phase: float) -> ColouredMesh:
        """The sheep, with a black face and black legs, at a phase of its stride."""
        wool, shade, black = (0.90, 0.87, 0.78), (0.82, 0.78, 0.68), (0.10, 0.09, 0.09)
        long, wide, tall = self.size_m
        middle = 0.62 * tall
        centre = [-0.06 * long, 0, middle]
        fleece = ball(centre, (0.40 * long, 0.46 * wide, 0.30 * tall), wool, 16, 10)
        # Locks: every other vertex stands out.
        way = fleece.vertices - centre
        count = np.arange(len(way))
        out = 1.0 + 0.09 * np.where((count + count // 16) % 2 == 0, 1.0, -0.6)
        parts = [replace(fleece, vertices=centre + way * out[:, None])]
        rng = np.random.default_rng(7)
        for x in (-0.32, -0.18, -0.04, 0.10, 0.22):
            for angle in (0.5, 1.1, 1.57, 2.04, 2.64):
                lock = np.array([x * long, 0.40 * wide * np.cos(angle), middle + 0.24 * tall * np.sin(angle)])
                lock[:2] *= 0.97
                size = 0.075 + 0.015 * rng.uniform()
                colour = wool if rng.uniform() < 0.7 else shade
                parts.append(ball(lock, (1.1 * size, size, 0.8 * size), colour, 6, 3))
        nod = 0.012 * tall * np.sin(4 * np.pi * phase)
        poll = np.array([0.36 * long, 0.0, 0.93 * tall + nod])
        muzzle = np.array([0.49 * long, 0.0, 0.73 * tall + nod])
        face = muzzle - poll
        neck: list[Ring] = [
            ((0.20 * long, 0, 0.66 * tall), 0.26, 0.20),
            (poll + at(-0.03, 0, -0.06), 0.20, 0.12),
        ]
        head = [(poll, 0.13, 0.12), (poll + 0.4 * face, 0.15, 0.15), (muzzle, 0.09, 0.085)]
        parts += [
            tube(neck, wool, 9, wide=wide, high=tall),
            ball(poll + at(-0.03, 0, 0.0), (0.10, 0.095, 0.075), wool, 8, 4),
            tube(head, black, wide=wide, high=wide),
            ball((-0.47 * long, 0, 0.62 * tall), (0.05, 0.05, 0.11), wool, 6, 4),
        ]
        for side in (-1.0, 1.0):
            root = poll + 0.1 * face + at(-0.01, side * 0.11 * wide, 0.0)
            eye = poll + 0.33 * face + at(0.03, side * 0.145 * wide, 0.01)
            parts.append(_ear(root, root + at(-0.02, side * 0.14, -0.02), 0.045, black))
            parts.append(ball(eye, (0.014, 0.012, 0.014), (0.85, 0.75, 0.3), 5, 3))
        return join_meshes(
            [*parts, *_legs(self, phase, 0.45 * tall, 0.032, (black, (0.05, 0.05, 0.05)), 0.24)]
        )


class DogConf(Quadruped):
    """A shepherd's dog."""

    name: Literal["dog"] = "dog"
    speed_mps: fields.Speed = 4.0
    max_push_n: fields.Push = 150.0
    max_slope_deg: fields.Slope = 40.0
    max_water_m: fields.Depth = 0.3
    length_m: fields.Length = 1.05
    width_m: fields.Width = 0.28
    height_m: fields.Height = 0.78
    max_turn_radps: fields.TurnRate = 4.0
    acceleration_mps2: fields.Acceleration = 5.0
    stride_m_per_m: fields.Stride = 0.95

    def picture(self, phase: float) -> ColouredMesh:
        """The dog, with pointed ears and a bushy tail, at a phase of its stride."""
        tan, saddle, dark = (0.62, 0.42, 0.22), (0.12, 0.10, 0.09), (0.05, 0.05, 0.05)
        long, wide, tall = self.size_m
        back, chest = 0.76 * tall, 0.36 * tall
        middle, half = (back + chest) / 2, (back - chest) / 2
        body = [
            ((-0.29 * long, 0, middle + 0.05 * tall), 0.22, 0.45),
            ((-0.24 * long, 0, middle + 0.04 * tall), 0.40, 0.72),
            ((-0.08 * long, 0, middle + 0.06 * tall), 0.40, 0.66),
            ((0.08 * long, 0, middle + 0.02 * tall), 0.48, 0.92),
            ((0.18 * long, 0, middle + 0.01 * tall), 0.48, 0.98),
            ((0.25 * long, 0, middle + 0.05 * tall), 0.32, 0.70),
        ]
        trunk = tube(body, tan, 10, wide=wide, high=half)
        nod = 0.01 * tall * np.sin(4 * np.pi * phase)
        skull = np.array([0.35 * long, 0.0, 0.86 * tall + nod])
        nose = np.array([0.50 * long, 0.0, 0.78 * tall + nod])
        neck: list[Ring] = [
            ((0.20 * long, 0, middle + 0.10 * tall), 0.34, 0.55),
            ((0.28 * long, 0, 0.78 * tall + nod), 0.30, 0.36),
            (skull + at(-0.01, 0, 0), 0.22, 0.20),
        ]
        muzzle = [(skull + at(0.05, 0, -0.015), 0.055, 0.055), (nose + at(-0.02, 0, 0), 0.034, 0.032)]
        jaw = [(skull + at(0.06, 0, -0.05), 0.04, 0.016), (nose + at(-0.03, 0, -0.035), 0.026, 0.012)]
        parts = [
            recoloured(trunk, middles(trunk)[:, 2] > middle + 0.25 * half, saddle),
            tube(neck, tan, wide=wide, high=half),
            ball(skull, (0.10, 0.072, 0.07), tan, 8, 5),
            tube(muzzle, saddle, 7),
            ball(nose, (0.022, 0.024, 0.02), dark, 6, 3),
            tube(jaw, tan, 6),
        ]
        for side in (-1.0, 1.0):
            root = skull + at(-0.02, side * 0.045, 0.04)
            parts.append(_ear(root, root + at(-0.005, side * 0.02, 0.095), 0.034, saddle))
            parts.append(ball(skull + at(0.078, side * 0.036, 0.022), (0.012, 0.010, 0.011), dark, 5, 3))
        wag = 0.08 * np.sin(4 * np.pi * phase)
        tail = [
            ((-0.28 * long, 0, 0.70 * tall), 0.03, 0.03),
            ((-0.38 * long, 0.5 * wag, 0.60 * tall), 0.045, 0.05),
            ((-0.46 * long, wag, 0.56 * tall), 0.045, 0.05),
            ((-0.52 * long, 1.3 * wag, 0.60 * tall), 0.012, 0.012),
        ]
        return join_meshes(
            [*parts, tube(tail, saddle, 6), *_legs(self, phase, 0.52 * tall, 0.025, (tan, tan), 0.22)]
        )
