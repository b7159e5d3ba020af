"""Animals: cow, sheep and dog. docs/how_to/actors.md has the sources of their figures."""

from typing import Literal

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
        from dune_rl.bodies.meshes.animals import draw_cow

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
        from dune_rl.bodies.meshes.animals import draw_sheep

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
        from dune_rl.bodies.meshes.animals import draw_dog

        return draw_dog(self, phase)
