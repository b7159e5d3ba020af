"""A quadrotor that flies at a height above the ground. docs/how_to/actors.md has the sources of figures."""

from typing import ClassVar, Literal, Self

from pydantic import model_validator

from dune_rl.bodies.fields import (
    Acceleration,
    Altitude,
    Climb,
    Height,
    LeastAltitude,
    Length,
    MostAltitude,
    Push,
    RoomBelow,
    Speed,
    TurnRate,
    Width,
)
from dune_rl.bodies.motion import MotionLimits, MotionModelName
from dune_rl.bodies.settings import FlightBand, RectangularBody
from dune_rl.rendering.scenery import ColouredMesh


class DroneConf(RectangularBody):
    """A drone with four propellers, over what is lower than it flies."""

    name: Literal["drone"] = "drone"
    speed_mps: Speed = 5.0
    max_push_n: Push = 30.0
    length_m: Length = 0.8
    width_m: Width = 0.8
    height_m: Height = 0.3
    altitude_m: Altitude = 3.0
    min_altitude_m: LeastAltitude = 0.5
    max_altitude_m: MostAltitude = 10.0
    room_below_m: RoomBelow = 0.5
    max_turn_radps: TurnRate = 2.0
    acceleration_mps2: Acceleration = 3.0
    climb_mps: Climb = 1.5

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
        """Number of pictures of a quarter of a turn."""
        return 4

    @property
    def stride_m(self) -> float:
        """Way [m] in which the propellers make a quarter of a turn, as a camera would see it."""
        return 0.4

    @property
    def flight(self) -> FlightBand:
        """The heights that it flies at."""
        return FlightBand(self.altitude_m, self.min_altitude_m, self.max_altitude_m, self.room_below_m)

    def limits(self) -> MotionLimits:
        """How it moves."""
        return MotionLimits(
            self.motion_model,
            self.speed_mps,
            self.max_turn_radps,
            acceleration_mps2=self.acceleration_mps2,
            braking_mps2=self.acceleration_mps2,
            max_climb_mps=self.climb_mps,
        )

    def picture(self, phase: float) -> ColouredMesh:
        """The drone at a phase of a turn of its propellers."""
        from dune_rl.bodies.meshes.drone import draw_drone

        return draw_drone(self, phase)
