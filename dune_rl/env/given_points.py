"""Places that settings give to agent groups: whether their bodies can be there."""

import numpy as np

from dune_rl.bodies.settings import BodySettings
from dune_rl.env.agent_group import AgentGroup
from dune_rl.worlds.walkable_points import PointWords, TerrainLimits, check_points
from dune_rl.worlds.world import World


def check_places(group: AgentGroup, world: World, *, only_edge: bool) -> None:
    """Raise `WorldError` with a line for each of the places of a group's behaviour where it can never be.

    With `only_edge` they need only be inside the world, as where worlds are drawn that differ in the rest.
    """
    setup = group.setup
    if not setup.places or not isinstance(setup.body, BodySettings):
        return
    deepest = setup.body.max_water_m
    limits = None if only_edge else TerrainLimits(radius_m=0.0, max_slope_deg=90.0, max_water_m=deepest)
    words = PointWords("place", f"{setup.settings}.controller.places", f"{setup.settings}.body")
    check_points(world, np.array(setup.places, float), limits, words)
