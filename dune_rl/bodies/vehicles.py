"""Vehicles: car, truck and tractor. docs/how_to/actors.md has the sources of their figures."""

from typing import Literal

from dune_rl.bodies.settings import Vehicle
from dune_rl.rendering.scenery import ColouredMesh


class CarConf(Vehicle):
    """A compact passenger car at the speed of a works yard."""

    name: Literal["car"] = "car"
    speed_mps: float = 5.0
    max_push_n: float = 9_000.0
    max_slope_deg: float = 18.0
    max_water_m: float = 0.25
    length_m: float = 4.3
    width_m: float = 1.8
    height_m: float = 1.5
    wheelbase_m: float = 2.65
    track_m: float = 1.55
    wheel_radius_m: float = 0.32
    overhang_m: float = 0.8
    turning_circle_m: float = 10.9
    clearance_m: float = 0.16
    acceleration_mps2: float = 2.0
    braking_mps2: float = 4.0

    def picture(self, phase: float) -> ColouredMesh:
        """The car; nothing of it moves."""
        from dune_rl.bodies.meshes.vehicles import draw_car

        return draw_car(self)


class TruckConf(Vehicle):
    """A light two-axle tipper truck."""

    name: Literal["truck"] = "truck"
    speed_mps: float = 4.0
    max_push_n: float = 40_000.0
    max_slope_deg: float = 18.0
    max_water_m: float = 0.5
    length_m: float = 5.9
    width_m: float = 2.2
    height_m: float = 2.6
    wheelbase_m: float = 3.3
    track_m: float = 1.8
    wheel_radius_m: float = 0.42
    overhang_m: float = 1.35
    turning_circle_m: float = 13.4
    clearance_m: float = 0.22
    acceleration_mps2: float = 1.0
    braking_mps2: float = 3.0

    def picture(self, phase: float) -> ColouredMesh:
        """The truck; nothing of it moves."""
        from dune_rl.bodies.meshes.vehicles import draw_truck

        return draw_truck(self)


class TractorConf(Vehicle):
    """A farm tractor with a cab and no trailer."""

    name: Literal["tractor"] = "tractor"
    speed_mps: float = 3.0
    max_push_n: float = 25_000.0
    max_slope_deg: float = 20.0
    max_water_m: float = 0.6
    length_m: float = 4.0
    width_m: float = 2.0
    height_m: float = 2.6
    wheelbase_m: float = 2.2
    track_m: float = 1.6
    wheel_radius_m: float = 0.75
    overhang_m: float = 0.95
    turning_circle_m: float = 8.2
    clearance_m: float = 0.45
    acceleration_mps2: float = 1.0
    braking_mps2: float = 3.0

    def picture(self, phase: float) -> ColouredMesh:
        """The tractor; nothing of it moves."""
        from dune_rl.bodies.meshes.vehicles import draw_tractor

        return draw_tractor(self)
