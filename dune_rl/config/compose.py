"""Settings composed by Hydra from `conf/` and overrides, and validated as a whole."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from typing_extensions import TypeVar

from dune_rl.config import group_options, shorthands
from dune_rl.config.checks import members_of_type, unique_lines, validate
from dune_rl.config.commands import BenchmarkConf, EvaluateConf, ForecastConf, GazeboConf, RosConf, ViewConf
from dune_rl.config.hydra_session import (
    WHOLE_SETTINGS,
    compose_config,
    hydra_session,
    present_groups,
    stated_keys,
    to_plain,
)
from dune_rl.config.overrides import (
    SCENARIO,
    ParsedOverrides,
    option_names,
    parse_override,
    parse_overrides,
    sweep_values,
)
from dune_rl.config.saved import upgrade_saved
from dune_rl.config.schema import Conf, EnvConf
from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import copy_nested, merge_nested
from dune_rl.core.suggestions import one_of

Model = TypeVar("Model", bound=EnvConf, default=EnvConf)

# The file of conf/ of each command.
_FILES: Mapping[type[EnvConf], str] = {
    Conf: "train",
    EvaluateConf: "evaluate",
    ForecastConf: "forecast",
    GazeboConf: "export",
    RosConf: "ros",
    ViewConf: "view",
    BenchmarkConf: "benchmark",
}
# The settings of commands that are texts, such as names of files, and two actions that take a folder.
_TEXTS = frozenset({"join", "verify"}).union(
    name
    for model in _FILES
    for name, field in model.model_fields.items()
    if str in members_of_type(field.annotation)
)
# Groups of agents are no options, whatever they are called.
_GROUPS = ("agents", "actors")
# Of environments made in Python and of benchmarks, unless a scenario or an experiment chooses one.
_DEFAULT_WORLD = "inspection"


def compose(
    model: type[Model],
    overrides: Sequence[str] = (),
    config_dirs: Sequence[str] = (),
    saved: Mapping[str, Any] | None = None,
) -> Model:
    """The settings of the command whose settings class is `model`; `ConfigError` names every fault.

    `overrides` are words as on the command line; `config_dirs` are further folders of options. Where `saved`
    settings of a run are given, the overrides change those. A benchmark has a default world.
    """
    name = _FILES[model]
    with hydra_session(config_dirs) as loader:
        request = parse_overrides(overrides, loader, _TEXTS)
        if model is BenchmarkConf:
            request = _with_default_world(name, request, loader)
        swept = [str(o.input_line) for o in (*request.groups, *request.values) if o.is_sweep_override()]
        if swept:
            raise ConfigError(f"{swept[0]} has several values; add -m to run them all, or quote the value")
        config = compose_config(name, request.without_group_changes())
        if saved is None:
            return _finish(model, to_plain(config), request, loader)
        saved = upgrade_saved(saved)
        if request.has_scenario:
            saved = _change_saved(saved, name, request)
        data = _overlay_saved(saved, config, request, model)
        return _finish(model, data, request, loader, saved_groups=saved["agents"])


def compose_environment(
    world: str | Mapping[str, Any] | None,
    overrides: Iterable[str] = (),
    settings: Mapping[str, Any] | None = None,
    model: type[Model] = EnvConf,  # type: ignore[assignment]
    *,
    config_dirs: Sequence[str] = (),
) -> Model:
    """The settings of an environment alone.

    In `settings` a string chooses an option of a group (`actors="none"`), and anything else changes values.
    They take precedence over the overrides. A `world` of None is that of a scenario, or else inspection.
    """
    if isinstance(overrides, str) or isinstance(config_dirs, str):
        raise ConfigError("overrides and config_dirs are lists of strings; write [...] round the one")
    with hydra_session(config_dirs) as loader:
        words, changes = _words_and_changes(world, overrides, settings or {}, loader)
        request = _with_default_world("environment", parse_overrides(words, loader, _TEXTS), loader)
        data = to_plain(compose_config("environment", request.without_group_changes()))
        return _finish(model, data, request, loader, changes, set_in_python=settings or {})


def _words_and_changes(
    world: str | Mapping[str, Any] | None,
    overrides: Iterable[str],
    settings: Mapping[str, Any],
    loader: ConfigLoader,
) -> tuple[list[str], dict[str, Any]]:
    """Settings of Python as overrides where they choose options, and what they change beside."""
    words = list(overrides)
    changes: dict[str, Any] = {}
    for name, value in {"world": world, **settings}.items():
        if name in ("world", SCENARIO) and value is None:
            continue
        if name == SCENARIO and not isinstance(value, str):
            options = one_of(option_names(loader, SCENARIO))
            raise ConfigError(f"{SCENARIO} must be the name of an option: choose {options} (got {value!r})")
        if isinstance(value, Mapping) and "name" in value and name not in _GROUPS:
            words.append(f"{name}={value['name']}")
            # The option states its own name, which need not be that of its file.
            changes[name] = {key: each for key, each in value.items() if key != "name"}
        elif name == "sensors" and isinstance(value, Sequence) and not isinstance(value, str):
            # As on the command line: a list has the enabled sensors.
            changes[name] = {"enabled": list(value)}
        elif isinstance(value, str):
            words.append(f"{name}={value}")
        elif name == "actors" and isinstance(value, list | tuple) and {*map(type, value)} == {str}:
            words.append(f"actors=[{','.join(value)}]")
        elif isinstance(value, Sequence):
            changes[name] = list(value)
        else:
            changes[name] = value
    return words, changes


def _with_default_world(name: str, request: ParsedOverrides, loader: ConfigLoader) -> ParsedOverrides:
    """The overrides, with a world where neither they nor the file `name` choose one."""
    chosen = {*request.faulty_groups, *(override.key_or_group for override in request.groups)}
    if "world" in chosen or "world" in present_groups(name, request):
        return request
    default = parse_overrides([f"world={_DEFAULT_WORLD}"], loader)
    return replace(request, groups=(*default.groups, *request.groups))


def check_sweep(overrides: Sequence[str], config_dirs: Sequence[str] = ()) -> list[str]:
    """The overrides in Hydra's own form, after every value of each sweep has been validated.

    Each value is validated beside the first values of the other sweeps;
    `ConfigError` names the faults of all.
    """
    with hydra_session(config_dirs) as loader:
        request = parse_overrides(overrides, loader, _TEXTS)
        faults = list(request.faults)
        for variant in _sweep_variants(request):
            data = to_plain(compose_config("train", variant.without_group_changes()))
            try:
                _finish(Conf, data, variant, loader)
            except ConfigError as error:
                faults += str(error).splitlines()
        if faults:
            raise ConfigError("\n".join(unique_lines(faults)))
        present = present_groups("train", request)
        return request.hydra_words(present, stated=stated_keys(request, present))


def override_value(overrides: Sequence[str], key: str) -> Any | None:
    """The value of a setting in the overrides; None where they do not set it.

    Raises ConfigError for the several values of a sweep.
    """
    value = None
    parser = OverridesParser.create()
    for text in overrides:
        if text.lstrip("+").startswith(f"{key}="):
            # What cannot be read is reported when all is composed.
            with suppress(HydraException, ValueError):
                override = parse_override(parser, text, _TEXTS)
                if override.is_sweep_override():
                    raise ConfigError(f"{text} has several values; give one, or quote the value")
                value = override.value()
    return value


def _finish(
    model: type[Model],
    data: dict[str, Any],
    request: ParsedOverrides,
    loader: ConfigLoader,
    changes: Mapping[str, Any] | None = None,
    set_in_python: Mapping[str, Any] | None = None,
    saved_groups: Mapping[str, Any] | None = None,
) -> Model:
    """The settings in `data`, or a `ConfigError` that names all faults, those of the overrides too.

    `changes` are settings given in Python beside the overrides, of the sections `set_in_python`;
    `saved_groups` the agent groups of a run that the overrides change.
    """
    set_in_python = set_in_python or {}
    # What a caller gave in Python stays as it is.
    data, changes = copy_nested(data), copy_nested(changes or {})
    if request.has_scenario:
        given = set_in_python.get("world")
        group_options.drop_other_options(
            data, {*request.overridden_keys("world"), *(given if isinstance(given, Mapping) else ())}
        )
    data = merge_nested(data, {name: value for name, value in changes.items() if name not in _GROUPS})
    faults = _request_faults(request, data, loader)
    group_options.change_groups(data, "actors", request, changes)
    if changes.get("agents") is not None:
        data["agents"] = changes["agents"]
    faults += _describe_replaced(data, request, set_in_python)
    faults += group_options.expand_robots(data, loader)
    keeps_actors = "actors" in set_in_python or (
        saved_groups is not None and "actors" not in request.chosen()
    )
    replaced_actors = group_options.replace_default_actors(data, keep=keeps_actors)
    for key in (str(override.key_or_group) for override in request.group_changes):
        section, name, *path = key.split(".")
        if section == "actors" and path and name in replaced_actors:
            faults.append(
                f"{key}: the actors of the world's file take the place of {name}; set "
                f"actors.{group_options.WORLD_ACTORS}.{'.'.join(path)}, or choose actors=walkers"
            )
    try:
        data, origins = shorthands.join_groups(data)
    except ValueError as error:
        raise ConfigError("\n".join([*faults, str(error)])) from None
    if saved_groups is not None:
        data["agents"], origins = group_options.change_saved_groups(saved_groups, data["agents"], request)
    group_options.change_groups(data, "agents", request)
    faults += group_options.expand_groups(data, loader)
    try:
        return validate(model, shorthands.complete_sections(data), faults)
    except ConfigError as error:
        # Paths are named as they were written.
        written = {} if request.overridden_keys("agents") else origins
        raise ConfigError(group_options.name_shorthands(str(error), written)) from None


def _describe_replaced(
    data: Mapping[str, Any], request: ParsedOverrides, set_in_python: Mapping[str, Any]
) -> list[str]:
    """Faults of shorthands that were set beside what takes their place."""
    overridden = {str(o.key_or_group).split(".")[0] for o in (*request.groups, *request.values)}
    faults = []
    if data.get("agents") is not None and request.has_scenario:
        faults.append(
            f"agents takes the place of the actors of the {SCENARIO}: leave one of the two out, or add "
            "groups with +actors.NAME={...}"
        )
    for section, replaced in (("agents", shorthands.SHORTHANDS), ("robots", ("robot",))):
        for name in replaced if data.get(section) is not None else ():
            if name in overridden or name in set_in_python:
                faults.append(f"{section} takes the place of {name}; leave one of them out")
    return faults


def _request_faults(request: ParsedOverrides, data: dict[str, Any], loader: ConfigLoader) -> list[str]:
    """The faults of the overrides. A missing world is one; `data` gets another, to validate the rest."""
    faults = [*request.faults, *group_options.describe_shared_groups(request)]
    world = data.get("world")
    if not isinstance(world, dict) or "name" not in world:
        if not request.faulty_groups & {"world", *WHOLE_SETTINGS}:
            options = option_names(loader, "world")
            faults.append(f"choose a world: +world=NAME with {one_of(options)}")
        data["world"] = {"name": "flat"}
    return faults


def _change_saved(saved: Mapping[str, Any], name: str, request: ParsedOverrides) -> dict[str, Any]:
    """Saved settings with the values that the scenario of the overrides states; `name` is the file composed.

    World and actors are those of the overrides.
    """
    alone = replace(
        request,
        groups=tuple(o for o in request.groups if o.key_or_group == SCENARIO),
        values=(),
    )
    with_it = to_plain(compose_config(name, alone))
    changes = group_options.difference(to_plain(compose_config(name, replace(alone, groups=()))), with_it)
    kept = {key: value for key, value in saved.items() if key != "world"}
    return merge_nested(kept, {key: value for key, value in changes.items() if key in kept})


def _overlay_saved(
    saved: Mapping[str, Any], config: DictConfig, request: ParsedOverrides, model: type[EnvConf]
) -> dict[str, Any]:
    """Saved settings but for agent groups, changed by the overrides; `config` has the sections they lack."""
    if any(override.key_or_group == "experiment" for override in request.groups):
        raise ConfigError("a saved run brings its own settings; leave +experiment out")
    names = (model if model is Conf else EnvConf).model_fields.keys() - {"agents"}
    chosen = {override.key_or_group for override in request.groups}
    kept = {name: saved[name] for name in names if name in saved and name not in chosen}
    overlaid = OmegaConf.create({**to_plain(config), **kept})
    if "physics" in chosen:
        # On another engine, too, a policy decides as often as it learned to.
        repeat = saved.get("physics", {}).get("action_repeat", 1)
        OmegaConf.update(overlaid, "physics.action_repeat", repeat, force_add=True)
    for override in request.without_group_changes().values:
        if not override.is_delete():
            key = override.key_or_group
            OmegaConf.update(overlaid, key, OmegaConf.select(config, key), merge=False, force_add=True)
    return to_plain(overlaid)


def _sweep_variants(request: ParsedOverrides) -> Iterator[ParsedOverrides]:
    """The overrides with the first value of each sweep, then with each other value in turn."""
    values = {id(each): sweep_values(each) for each in (*request.groups, *request.values)}
    variants = [(0, 0), *((key, index) for key, found in values.items() for index in range(1, len(found)))]
    for swept, index in variants:
        groups, settings = (
            tuple(values[id(each)][index if id(each) == swept else 0] for each in overrides)
            for overrides in (request.groups, request.values)
        )
        yield replace(request, groups=groups, values=settings, engine=())
