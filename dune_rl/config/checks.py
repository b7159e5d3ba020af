"""Faults in settings, put into words that say what to write instead."""

import types
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from dune_rl.errors import ConfigError, WorldError
from dune_rl.suggestions import closest
from dune_rl.worlds.registry import WORLDS
from dune_rl.worlds.settings import WorldSettings

Model = TypeVar("Model", bound=BaseModel)

_RANGES = {
    "greater_than_equal": ("ge", "at least"),
    "greater_than": ("gt", "above"),
    "less_than_equal": ("le", "at most"),
    "less_than": ("lt", "below"),
    "multiple_of": ("multiple_of", "a multiple of"),
}
_KINDS = {
    "int": "a whole number",
    "float": "a number",
    "finite_number": "a finite number",
    "bool": "true or false",
    "string": "text",
    "tuple": "a list",
    "list": "a list",
    "model": "a section with settings of its own",
    "none": "null",
}


def validated(model: type[Model], data: Mapping[str, Any], earlier: Sequence[str] = ()) -> Model:
    """The settings in `data`, or a `ConfigError` with a line for each fault, the `earlier` ones first."""
    try:
        settings = model.model_validate(data)
    except ValidationError as error:
        raise ConfigError("\n".join(unique([*earlier, *faults(error, model, data)]))) from None
    if earlier:
        raise ConfigError("\n".join(unique(earlier)))
    return settings


def unique(lines: Iterable[str]) -> list[str]:
    """The same lines in the same order, each once."""
    return list(dict.fromkeys(lines))


def faults(error: ValidationError, model: type[BaseModel], data: Mapping[str, Any]) -> list[str]:
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
    match = closest(str(path[-1]), siblings)
    if match:
        return f"{name} is not a setting; did you mean {_dotted((*path[:-1], match))}?"
    elsewhere = {other.rpartition(".")[2]: other for other in reversed(_all_paths(model, data))}
    # There are many of them, so that some are always a little alike.
    match = closest(str(path[-1]), elsewhere, 0.8)
    if match:
        return f"{name} is not a setting; did you mean {elsewhere[match]}?"
    place = _dotted(path[:-1]) or "the top level"
    return f"{name} is not a setting; {place} has {', '.join(siblings)}"


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
    path: tuple[str | int, ...],
    details: list[ErrorDetails],
    model: type[BaseModel],
    data: Mapping[str, Any],
) -> str:
    name, first = _dotted(path), details[0]
    if first["type"] == "extra_forbidden":
        return unknown_setting(path, model, data)
    if first["type"] == "missing":
        return f"{name} is missing; give it a value"
    if first["type"] in ("value_error", "assertion_error"):
        message = str(first["ctx"]["error"])
        return f"{name}: {message}" if name else message
    wanted = [want for detail in details if (want := _wanted(detail)) is not None]
    if not wanted:
        return f"{name}: {first['msg']}"
    return f"{name} must be {' or '.join(unique(wanted))} (got {_shown(_value_at(path, data))})"


def _wanted(detail: ErrorDetails) -> str | None:
    kind, context = detail["type"], detail.get("ctx", {})
    if kind in _RANGES:
        key, words = _RANGES[kind]
        return f"{words} {context[key]}"
    if kind in ("literal_error", "enum", "union_tag_invalid"):
        choices = context.get("expected", context.get("expected_tags", ""))
        return "one of " + choices.replace("'", "").replace(" or ", ", ")
    if kind == "too_short":
        return f"a list of at least {context['min_length']}"
    if kind == "too_long":
        return f"a list of at most {context['max_length']}"
    if kind == "string_too_short":
        return "text that is not empty"
    if kind == "missing":
        return "a longer list"
    for prefix, words in _KINDS.items():
        if kind == prefix or kind.startswith(prefix + "_"):
            return words
    return None


def _value_at(path: Iterable[str | int], data: Any) -> Any:
    for part in path:
        data = data[part]
    return data


def _shown(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return repr(value)


def _dotted(path: Iterable[str | int]) -> str:
    return ".".join(map(str, path))


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """The settings classes inside a type such as `tuple[A, ...]` or `A | B | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) in (Annotated, Union, types.UnionType, tuple, list):
        for inner in get_args(annotation):
            yield from _models(inner)


def _member(annotation: Any, value: Any) -> type[BaseModel] | None:
    """Which settings class of a type a value belongs to: by its `name` where there are several."""
    candidates = list(_models(annotation))
    tag = value.get("name") if isinstance(value, Mapping) else None
    if WorldSettings in candidates and isinstance(tag, str):
        with suppress(WorldError):
            return WORLDS.settings_class(tag)
    for candidate in candidates:
        field = candidate.model_fields.get("name")
        if field is not None and tag is not None and field.default == tag:
            return candidate
    return candidates[0] if candidates else None


def _section(path: Iterable[str | int], model: type[BaseModel], data: Any) -> type[BaseModel] | None:
    section: type[BaseModel] | None = model
    for part in path:
        data = data[part]
        if isinstance(part, int):
            continue
        if section is None or part not in section.model_fields:
            return None
        section = _member(section.model_fields[part].annotation, data)
    return section


def _all_paths(model: type[BaseModel], data: Any, prefix: str = "") -> list[str]:
    paths: list[str] = []
    for name, field in model.model_fields.items():
        value = data.get(name) if isinstance(data, Mapping) else None
        inner = _member(field.annotation, value)
        is_sequence = isinstance(value, Sequence) and not isinstance(value, str)
        if inner is None or is_sequence:
            paths.append(prefix + name)
        else:
            paths += _all_paths(inner, value, f"{prefix}{name}.")
    return paths
