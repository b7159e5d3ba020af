"""Gymnasium ids under `dune_rl/`, registered by entry point: `gymnasium.make` needs no import."""

import gymnasium

_WORLDS = ("flat", "inspection", "construction", "rubicon", "island")


def register_envs() -> None:
    """Register one id for each world, such as `dune_rl/Inspection-v0`; twice is harmless."""
    for world in _WORLDS:
        name = f"dune_rl/{world.capitalize()}-v0"
        if name not in gymnasium.registry:
            gymnasium.register(name, entry_point="dune_rl:gym_env", kwargs={"world": world})
