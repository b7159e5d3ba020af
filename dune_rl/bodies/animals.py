"""Animals: cow, sheep and dog. docs/how_to/actors.md has the sources of their figures."""

from typing import Literal

from dune_rl.bodies.settings import Quadruped
from dune_rl.rendering.scenery import ColouredMesh


class CowConf(Quadruped):
    """A black and white dairy cow."""

    name: Literal["cow"] = "cow"
    speed_mps: float = 1.4
    max_push_n: float = 2_000.0
    max_slope_deg: float = 30.0
    max_water_m: float = 0.6
    length_m: float = 2.4
    width_m: float = 0.7
    height_m: float = 1.6
    max_turn_radps: float = 1.0
    acceleration_mps2: float = 1.5
    stride_m_per_m: float = 0.63

    def picture(self, phase: float) -> ColouredMesh:
        """The cow at a phase of its stride."""
        from dune_rl.bodies.meshes.animals import draw_cow

        return draw_cow(self, phase)


class SheepConf(Quadruped):
    """A woolly sheep."""

    name: Literal["sheep"] = "sheep"
    speed_mps: float = 1.5
    max_push_n: float = 400.0
    max_slope_deg: float = 38.0
    max_water_m: float = 0.3
    length_m: float = 1.25
    width_m: float = 0.5
    height_m: float = 0.95
    max_turn_radps: float = 2.0
    acceleration_mps2: float = 2.5
    stride_m_per_m: float = 0.75

    def picture(self, phase: float) -> ColouredMesh:
        """The sheep at a phase of its stride."""
        from dune_rl.bodies.meshes.animals import draw_sheep

        return draw_sheep(self, phase)


class DogConf(Quadruped):
    """A shepherd's dog."""

    name: Literal["dog"] = "dog"
    speed_mps: float = 4.0
    max_push_n: float = 150.0
    max_slope_deg: float = 40.0
    max_water_m: float = 0.3
    length_m: float = 1.05
    width_m: float = 0.28
    height_m: float = 0.78
    max_turn_radps: float = 4.0
    acceleration_mps2: float = 5.0
    stride_m_per_m: float = 0.95

    def picture(self, phase: float) -> ColouredMesh:
        """The dog at a phase of its stride."""
        from dune_rl.bodies.meshes.animals import draw_dog

        return draw_dog(self, phase)
