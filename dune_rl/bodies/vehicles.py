"""Vehicles: car, truck and tractor. docs/how_to/actors.md has the sources of their figures."""

from typing import Literal

from dune_rl.bodies.fields import (
    Acceleration,
    Braking,
    Clearance,
    Depth,
    Height,
    Length,
    Overhang,
    Push,
    Slope,
    Speed,
    Track,
    TurningCircle,
    Wheelbase,
    WheelRadius,
    Width,
)
from dune_rl.bodies.settings import Vehicle
from dune_rl.rendering.scenery import ColouredMesh


class CarConf(Vehicle):
    """A compact passenger car at the speed of a works yard."""

    name: Literal["car"] = "car"
    speed_mps: Speed = 5.0
    max_push_n: Push = 9_000.0
    max_slope_deg: Slope = 18.0
    max_water_m: Depth = 0.25
    length_m: Length = 4.3
    width_m: Width = 1.8
    height_m: Height = 1.5
    wheelbase_m: Wheelbase = 2.65
    track_m: Track = 1.55
    wheel_radius_m: WheelRadius = 0.32
    overhang_m: Overhang = 0.8
    turning_circle_m: TurningCircle = 10.9
    clearance_m: Clearance = 0.16
    acceleration_mps2: Acceleration = 2.0
    braking_mps2: Braking = 4.0

    def picture(self, phase: float) -> ColouredMesh:
        """The car; nothing of it moves."""
        from dune_rl.bodies.meshes.vehicles import draw_car

        return draw_car(self)


class TruckConf(Vehicle):
    """A light two-axle tipper truck."""

    name: Literal["truck"] = "truck"
    speed_mps: Speed = 4.0
    max_push_n: Push = 40_000.0
    max_slope_deg: Slope = 18.0
    max_water_m: Depth = 0.5
    length_m: Length = 5.9
    width_m: Width = 2.2
    height_m: Height = 2.6
    wheelbase_m: Wheelbase = 3.3
    track_m: Track = 1.8
    wheel_radius_m: WheelRadius = 0.42
    overhang_m: Overhang = 1.35
    turning_circle_m: TurningCircle = 13.4
    clearance_m: Clearance = 0.22
    acceleration_mps2: Acceleration = 1.0
    braking_mps2: Braking = 3.0

    def picture(self, phase: float) -> ColouredMesh:
        """The truck; nothing of it moves."""
        from dune_rl.bodies.meshes.vehicles import draw_truck

        return draw_truck(self)


class TractorConf(Vehicle):
    """A farm tractor with a cab and no trailer."""

    name: Literal["tractor"] = "tractor"
    speed_mps: Speed = 3.0
    max_push_n: Push = 25_000.0
    max_slope_deg: Slope = 20.0
    max_water_m: Depth = 0.6
    length_m: Length = 4.0
    width_m: Width = 2.0
    height_m: Height = 2.6
    wheelbase_m: Wheelbase = 2.2
    track_m: Track = 1.6
    wheel_radius_m: WheelRadius = 0.75
    overhang_m: Overhang = 0.95
    turning_circle_m: TurningCircle = 8.2
    clearance_m: Clearance = 0.45
    acceleration_mps2: Acceleration = 1.0
    braking_mps2: Braking = 3.0

    def picture(self, phase: float) -> ColouredMesh:
        """The tractor; nothing of it moves."""
        from dune_rl.bodies.meshes.vehicles import draw_tractor

        return draw_tractor(self)
