"""The worlds there are, by name: ours, those of installed packages, and those that a program registers."""

import json
import warnings
from collections.abc import Callable
from typing import Any, ClassVar

from dune_rl import plugins
from dune_rl.errors import WorldError
from dune_rl.worlds.construction.build import ConstructionConf, build_construction
from dune_rl.worlds.flat import FlatConf, build_flat
from dune_rl.worlds.from_function import Build, WorldKind, kind_of
from dune_rl.worlds.importing.heightmap.build import HeightmapConf, build_heightmap
from dune_rl.worlds.importing.mesh.build import MeshConf, build_mesh
from dune_rl.worlds.importing.sdf.build import SdfConf, build_sdf
from dune_rl.worlds.importing.untrusted_files import WorldWarning
from dune_rl.worlds.inspection.build import InspectionConf, build_inspection
from dune_rl.worlds.island import IslandConf, build_island
from dune_rl.worlds.rubicon.build import RubiconConf, build_rubicon
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.validation import check_world
from dune_rl.worlds.world import World

_OURS: dict[str, tuple[type[WorldSettings], Callable[[Any], World]]] = {
    "flat": (FlatConf, build_flat),
    "inspection": (InspectionConf, build_inspection),
    "construction": (ConstructionConf, build_construction),
    "rubicon": (RubiconConf, build_rubicon),
    "island": (IslandConf, build_island),
    "mesh": (MeshConf, build_mesh),
    "heightmap": (HeightmapConf, build_heightmap),
    "sdf": (SdfConf, build_sdf),
}
_USERS: dict[str, WorldKind] = {}


class _UserSettings(WorldSettings):
    # A class made at run time cannot be found by its name: a worker process gets the function along.
    _kind: ClassVar[WorldKind]

    def __reduce__(self) -> tuple[Any, ...]:
        values = {field: getattr(self, field) for field in type(self).model_fields}
        return _revived, (self.name, type(self)._kind.function, values)

    def __hash__(self) -> int:
        # Users may have settings that are lists.
        return hash((type(self), self.model_dump_json()))


def names() -> list[str]:
    """Every world, by the alphabet; users' packages are not imported for it."""
    return sorted({*_OURS, *user_names()})


def user_names() -> list[str]:
    """The worlds that are not ours. One of a package that takes the name of ours is a `WorldWarning`."""
    found = plugins.worlds()
    for name in _OURS:
        for point in found.pop(name, ()):
            warnings.warn(
                f"{_origin(name, point)}, a name that dune_rl has given to a world of its own: it is left "
                "out. Give the entry point another name.",
                WorldWarning,
                stacklevel=2,
            )
    return sorted({*found, *_USERS})


def is_loaded(name: str) -> bool:
    """Whether the settings of a world are known without importing a user's package."""
    return name in _OURS or name in _USERS


def settings_class(name: str) -> type[WorldSettings] | None:
    """The settings of the world `name`, None where there is none; `WorldError` for a broken package."""
    if name in _OURS:
        return _OURS[name][0]
    if name not in _USERS:
        points = plugins.worlds().get(name, [])
        if not points:
            return None
        if len(points) > 1:
            packages = " and ".join(plugins.package(point) for point in points)
            raise WorldError(f"the packages {packages} both bring a world {name!r}: uninstall one of them.")
        origin = _origin(name, points[0])
        try:
            function = points[0].load()
        except Exception as error:
            raise WorldError(
                f"{origin}, which cannot be imported: {type(error).__name__}: {error}."
            ) from error
        _remember(name, function, origin)
    return _USERS[name].settings


def ours(values: dict[str, Any]) -> WorldSettings:
    """Settings of a world of ours, from their JSON; `ValueError` where they are not valid."""
    if values.get("name") not in _OURS:
        raise ValueError(f"no world of ours: {values.get('name')!r}")
    return _OURS[values["name"]][0].model_validate_json(json.dumps(values))


def register(function: Build, name: str | None = None) -> None:
    """Make the world that `function` builds known in this process as `name`, else by the function's name.

    To register a function again replaces it, as when a notebook's cell runs
    twice. Raises `WorldError` for a name that is taken, and for a function
    whose parameters cannot be settings.
    """
    name = name if name is not None else str(getattr(function, "__name__", function))
    where = f"{getattr(function, '__module__', '?')}:{getattr(function, '__qualname__', function)}"
    if not plugins.VALID_NAME.fullmatch(name):
        raise WorldError(f"a world cannot be called {name!r}: take letters, digits and _, a letter first.")
    if name in _OURS:
        raise WorldError(f"{where} cannot be the world {name!r}, which dune_rl has: choose another name.")
    before = _USERS.get(name)
    if before is not None and _place(before.function) != _place(function):
        raise WorldError(
            f"{where} cannot be the world {name!r}, which {before.function.__module__}:"
            f"{before.function.__qualname__} is: choose another name."
        )
    _remember(name, function, f"the world {name!r} is {where}")


def build(conf: WorldSettings) -> World:
    """The world of `conf`. A user's is checked: `WorldError` where it is unsound."""
    if not isinstance(conf, _UserSettings):
        settings, function = _OURS[conf.name]
        assert type(conf) is settings
        return function(conf)
    kind = type(conf)._kind
    try:
        world = kind.build(conf)
    except Exception as error:
        error.add_note(f"{kind.origin}; it was called with {conf!r}")
        raise
    if not isinstance(world, World):
        raise WorldError(f"{kind.origin}, which must return a World, and returned {world!r:.80}.")
    check_world(world)
    return world


def _remember(name: str, function: Build, origin: str) -> None:
    kind = kind_of(function, name, origin, _UserSettings)
    assert issubclass(kind.settings, _UserSettings)
    kind.settings._kind = kind
    _USERS[name] = kind


def _revived(name: str, function: Build, values: dict[str, Any]) -> WorldSettings:
    if name not in _USERS:
        register(function, name)
    return _USERS[name].settings.model_validate(values)


def _origin(name: str, point: Any) -> str:
    return f"the package {plugins.package(point)} brings the world {name!r} as {point.value}"


def _place(function: Any) -> tuple[str, str]:
    return function.__module__, function.__qualname__
