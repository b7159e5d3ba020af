"""A quadrotor that flies at a height above the ground. docs/how_to/actors.md has the sources of figures."""

from dataclasses import replace
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import model_validator

from dune_rl.bodies import fields
from dune_rl.bodies.motion import MotionLimits, MotionModelName
from dune_rl.bodies.settings import FlightBand, RectangularBody
from dune_rl.bodies.solids import at, ball, box, disc, rod, tube
from dune_rl.rendering.scenery import ColouredMesh, join_meshes

_SHELL = (0.88, 0.89, 0.90)
_DARK = (0.10, 0.10, 0.11)
_BLADE = (0.22, 0.22, 0.24)


class DroneConf(RectangularBody):
    """A drone with four propellers, over what is lower than it flies."""

    name: Literal["drone"] = "drone"
    speed_mps: fields.Speed = 5.0
    max_push_n: fields.Push = 30.0
    length_m: fields.Length = 0.8
    width_m: fields.Width = 0.8
    height_m: fields.Height = 0.3
    altitude_m: fields.Altitude = 3.0
    min_altitude_m: fields.LeastAltitude = 0.5
    max_altitude_m: fields.MostAltitude = 10.0
    room_below_m: fields.RoomBelow = 0.5
    max_turn_radps: fields.TurnRate = 2.0
    acceleration_mps2: fields.Acceleration = 3.0
    climb_mps: fields.Climb = 1.5

    kind: ClassVar[str] = "drone"
    motion_model: ClassVar[MotionModelName] = "flying"

    @model_validator(mode="after")
    def _flies_within_its_band(self) -> Self:
        if not self.min_altitude_m <= self.altitude_m <= self.max_altitude_m:
            raise ValueError(
                f"altitude_m ({self.altitude_m:g}) must be from min_altitude_m ({self.min_altitude_m:g}) to "
                f"max_altitude_m ({self.max_altitude_m:g})"
            )
        return self

    @property
    def num_frames(self) -> int:
        return 4

    @property
    def stride_m(self) -> float:
        """Way [m] in which the propellers make a quarter of a turn, as a camera would see it."""
        return 0.4

    @property
    def flight(self) -> FlightBand:
        return FlightBand(self.altitude_m, self.min_altitude_m, self.max_altitude_m, self.room_below_m)

    def limits(self) -> MotionLimits:
        return MotionLimits(
            self.motion_model,
            self.speed_mps,
            self.max_turn_radps,
            acceleration_mps2=self.acceleration_mps2,
            braking_mps2=self.acceleration_mps2,
            max_climb_mps=self.climb_mps,
        )

    def picture(self, phase: float) -> ColouredMesh:
        """The drone at a phase of a quarter of a turn of its propellers; it stands on its origin."""
        long, wide, tall = self.size_m
        blade = 0.19 * min(long, wide)
        hubs = [(x * (long / 2 - blade), y * (wide / 2 - blade)) for x in (-1, 1) for y in (-1, 1)]
        level = 0.62 * tall
        nose, taper = level - 0.22 * tall, (0.85, 0.85)
        parts = [
            ball((0, 0, level), (0.21 * long, 0.14 * wide, 0.20 * tall), _SHELL, 10, 5),
            box((-0.02, 0, level + 0.16 * tall), (0.22 * long, 0.12 * wide, 0.12 * tall), _DARK, taper),
            ball((0.15 * long, 0, nose), (0.05, 0.05, 0.05), _DARK, 8, 5),
            disc((0.15 * long + 0.045, 0, nose), 0.025, 0.03, (0.35, 0.45, 0.60), 8, 0),
            box((0.20 * long, 0, level + 0.02), (0.02, 0.10 * wide, 0.02), (0.2, 0.9, 0.2)),
        ]
        for number, (x, y) in enumerate(hubs):
            root = (0.12 * x, 0.12 * y, level)
            lamp = (0.9, 0.1, 0.1) if x < 0 else (0.1, 0.8, 0.2)
            turn = (1.0 if number in (0, 3) else -1.0) * (phase * np.pi / 2 + 0.4 * number)
            cos, sin = np.cos(turn), np.sin(turn)
            propeller = box((0, 0, 0), (2 * blade, 0.045, 0.012), _BLADE)
            spun = propeller.vertices @ [[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]
            parts += [
                tube([(root, 0.028, 0.022), ((x, y, level + 0.02), 0.020, 0.018)], _SHELL, 6),
                disc((x, y, level + 0.05), 0.032, 0.10, _DARK, 8, 2),
                box((x, y, level - 0.01), (0.03, 0.03, 0.03), lamp),
                replace(propeller, vertices=spun + at(x, y, level + 0.105)),
            ]
        for y in (-0.17 * wide, 0.17 * wide):
            parts.append(rod((-0.22 * long, y, 0.014), (0.22 * long, y, 0.014), 0.014, _DARK))
            for x in (-0.12 * long, 0.12 * long):
                parts.append(rod((x, y, 0.014), (x, 0.6 * y, level - 0.05), 0.012, _DARK, 5))
        return join_meshes(parts)
