"""Gymnasium ids under `dune_rl/`, registered by entry point: `gymnasium.make` needs no import."""

import importlib.util
import re

from dune_rl.core import plugins

try:
    import gymnasium
except ModuleNotFoundError:
    # `python -m dune_rl.doctor` shall start without it, and name it.
    gymnasium = None  # type: ignore[assignment]

# A live page needs viser; Gymnasium's own check of environments tries every mode that is named here.
RENDER_MODES = ["human", "rgb_array"] if importlib.util.find_spec("viser") else ["rgb_array"]
# `gymnasium.make` reads it from the entry point, before there is an environment.
RENDER_METADATA = {"render_modes": RENDER_MODES, "render_fps": 20}

_WORLDS = ("flat", "inspection", "construction", "rubicon", "island")


def register_envs() -> None:
    """Register one id for each world, such as `dune_rl/Inspection-v0`; twice is harmless."""
    for world in (*_WORLDS, *plugins.entry_points_by_name("dune_rl.worlds")):
        register_env(world)


def register_env(world: str) -> None:
    """Register the id of one world, of `lunar_base` `dune_rl/LunarBase-v0`; nothing without Gymnasium."""
    title = "".join(part[:1].upper() + part[1:] for part in re.split("[_-]", world))
    name = f"dune_rl/{title}-v0"
    if gymnasium is not None and name not in gymnasium.registry:
        gymnasium.register(
            name,
            entry_point="dune_rl:gym_env",
            vector_entry_point="dune_rl:gym_vector_env",
            kwargs={"world": world},
        )
