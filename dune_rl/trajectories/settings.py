"""Settings of `python -m dune_rl.trajectory`, and which of its words are the world's."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import Field, model_validator
from yaml import YAMLError

from dune_rl.config.build import build_world
from dune_rl.config.checks import validate
from dune_rl.config.compose import compose_environment
from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import split_word
from dune_rl.rendering.mesh_files.files import FORMATS as MESHES
from dune_rl.trajectories.files import WALKING_ACTOR, WALKING_ACTOR_HIP_M, Appearance
from dune_rl.trajectories.plan import SPACING_M, Mode, plan_on_ground
from dune_rl.worlds.actor_trajectory import ActorTrajectory
from dune_rl.worlds.importing.actor_files import FORMATS
from dune_rl.worlds.importing.grid_files import HEIGHT_FORMATS as HEIGHT_MAPS
from dune_rl.worlds.registry import WORLDS
from dune_rl.worlds.walkable_points import TerrainLimits
from dune_rl.worlds.world import World

_TEXTS = ("out", "picture", "name", "skin", "animation")
_HINT = 'python -m dune_rl.trajectory world=inspection waypoints="[[0,0],[4,2]]" out=actor.sdf'
# The world that reads a file, by the file's ending.
_IMPORTERS = {
    **dict.fromkeys((".sdf", ".world"), "sdf"),
    **dict.fromkeys(MESHES, "mesh"),
    **dict.fromkeys(HEIGHT_MAPS, "heightmap"),
}


class PlanConf(TerrainLimits):
    """Settings of a trajectory: the way, its timing and its limits."""

    waypoints: tuple[tuple[float, float], ...]
    velocity: float = Field(1.0, gt=0.0, le=50.0)
    mode: Mode = "back_and_forth"
    pauses_s: float | tuple[float, ...] = 0.0
    delay_s: float = Field(0.0, ge=0.0, le=1e5)
    spacing_m: float = Field(SPACING_M, ge=0.005, le=5.0)
    name: str = Field("walker", min_length=1, max_length=60)

    @model_validator(mode="after")
    def _plannable(self) -> Self:
        if not self.name.isprintable():
            raise ValueError("name must be of printable characters")
        given, count = self.pauses_s, len(self.waypoints)
        if any(not 0.0 <= pause <= 1e5 for pause in (given if isinstance(given, tuple) else (given,))):
            raise ValueError("pauses_s must be from 0 to 1e5 s")
        if isinstance(given, tuple) and len(given) != count:
            raise ValueError(
                f"pauses_s must be one number, or one for each way-point: {count} of them (got {len(given)})"
            )
        return self

    def plan(self, world: World) -> ActorTrajectory:
        """The trajectory through `world`; raises `WorldError` where it cannot be walked."""
        pauses = np.broadcast_to(np.array(self.pauses_s, np.float64), len(self.waypoints))
        own = self.model_dump(include={"velocity", "mode", "delay_s", "spacing_m", "name"})
        limits = TerrainLimits(**self.model_dump(include=set(TerrainLimits.model_fields)))
        points = np.array(self.waypoints, np.float64).reshape(-1, 2)
        return plan_on_ground(world, points, pauses_s=pauses if pauses.any() else None, limits=limits, **own)


class TrajectoryConf(PlanConf):
    """Settings of `python -m dune_rl.trajectory` beside the world's."""

    out: str = Field(min_length=1)
    skin: str = Field(WALKING_ACTOR, min_length=1)
    animation: str | None = Field(None, min_length=1)
    origin_height_m: float | None = Field(None, ge=0.0, le=2.0)
    picture: str | None = None
    overwrite: bool = False

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        if Path(self.out).suffix.lower() not in FORMATS:
            raise ValueError(f"out must end in {', '.join(FORMATS)} (got {self.out!r})")
        if self.picture is not None and Path(self.picture).suffix.lower() != ".png":
            raise ValueError(f"picture must end in .png (got {self.picture!r})")
        return self

    @property
    def appearance(self) -> Appearance:
        """What an SDF says of the actor's mesh."""
        height = self.origin_height_m
        if height is None:
            height = WALKING_ACTOR_HIP_M if self.skin == WALKING_ACTOR else 0.0
        return Appearance(self.skin, self.animation or self.skin, height)

    @property
    def picture_path(self) -> Path:
        """Where the picture is written: `picture`, or beside `out`."""
        return Path(self.picture) if self.picture else Path(self.out).with_suffix(".png")


def parse_words(words: Sequence[str]) -> tuple[str, list[str], TrajectoryConf]:
    """The world, the words of its settings, and the settings of the trajectory; `ConfigError` for faults."""
    world: str | None = None
    world_words: list[str] = []
    values: dict[str, Any] = {}
    for word in words:
        key, equals, text = split_word(word)
        key = key.lstrip("+")
        if not equals:
            raise ConfigError(f"cannot read {word!r}; write key=value: {_HINT}")
        if key == "world":
            world = text
        elif key.startswith("world."):
            world_words.append(word.lstrip("+"))
        else:
            # Paths and names are taken as they are, not parsed.
            values[key] = text if key in _TEXTS else _parse(key, text)
    faults = [] if world else [f"choose a world: world=NAME or world=FILE, as in {_HINT}"]
    conf = validate(TrajectoryConf, values, faults)
    assert world is not None
    return world, world_words, conf


def plan_in_world(
    world: str | Mapping[str, Any],
    waypoints: Sequence[Sequence[float]],
    overrides: Sequence[str],
    config_dirs: Sequence[str],
    settings: Mapping[str, Any],
) -> ActorTrajectory:
    """The trajectory through a world that is chosen as on the command line (`choose_world`)."""
    conf = validate(PlanConf, {**settings, "waypoints": np.asarray(waypoints).tolist()})
    return conf.plan(choose_world(world, overrides, config_dirs))


def _parse(key: str, text: str) -> object:
    try:
        found = OmegaConf.to_object(OmegaConf.from_dotlist([f"{key}={text}"]))
    except (OmegaConfBaseException, YAMLError, ValueError) as error:
        raise ConfigError(f"cannot read {f'{key}={text}'!r}; write it as in {_HINT}") from error
    return found.get(key) if isinstance(found, dict) else None


def choose_world(
    world: str | Mapping[str, Any], overrides: Sequence[str] = (), config_dirs: Sequence[str] = ()
) -> World:
    """The world of an option's name or of a file (SDF or model folder, mesh, map of heights).

    `overrides` are words such as `world.seed=3`. Raises `ConfigError` or `WorldError` for faults.
    """
    chosen = world
    if isinstance(world, str):
        path = Path(world).expanduser()
        is_named = path.suffix.lower() in _IMPORTERS or "/" in world
        if is_named or (path.exists() and world not in WORLDS.names()):
            chosen = {"name": _importer_of(path), "path": world}
    # Actors have no say in where one may walk.
    settings = {"actors": "none"}
    return build_world(compose_environment(chosen, list(overrides), settings, config_dirs=config_dirs).world)


def _importer_of(path: Path) -> str:
    kind = ".sdf" if path.is_dir() else path.suffix.lower()
    if not path.exists():
        raise ConfigError(f"there is no file {path}: world=FILE must name one that exists")
    if kind not in _IMPORTERS:
        known = ", ".join(_IMPORTERS)
        raise ConfigError(f"{path} is no world: {kind or 'no ending'} is none of {known}")
    return _IMPORTERS[kind]
