"""Settings composed by Hydra from `conf/`, and checked as a whole."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar, overload

import yaml
from hydra import compose as hydra_compose
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.core.singleton import Singleton
from hydra.errors import HydraException
from hydra.version import setbase
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dune_rl import paths
from dune_rl.config import overrides as command_line
from dune_rl.config.checks import unique, validated
from dune_rl.config.expand import expand_options, merged
from dune_rl.config.migration import migrated, move_renamed
from dune_rl.config.options import offer_user_parts
from dune_rl.config.schema import BenchmarkConf, Conf, EnvConf, EvaluateConf, ViewConf
from dune_rl.errors import ConfigError
from dune_rl.suggestions import one_of

Model = TypeVar("Model", bound=EnvConf)

# Groups of agents are no options, whatever they are called.
_GROUPS = ("agents", "actors")
# What `agents` takes the place of.
_SHORTHANDS = ("robot", "robots", "actors")


def compose(overrides: Sequence[str] = (), config_dirs: Sequence[str] = ()) -> Conf:
    """The settings of a training run; `ConfigError` names every fault.

    `overrides` are words as on the command line; `config_dirs` are further
    folders of options.
    """
    return _compose(Conf, "train", overrides, config_dirs)


def compose_evaluation(
    overrides: Sequence[str] = (), config_dirs: Sequence[str] = (), saved: Mapping[str, Any] | None = None
) -> EvaluateConf:
    """The settings of an evaluation; where `saved` settings of a run are given, overrides change those."""
    return _compose(EvaluateConf, "evaluate", overrides, config_dirs, saved)


def compose_view(
    overrides: Sequence[str] = (), config_dirs: Sequence[str] = (), saved: Mapping[str, Any] | None = None
) -> ViewConf:
    """The settings of a look; where `saved` settings of a run are given, overrides change those."""
    return _compose(ViewConf, "view", overrides, config_dirs, saved)


def compose_benchmark(overrides: Sequence[str] = (), config_dirs: Sequence[str] = ()) -> BenchmarkConf:
    """The settings of a benchmark, which has a world of its own unless told otherwise."""
    return _compose(BenchmarkConf, "benchmark", overrides, config_dirs)


def compose_resumed(overrides: Sequence[str], config_dirs: Sequence[str], saved: Mapping[str, Any]) -> Conf:
    """The settings of a saved run, changed by the overrides."""
    return _compose(Conf, "train", overrides, config_dirs, saved)


@overload
def compose_environment(
    world: str | Mapping[str, Any],
    overrides: Iterable[str] = (),
    settings: Mapping[str, Any] | None = None,
    *,
    config_dirs: Sequence[str] = (),
) -> EnvConf: ...
@overload
def compose_environment(
    world: str | Mapping[str, Any],
    overrides: Iterable[str],
    settings: Mapping[str, Any] | None,
    model: type[Model],
    *,
    config_dirs: Sequence[str] = (),
) -> Model: ...
def compose_environment(
    world: str | Mapping[str, Any],
    overrides: Iterable[str] = (),
    settings: Mapping[str, Any] | None = None,
    model: type[EnvConf] = EnvConf,
    *,
    config_dirs: Sequence[str] = (),
) -> EnvConf:
    """The settings of an environment alone.

    In `settings` a text chooses an option of a group (`actors="none"`) and
    anything else changes values. They win over the overrides.
    """
    words = list(overrides)
    changes: dict[str, Any] = {}
    for name, value in {"world": world, **(settings or {})}.items():
        if isinstance(value, Mapping) and "name" in value and name not in _GROUPS:
            words.append(f"{name}={value['name']}")
            # The option states its own name, which need not be its file's.
            changes[name] = {key: given for key, given in value.items() if key != "name"}
        elif name == "sensors" and isinstance(value, Sequence) and not isinstance(value, str):
            # As on the command line: a list is of sensors.
            changes[name] = {"enabled": list(value)}
        elif isinstance(value, str):
            words.append(f"{name}={value}")
        elif isinstance(value, Sequence):
            changes[name] = list(value)
        else:
            changes[name] = value
    with _hydra(config_dirs) as loader:
        request = command_line.read(words, loader)
        data = merged(_plain(_composed("environment", request, loader)), changes)
        return _checked(model, data, request, loader, given=settings or {})


def check_sweep(overrides: Sequence[str], config_dirs: Sequence[str] = ()) -> list[str]:
    """The overrides as Hydra wants them, after every value of each swept one has been checked.

    Each is tried beside the first values of the others; `ConfigError` names
    the faults of all.
    """
    with _hydra(config_dirs) as loader:
        request = command_line.read(overrides, loader)
        faults = list(request.faults)
        for variant in _variants(request):
            data = _plain(_composed("train", variant, loader))
            try:
                _checked(Conf, data, request, loader)
            except ConfigError as error:
                faults += str(error).splitlines()
        if faults:
            raise ConfigError("\n".join(unique(faults)))
        present = _present("train", request)
        return request.words(present, stated=_stated(request, present))


def given(overrides: Sequence[str], key: str) -> Any | None:
    """The value that the overrides give to a setting, None where they do not name it."""
    found = None
    parser = OverridesParser.create()
    for text in overrides:
        if text.lstrip("+").startswith(f"{key}="):
            # What cannot be read is reported when all is composed.
            with suppress(HydraException):
                found = parser.parse_override(text).value()
    return found


def from_hydra(config: DictConfig) -> Conf:
    """The settings that Hydra composed for a job; they have been checked before."""
    data = _plain(config)
    move_renamed(data, warn=False)
    faults = expand_options(data, GlobalHydra.instance().config_loader())
    return validated(Conf, data, faults)


def _compose(
    model: type[Model],
    name: str,
    overrides: Sequence[str],
    config_dirs: Sequence[str],
    saved: Mapping[str, Any] | None = None,
) -> Model:
    with _hydra(config_dirs) as loader:
        request = command_line.read(overrides, loader)
        swept = [str(o.input_line) for o in (*request.groups, *request.values) if o.is_sweep_override()]
        if swept:
            raise ConfigError(f"{swept[0]} has several values; add -m to run them all, or quote the value")
        config = _composed(name, request, loader)
        data = _plain(config) if saved is None else _overlaid(migrated(saved), config, request, model)
        return _checked(model, data, request, loader)


def _checked(
    model: type[Model],
    data: dict[str, Any],
    request: command_line.Request,
    loader: ConfigLoader,
    given: Iterable[str] = (),
) -> Model:
    """The settings in `data`, or a `ConfigError` that names all faults, those of the request too.

    `given` are the sections that were set beside the request.
    """
    move_renamed(data)
    faults = [*_earlier(request, data, loader), *expand_options(data, loader)]
    if data.get("agents") is not None:
        overridden = {str(o.key_or_group).split(".")[0] for o in (*request.groups, *request.values)}
        for name in _SHORTHANDS:
            if name in overridden or name in given:
                faults.append(f"agents takes the place of {name}; leave one of them out")
    return validated(model, data, faults)


@contextmanager
def _hydra(config_dirs: Sequence[str] = ()) -> Iterator[ConfigLoader]:
    for folder in config_dirs:
        if not Path(folder).is_dir():
            raise ConfigError(f"there is no folder {folder} to read configurations from (--config-dir)")
    # Hydra is one per process; a caller may be inside a Hydra application of its own.
    before = Singleton.get_state() if GlobalHydra.instance().is_initialized() else None
    GlobalHydra.instance().clear()
    try:
        # Not `initialize_config_dir`, which knows no second folder to search.
        setbase("1.3")
        search_path = create_config_search_path(str(paths.conf_folder()))
        offer_user_parts(config_dirs)
        OmegaConf.register_new_resolver("config_dir", partial(_in_folders, tuple(config_dirs)), replace=True)
        for folder in config_dirs:
            search_path.prepend("command-line", f"file://{Path(folder).resolve()}")
        yield Hydra.create_main_hydra2("dune_rl", search_path).config_loader
    except yaml.YAMLError as error:
        raise ConfigError(f"a file of settings is no valid YAML: {' '.join(str(error).split())}") from None
    finally:
        GlobalHydra.instance().clear()
        if before is not None:
            Singleton.set_state(before)


def _in_folders(folders: Sequence[str], name: str) -> str:
    """A file in the user's folder of options, absolute: what `${config_dir:name}` stands for."""
    for folder in folders:
        path = Path(folder).resolve() / name
        if path.exists():
            return str(path)
    where = " or ".join(folders) or "a folder of options (--config-dir)"
    raise ConfigError(f"there is no file {name} in {where}")


def _composed(name: str, request: command_line.Request, loader: ConfigLoader) -> DictConfig:
    try:
        return hydra_compose(name, request.words(_present(name, request)))
    except (HydraException, OmegaConfBaseException) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError("\n".join([*request.faults, f"cannot compose the settings: {reason}"])) from None


def _present(name: str, request: command_line.Request) -> frozenset[str]:
    """The groups that are in the defaults list already, an experiment's included."""
    experiments = [o for o in request.groups if o.key_or_group == "experiment"]
    words = tuple(f"+experiment={command_line.values_of(o)[0].value()}" for o in experiments)
    return _present_for(name, words, str(GlobalHydra.instance().config_loader().get_search_path()))


@lru_cache(maxsize=32)
def _present_for(name: str, words: tuple[str, ...], _search_path: str) -> frozenset[str]:
    config = hydra_compose(name, list(words), return_hydra_config=True)
    choices = config.hydra.runtime.choices
    return frozenset(group for group in choices if group != "experiment" and not group.startswith("hydra/"))


def _stated(request: command_line.Request, present: frozenset[str]) -> set[str]:
    """The settings among the overridden ones that the YAML files state, which need no `++`."""
    config = hydra_compose(
        "train", replace(request, values=(), engine=()).words(present, first_of_sweep=True)
    )
    keys = {override.key_or_group for override in request.values}
    return {key for key in keys if OmegaConf.select(config, key, default=config) is not config}


def _plain(config: DictConfig) -> dict[str, Any]:
    try:
        data = OmegaConf.to_container(config, resolve=True)
    except OmegaConfBaseException as error:
        raise ConfigError(f"cannot resolve the settings: {str(error).splitlines()[0]}") from None
    assert isinstance(data, dict)
    return {str(key): value for key, value in data.items()}


def _earlier(request: command_line.Request, data: dict[str, Any], loader: ConfigLoader) -> list[str]:
    """The faults found so far; an absent world is one, and is stood in for, so that the rest is checked."""
    found = list(request.faults)
    world = data.get("world")
    if not isinstance(world, dict) or "name" not in world:
        if "world" not in request.faulty_groups:
            options = command_line.option_names(loader, "world")
            found.append(f"choose a world: +world=NAME with {one_of(options)}")
        data["world"] = {"name": "flat"}
    return found


def _overlaid(
    saved: Mapping[str, Any], config: DictConfig, request: command_line.Request, model: type[EnvConf]
) -> dict[str, Any]:
    """Saved settings with what was asked for put over them, and the rest of a newer schema from `config`."""
    if any(override.key_or_group == "experiment" for override in request.groups):
        raise ConfigError("a saved run brings its own settings; leave +experiment out")
    fresh = _plain(config)
    kept = model.model_fields if model is Conf else EnvConf.model_fields
    chosen = {override.key_or_group for override in request.groups}
    stays = {name: saved[name] for name in kept if name in saved and name not in chosen}
    merged = OmegaConf.create({**fresh, **stays})
    for override in request.values:
        if not override.is_delete():
            key = override.key_or_group
            OmegaConf.update(merged, key, OmegaConf.select(config, key), merge=False, force_add=True)
    return _plain(merged)


def _variants(request: command_line.Request) -> Iterator[command_line.Request]:
    """The request with the first value of each sweep, and then with each other value in turn."""
    everything = (*request.groups, *request.values)
    singles = {id(o): command_line.values_of(o) for o in everything}

    def choose(picked: Override | None, index: int) -> command_line.Request:
        def pick(override: Override) -> Override:
            return singles[id(override)][index if override is picked else 0]

        return command_line.Request(
            groups=tuple(map(pick, request.groups)),
            values=tuple(map(pick, request.values)),
            engine=(),
            faults=(),
            faulty_groups=request.faulty_groups,
        )

    yield choose(None, 0)
    for override in everything:
        for index in range(1, len(singles[id(override)])):
            yield choose(override, index)
