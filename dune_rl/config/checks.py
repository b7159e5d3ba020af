"""Faults in settings, put into words that say what to write instead."""

import types
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from dune_rl.behaviours.registry import BEHAVIOURS
from dune_rl.bodies.motion import MOTION_MODELS
from dune_rl.bodies.registry import BODIES
from dune_rl.config.shorthands import SHORTHANDS
from dune_rl.core.errors import ConfigError, DuneError
from dune_rl.core.registry import Registry
from dune_rl.core.suggestions import closest, one_of
from dune_rl.core.untrusted_files import printable
from dune_rl.env.curriculum import CURRICULA
from dune_rl.learning.networks.registry import ENCODERS
from dune_rl.learning.registry import ALGORITHMS
from dune_rl.metrics.registry import METRICS
from dune_rl.robots.registry import ROBOTS
from dune_rl.sensors.registry import SENSORS
from dune_rl.tasks.registry import REWARDS, START_SOURCES, TERMINATIONS
from dune_rl.worlds.registry import WORLDS

Model = TypeVar("Model", bound=BaseModel)

# The registry whose parts' settings a settings class stands for.
_REGISTRIES: Mapping[type[BaseModel], Registry[Any]] = {
    registry.base: registry
    for registry in (
        *(WORLDS, ROBOTS, BODIES, SENSORS, BEHAVIOURS, ALGORITHMS, ENCODERS, REWARDS, TERMINATIONS, METRICS),
        *(START_SOURCES, MOTION_MODELS, CURRICULA),
    )
}
_RANGES = {
    "greater_than_equal": ("ge", "at least"),
    "greater_than": ("gt", "above"),
    "less_than_equal": ("le", "at most"),
    "less_than": ("lt", "below"),
    "multiple_of": ("multiple_of", "a multiple of"),
}
# Larger whole numbers may exceed the largest floating-point number, 1.8e308.
_MOST_DIGITS, _MOST_BITS = 300, 1_000
# Letters of a value in a message.
_LONGEST_VALUE = 300
# By the beginning of pydantic's name of an error.
_KINDS = {
    "string_too_short": "text that is not empty",
    "missing": "a longer list",
    "int": "a whole number",
    "float": "a number",
    "finite_number": "a finite number",
    "bool": "true or false",
    "string": "text",
    "tuple": "a list",
    "list": "a list",
    "model": "a section with settings of its own",
    "dict": "a section with settings of its own",
    "none": "null",
}


def validate(model: type[Model], data: Mapping[str, Any], earlier: Sequence[str] = ()) -> Model:
    """The settings in `data`, or a `ConfigError` with a line for each fault, the `earlier` ones first."""
    try:
        settings = model.model_validate(data)
    except ValidationError as error:
        raise ConfigError("\n".join(unique_lines([*earlier, *describe_faults(error, model, data)]))) from None
    except OverflowError:
        # Of checks that compute with what is a whole number.
        large = [f"{_dotted(path)} must be a smaller number" for path in _enormous_numbers(data)]
        lines = [*earlier, *(large or ["a number in the settings is too large"])]
        raise ConfigError("\n".join(unique_lines(lines))) from None
    if earlier:
        raise ConfigError("\n".join(unique_lines(earlier)))
    return settings


def _enormous_numbers(data: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Paths of the whole numbers in `data`, also as text, that have no floating-point number."""
    if isinstance(data, Mapping):
        for key, value in data.items():
            yield from _enormous_numbers(value, (*path, key))
    elif isinstance(data, list | tuple):
        for index, value in enumerate(data):
            yield from _enormous_numbers(value, (*path, index))
    elif isinstance(data, int):
        if data.bit_length() > _MOST_BITS:
            yield path
    elif isinstance(data, str) and len(data) > _MOST_DIGITS and data.strip("+-_.0123456789") == "":
        yield path


def unique_lines(lines: Iterable[str]) -> list[str]:
    """The same lines in the same order, each once."""
    return list(dict.fromkeys(lines))


def describe_faults(error: ValidationError, model: type[BaseModel], data: Mapping[str, Any]) -> list[str]:
    """One sentence for every setting at fault; the members of a union count as one."""
    by_path: dict[tuple[str | int, ...], list[ErrorDetails]] = {}
    for detail in error.errors():
        by_path.setdefault(_path_in(data, detail), []).append(detail)
    # A list short of its faulty items is reported by these, or by what is in them.
    inner = {path[:end] for path in by_path for end in range(len(path))}
    return [
        _sentence(path, details, model, data)
        for path, details in by_path.items()
        if not (details[0]["type"] == "too_short" and path in inner)
    ]


def unknown_setting(path: Sequence[str | int], model: type[BaseModel], data: Mapping[str, Any]) -> str:
    """What to write instead of a setting that does not exist."""
    name = _dotted(path)
    section = _section(path[:-1], model, data)
    siblings = list(section.model_fields) if section else []
    if "agents" in siblings:
        # They write into it.
        after = siblings.index("agents") + 1
        siblings[after:after] = SHORTHANDS
    match = closest(str(path[-1]), siblings)
    if match:
        return f"{name} is not a setting; did you mean {_dotted((*path[:-1], match))}?"
    # The first one of the shortest.
    paths = sorted(reversed(_all_paths(model, data)), key=lambda other: -other.count("."))
    elsewhere = {other.rpartition(".")[2]: other for other in paths}
    registry = _registry_of(section) if section else None
    known = str(path[-1]) in elsewhere
    if section and registry and not known and (others := _parts_with(str(path[-1]), registry)):
        own = section.model_fields[registry.tag].default
        return f"{name} is not a setting of {own}, but of {one_of(others)}"
    # There are many of them, so that some are always a little alike.
    match = closest(str(path[-1]), elsewhere, 0.8)
    if match:
        return f"{name} is not a setting; did you mean {elsewhere[match]}?"
    place = _dotted(path[:-1]) or "the top level"
    return f"{name} is not a setting; {place} has {', '.join(siblings)}"


def _parts_with(setting: str, registry: Registry[Any]) -> list[str]:
    """The names of the parts that have the setting."""
    found = []
    for name in registry.names():
        # A broken package is reported where it is used.
        with suppress(DuneError):
            part = registry.settings_class(name)
            if part is not None and setting in part.model_fields:
                found.append(name)
    return found


def _registry_of(section: type[BaseModel]) -> Registry[Any] | None:
    """The registry of the part whose settings `section` are."""
    return next((each for base, each in _REGISTRIES.items() if issubclass(section, base)), None)


def _path_in(data: Any, detail: ErrorDetails) -> tuple[str | int, ...]:
    """The place of a fault in the data: pydantic's, without the names of union members in between."""
    location = detail["loc"]
    absent = detail["type"] == "missing"
    path: list[str | int] = []
    for position, part in enumerate(location):
        last = position == len(location) - 1
        if isinstance(data, Mapping) and (part in data or (absent and last)):
            path.append(part)
            data = data.get(part)
        elif isinstance(data, Sequence) and not isinstance(data, str) and isinstance(part, int):
            path.append(part)
            data = data[part] if part < len(data) else None
    return tuple(path)


def _sentence(
    path: tuple[str | int, ...], details: list[ErrorDetails], model: type[BaseModel], data: Mapping[str, Any]
) -> str:
    name, first = _dotted(path), details[0]
    if first["type"] == "extra_forbidden":
        return unknown_setting(path, model, data)
    if first["type"] == "missing":
        return f"{name} is missing; give it a value{_meant_instead(path[:-1], data)}"
    if first["type"] in ("value_error", "assertion_error"):
        message = str(first["ctx"]["error"])
        return f"{name}: {message}" if name else message
    wanted = [want for detail in details if (want := _requirement(detail)) is not None]
    if not wanted:
        return f"{name}: {first['msg']}"
    return f"{name} must be {' or '.join(unique_lines(wanted))} (got {_quoted(_value_at(path, data))})"


def _meant_instead(section: tuple[str | int, ...], data: Mapping[str, Any]) -> str:
    """The section whose name was perhaps misspelt, where another name began a section that lacks settings."""
    beside = _value_at(section[:-1], data) if section else None
    if not isinstance(beside, Mapping):
        return ""
    near = closest(str(section[-1]), [str(name) for name in beside if name != section[-1]])
    return f"; or did you mean {_dotted((*section[:-1], near))}?" if near else ""


def _requirement(detail: ErrorDetails) -> str | None:
    kind, context = detail["type"], detail.get("ctx", {})
    if kind in _RANGES:
        key, words = _RANGES[kind]
        return f"{words} {context[key]}"
    if kind in ("literal_error", "enum", "union_tag_invalid"):
        choices = context.get("expected", context.get("expected_tags", ""))
        return "one of " + choices.replace("'", "").replace(" or ", ", ")
    if kind == "too_short":
        if isinstance(detail["input"], Mapping):
            return "a section with at least one entry"
        return f"a list of at least {context['min_length']}"
    if kind == "too_long":
        return f"a list of at most {context['max_length']}"
    for prefix, words in _KINDS.items():
        if kind == prefix or kind.startswith(prefix + "_"):
            return words
    return None


def _value_at(path: Iterable[str | int], data: Any) -> Any:
    for part in path:
        data = data[part]
    return data


def _quoted(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return printable(repr(value), _LONGEST_VALUE)


def _dotted(path: Iterable[str | int]) -> str:
    return ".".join(map(str, path))


def members_of_type(annotation: Any) -> Iterator[Any]:
    """The members of a type: of `Annotated[A | B | None, ...]` they are A and B."""
    if get_origin(annotation) is Annotated:
        yield from members_of_type(get_args(annotation)[0])
    elif get_origin(annotation) in (Union, types.UnionType):
        for inner in get_args(annotation):
            yield from members_of_type(inner)
    else:
        yield annotation


def _element(annotation: Any) -> Any | None:
    """The type of what a list or a dictionary of this type holds; None for another type."""
    for member in members_of_type(annotation):
        arguments = get_args(member)
        if get_origin(member) is dict:
            return arguments[1]
        if get_origin(member) in (tuple, list) and arguments:
            return arguments[0]
    return None


def _settings_class(annotation: Any, value: Any, key: str | int) -> type[BaseModel] | None:
    """The settings class of a type that a value belongs to: by the part that the value, or its key, names."""
    members = list(members_of_type(annotation))
    candidates = [each for each in members if isinstance(each, type) and issubclass(each, BaseModel)]
    data = value if isinstance(value, Mapping) else {}
    for candidate in candidates:
        registry = _REGISTRIES.get(candidate)
        name = data.get(registry.tag, key) if registry is not None else None
        if registry is not None and isinstance(name, str):
            # A broken package is reported when its settings are checked.
            with suppress(DuneError):
                known = registry.settings_class(name)
                if known is not None:
                    return known
    for candidate in candidates:
        field = candidate.model_fields.get("name")
        if field is not None and "name" in data and field.default == data["name"]:
            return candidate
    return candidates[0] if candidates else None


def _section(path: Iterable[str | int], model: type[BaseModel], data: Any) -> type[BaseModel] | None:
    """The settings class of the section at a path."""
    annotation: Any = model
    key: str | int = ""
    for part in path:
        element = _element(annotation)
        if element is not None:
            annotation = element
        else:
            section = _settings_class(annotation, data, key)
            if section is None or part not in section.model_fields:
                return None
            annotation = section.model_fields[str(part)].annotation
        data, key = data[part], part
    return _settings_class(annotation, data, key)


def _all_paths(annotation: Any, data: Any, path: str = "") -> list[str]:
    """The dotted paths of all settings, with the entries of dictionaries that the data has."""
    prefix = f"{path}." if path else ""
    element = _element(annotation)
    if element is not None:
        entries = data.items() if isinstance(data, Mapping) else ()
        inner = [_all_paths(element, value, f"{prefix}{key}") for key, value in entries]
        return [each for paths in inner for each in paths] or [path]
    section = _settings_class(annotation, data, path.rpartition(".")[2])
    if section is None:
        return [path]
    given = data if isinstance(data, Mapping) else {}
    paths: list[str] = []
    for name, field in section.model_fields.items():
        paths += _all_paths(field.annotation, given.get(name), prefix + name)
    return paths
