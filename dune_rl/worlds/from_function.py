"""A world's settings, read off the function that builds it."""

import inspect
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeVar, get_type_hints

from pydantic import ValidationError, create_model
from pydantic.errors import PydanticUserError

from dune_rl.errors import WorldError
from dune_rl.settings import Settings
from dune_rl.worlds.settings import WorldSettings
from dune_rl.worlds.world import World

Build = Callable[..., World]
Base = TypeVar("Base", bound=WorldSettings)


@dataclass(frozen=True)
class WorldKind:
    """A family of worlds: what may be set, the function that builds one, and where that comes from."""

    settings: type[WorldSettings]
    build: Callable[[Any], World]
    function: Build
    origin: str


def kind_of(function: Build, name: str, origin: str, base: type[WorldSettings]) -> WorldKind:
    """The world `name` that `function` builds; `origin` opens what a `WorldError` says is wrong with it.

    Its parameters become settings derived from `base`, with their types and
    defaults; or it has one parameter only, whose type is a `Settings` class.
    """
    if not inspect.isfunction(function):
        raise WorldError(f"{origin}, which must be a function that returns a World, and is {function!r}.")
    try:
        hints = get_type_hints(function, include_extras=True)
    except Exception as error:
        raise WorldError(
            f"{origin}, whose annotations cannot be read: {type(error).__name__}: {error}."
        ) from error
    returned = hints.pop("return", World)
    if not (isinstance(returned, type) and issubclass(returned, World)):
        raise WorldError(f"{origin}, which must return a World, and says that it returns {_named(returned)}.")
    parameters = list(inspect.signature(function).parameters.values())
    own = hints.get(parameters[0].name) if len(parameters) == 1 else None
    if isinstance(own, type) and issubclass(own, Settings):
        stated = own.model_fields.get("name")
        if stated is not None and stated.default != name:
            raise WorldError(f"{origin}, whose settings name another world: {stated.default!r}.")
        settings = _settings(origin, name, function, (base, own), {})
        return WorldKind(settings, function, function, origin)
    fields = {parameter.name: _field(parameter, hints, origin) for parameter in parameters}
    settings = _settings(origin, name, function, (base,), fields)

    def build(conf: Any) -> World:
        return function(**{field: getattr(conf, field) for field in fields})

    return WorldKind(settings, build, function, origin)


def _field(parameter: inspect.Parameter, hints: dict[str, Any], origin: str) -> tuple[Any, Any]:
    name = parameter.name
    if parameter.kind not in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
        raise WorldError(f"{origin}, whose parameter {parameter} cannot be a setting: name it and its type.")
    if name not in hints:
        raise WorldError(f"{origin}, whose parameter {name!r} has no type: write such as {name}: int = 0.")
    if name == "name" or hasattr(Settings, name):
        raise WorldError(f"{origin}, whose parameter {name!r} has a name that settings use themselves.")
    return hints[name], ... if parameter.default is parameter.empty else parameter.default


def _settings(
    origin: str, name: str, function: Build, bases: tuple[type[Any], ...], fields: dict[str, Any]
) -> type[WorldSettings]:
    label = "".join(part.capitalize() for part in name.replace("-", "_").split("_"))
    everything: dict[str, Any] = {"name": (Literal[name], name), **fields}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            settings = _model(f"{label}Conf", bases, function, everything)
    except (PydanticUserError, TypeError, NameError, UserWarning) as error:
        reason = str(error).splitlines()[0]
        raise WorldError(f"{origin}, whose parameters cannot be settings: {reason}") from error
    if not any(field.is_required() for field in settings.model_fields.values()):
        try:
            settings()
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(map(str, first["loc"])) or "settings"
            raise WorldError(f"{origin}, whose default for {place} is unfit: {first['msg']}.") from error
    return settings


def _model(name: str, bases: tuple[type[Any], ...], function: Build, fields: dict[str, Any]) -> type[Any]:
    return create_model(
        name, __base__=bases, __module__=function.__module__, __doc__=function.__doc__, **fields
    )


def _named(annotation: Any) -> str:
    return annotation.__name__ if isinstance(annotation, type) else repr(annotation)
