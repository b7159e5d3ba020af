"""A part's settings, read off the parameters of the function or class that makes it."""

import inspect
import types
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_origin, get_type_hints

from pydantic import ValidationError, create_model
from pydantic.errors import PydanticUserError

from dune_rl.core.errors import DuneError
from dune_rl.core.settings import Settings


@dataclass(frozen=True)
class PartSignature:
    """How a part is called with its settings.

    `fields` are its parameters as pydantic's fields; or `settings_parameter`
    is the one that takes all settings as an object of `settings_type`.
    """

    target: Callable[..., Any]
    is_class: bool
    fields: Mapping[str, Any]
    settings_parameter: str | None = None
    settings_type: type[Settings] | None = None

    def arguments(self, conf: Settings) -> dict[str, Any]:
        if self.settings_parameter is not None:
            return {self.settings_parameter: conf}
        return {name: getattr(conf, name) for name in self.fields}


# Makes the error about a part whose fault is told.
Fail = Callable[[str], DuneError]


def read_signature(
    target: Any,
    name: str,
    fail: Fail,
    *,
    form: str,
    leading: Mapping[str, tuple[str, ...] | None],
    reserved: set[str],
    tag: str,
    product: Any,
) -> PartSignature:
    """The signature of a part, which must have this `form`, in words.

    `leading` names the parameters that precede the settings of a "function" and of a "class", None where a
    part cannot be one. No parameter may have a `reserved` name. A function must return a `product` if it says
    what it returns. Raises the errors of `fail`.
    """
    is_class = inspect.isclass(target)
    first = leading["class" if is_class else "function"]
    if first is None or not (is_class or inspect.isfunction(target)):
        raise fail(f"which must be {form}, and is {target!r}.")
    function = target.__init__ if is_class else target
    parameters = _settings_parameters(fail, target, is_class, first)
    hints = _hints(fail, function, parameters)
    returned = Any if is_class else _returned(function)
    if returned is not Any and not _may_be(returned, product):
        raise fail(f"which must be {form}, and says that it returns {_named(returned)}.")
    if len(parameters) == 1:
        only = parameters[0].name
        own = hints.get(only)
        if isinstance(own, type) and issubclass(own, Settings):
            stated = own.model_fields.get(tag)
            if stated is not None and not stated.is_required() and stated.default != name:
                raise fail(f"whose settings name another one: {stated.default!r}.")
            return PartSignature(target, is_class, {}, only, own)
    fields = {parameter.name: _field(fail, parameter, hints, reserved) for parameter in parameters}
    return PartSignature(target, is_class, fields)


def derive_settings(
    signature: PartSignature,
    name: str,
    tag: str,
    bases: tuple[type[Any], ...],
    fail: Fail,
) -> type[Settings]:
    """A settings class of the part `name`, derived from `bases`; raises the errors of `fail`."""
    own = signature.settings_type
    if own is not None:
        bases = (*(base for base in bases if not issubclass(own, base)), own)
    label = "".join(part.capitalize() for part in name.replace("-", "_").split("_"))
    fields = {tag: (Literal[name], name), **signature.fields}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            settings = _create(f"{label}Conf", bases, signature.target, fields)
    except (PydanticUserError, TypeError, NameError, UserWarning) as fault:
        reason = str(fault).splitlines()[0]
        raise fail(f"whose parameters cannot be settings: {reason}") from fault
    if not any(field.is_required() for field in settings.model_fields.values()):
        try:
            settings()
        except ValidationError as fault:
            first = fault.errors()[0]
            place = ".".join(map(str, first["loc"])) or "settings"
            raise fail(f"whose default for {place} is unfit: {first['msg']}.") from fault
    return settings


def _settings_parameters(
    fail: Fail, target: Any, is_class: bool, leading: tuple[str, ...]
) -> list[inspect.Parameter]:
    if is_class and target.__init__ is object.__init__:
        parameters = []
    else:
        parameters = list(inspect.signature(target).parameters.values())
    names = tuple(parameter.name for parameter in parameters)
    if is_class and not set(leading) <= set(names):
        raise fail(f"whose __init__ must have the parameters {', '.join(leading)}.")
    if not is_class and names[: len(leading)] != leading:
        raise fail(f"whose first parameters must be {', '.join(leading)}.")
    return [parameter for parameter in parameters if parameter.name not in leading]


def _hints(fail: Fail, function: Any, parameters: list[inspect.Parameter]) -> dict[str, Any]:
    """The types of the settings; those of other parameters need not be importable."""
    try:
        return _evaluated(function, {parameter.name for parameter in parameters})
    except Exception as error:
        raise fail(f"whose annotations cannot be read: {type(error).__name__}: {error}.") from error


def _returned(function: Any) -> Any:
    """The type that a function says it returns; Any where it says none that can be read."""
    try:
        return _evaluated(function, {"return"}).get("return", Any)
    except Exception:
        return Any


def _evaluated(function: Any, names: set[str]) -> dict[str, Any]:
    stated = {name: hint for name, hint in getattr(function, "__annotations__", {}).items() if name in names}
    place = types.SimpleNamespace(__annotations__=stated, __globals__=getattr(function, "__globals__", {}))
    return get_type_hints(place, include_extras=True)


def _field(
    fail: Fail, parameter: inspect.Parameter, hints: dict[str, Any], reserved: set[str]
) -> tuple[Any, Any]:
    name = parameter.name
    if parameter.kind not in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
        raise fail(f"whose parameter {parameter} cannot be a setting: name it and its type.")
    if name not in hints:
        raise fail(f"whose parameter {name!r} has no type: write such as {name}: int = 0.")
    if name in reserved or hasattr(Settings, name):
        raise fail(f"whose parameter {name!r} has a name that settings use themselves.")
    return hints[name], ... if parameter.default is parameter.empty else parameter.default


def _create(name: str, bases: tuple[type[Any], ...], target: Any, fields: dict[str, Any]) -> type[Settings]:
    return create_model(name, __base__=bases, __module__=target.__module__, __doc__=target.__doc__, **fields)


def _may_be(returned: Any, product: Any) -> bool:
    """Whether what an annotation says can be a `product`; of a protocol it must only not be plain data."""
    if getattr(product, "_is_protocol", False):
        return returned not in (int, float, str, bool, type(None))
    kind = get_origin(returned) or returned
    # An alias, such as numpy's NDArray from 2.5 on.
    while hasattr(kind, "__value__"):
        kind = get_origin(kind.__value__) or kind.__value__
    return isinstance(kind, type) and issubclass(kind, product)


def with_article(name: str) -> str:
    """The name with "a" or "an"."""
    return f"{'an' if name[0].lower() in 'aeio' else 'a'} {name}"


def _named(annotation: Any) -> str:
    return annotation.__name__ if isinstance(annotation, type) else repr(annotation)
