"""The parts that can be added from outside: worlds, robots, sensors, behaviours, terms and algorithms.

There is one registry for each kind. A part is a function or a class. A registry knows our own parts by their
place (`"module:attribute"`, imported when one is used), those of installed packages by entry point (group
`dune_rl.worlds`, `dune_rl.rewards`, ...; listed without importing them), and those that a program registers.
"""

import importlib
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import Any, ClassVar, Generic, TypeVar

from dune_rl import plugins
from dune_rl.errors import DuneError, DuneWarning, RegistryError
from dune_rl.settings import Settings
from dune_rl.signatures import PartSignature, derive_settings, read_signature, with_article
from dune_rl.suggestions import closest, one_of

ProductT = TypeVar("ProductT")
Target = TypeVar("Target", bound=Callable[..., Any])


@dataclass(frozen=True)
class RegisteredPart:
    """A part: the function or class, its settings class, how it is called, and where it comes from.

    `origin` opens every sentence about what is wrong with it. `is_own` marks ours.
    """

    target: Callable[..., Any]
    settings: type[Settings]
    signature: PartSignature
    origin: str
    is_own: bool


class DerivedSettings(Settings):
    """Settings of a class that was made at run time from the parameters of a part.

    Such a class cannot be imported by its name. A worker process gets the part's name, and the function or
    class of a user along.
    """

    _part: ClassVar[RegisteredPart]
    _registry: ClassVar["Registry[Any]"]

    def __reduce__(self) -> tuple[Any, ...]:
        values = {field: getattr(self, field) for field in type(self).model_fields}
        registry, part = type(self)._registry, type(self)._part
        target = None if part.is_own else part.target
        return _restore_settings, (registry.location, values[registry.tag], target, values)

    def __hash__(self) -> int:
        # Settings may be lists.
        return hash((type(self), self.model_dump_json()))


class Registry(Generic[ProductT]):
    """The parts of one kind by name, and their settings.

    A part's settings are its parameters with their types, defaults and ranges
    (`Annotated[float, pydantic.Field(gt=0)]`), or one parameter whose type is
    a `Settings` class. Some parameters are no settings but come from the
    caller, such as `state, group`: `function_leading` names those of a
    function, which stand first in it, and `class_leading` those of a class,
    in any place. Either is None where a part cannot be one.

    The settings class of each part derives from `base`, whose field `tag`
    holds the part's name. `product` is the class, or the protocol, of what
    `build` makes, and of what a function returns, unless `returned` is; `form`
    says in words what a part must be. `location` is where the registry itself
    can be imported from.
    """

    def __init__(
        self,
        kind: str,
        location: str,
        *,
        own: Mapping[str, str],
        base: type[Settings],
        product: type[ProductT] | Any,
        form: str,
        returned: type | None = None,
        function_leading: tuple[str, ...] | None = (),
        class_leading: tuple[str, ...] | None = None,
        tag: str = "name",
        error: type[DuneError] = RegistryError,
        warning: type[DuneWarning] = DuneWarning,
    ) -> None:
        self.kind, self.location, self.tag = kind, location, tag
        self.own = dict(own)
        self._base, self._product, self._form = base, product, form
        self._returned = product if returned is None else returned
        self._leading = {"function": function_leading, "class": class_leading}
        self._error, self._warning = error, warning
        self._loaded: dict[str, RegisteredPart] = {}
        self._user_parts: dict[str, RegisteredPart] = {}

    # -- what there is ----------------------------------------------------------------------------

    @property
    def entry_point_group(self) -> str:
        """The group of entry points that packages add parts by."""
        return f"dune_rl.{self.kind}s"

    def names(self) -> list[str]:
        """The name of every part, sorted; no package of a user is imported for it."""
        return sorted({*self.own, *self.user_names()})

    def user_names(self) -> list[str]:
        """The names of the parts that are not ours. One that takes the name of ours is warned of."""
        by_name = plugins.entry_points_by_name(self.entry_point_group)
        for name in self.own:
            for point in by_name.pop(name, ()):
                warnings.warn(
                    f"{self._origin_of(name, point)}, a name that dune_rl has given to "
                    f"{with_article(self.kind)} of its own: it is left out. "
                    "Give the entry point another name.",
                    self._warning,
                    stacklevel=2,
                )
        return sorted({*by_name, *self._user_parts})

    def is_loaded(self, name: str) -> bool:
        """Whether the settings of a part are known without importing a user's package."""
        return name in self.own or name in self._user_parts

    def settings_class(self, name: str) -> Any | None:
        """The settings class of the part `name`, None where there is none; an error for a broken package."""
        part = self.find(name)
        return None if part is None else part.settings

    # -- settings ---------------------------------------------------------------------------------

    def parse_settings(self, value: Any) -> Any:
        """The settings that a mapping stands for, by its tag; anything else as it is.

        For pydantic's `BeforeValidator`: what is wrong raises `ValueError`.
        """
        if not isinstance(value, Mapping):
            return value
        name = value.get(self.tag)
        if not isinstance(name, str):
            raise ValueError(f"{self.tag} must say which {self.kind} it is: {one_of(self.names())}")
        try:
            settings = self.settings_class(name)
        except DuneError as error:
            raise ValueError(str(error)) from None
        if settings is None:
            raise ValueError(self.unknown(name))
        return settings.model_validate(value)

    def tag_entries(self, value: Any) -> Any:
        """A mapping of named entries, in which an entry without a tag is the part of its own name.

        Entries that are null are left out. For a `BeforeValidator` of a dictionary of settings.
        """
        if not isinstance(value, Mapping):
            return value
        return {
            name: {self.tag: name, **entry} if isinstance(entry, Mapping) else entry
            for name, entry in value.items()
            if entry is not None
        }

    def unknown(self, name: str) -> str:
        """What to write instead of the name of a part that there is not."""
        known = self.names()
        near = closest(name, known)
        remedy = f"did you mean {near}?" if near else f"choose {one_of(known)}"
        return (
            f"there is no {self.kind} {name!r} (is the package that brings it installed?); {remedy}"
            if known
            else f"there is no {self.kind} {name!r}"
        )

    # -- registering and building -----------------------------------------------------------------

    def register(self, target: Target, name: str | None = None) -> Target:
        """Make a part known in this process as `name`, else by its own name; gives it back.

        To register it again replaces it, as when a notebook's cell runs twice.
        Raises an error for a name that is taken, and for parameters that
        cannot be settings.
        """
        name = name if name is not None else str(getattr(target, "__name__", target))
        where = _place(target)
        if not plugins.VALID_NAME.fullmatch(name):
            raise self._error(
                f"{with_article(self.kind)} cannot be called {name!r}: take letters, digits and _, "
                "a letter first."
            )
        if name in self.own:
            raise self._error(
                f"{where} cannot be the {self.kind} {name!r}, which dune_rl has: choose another name."
            )
        before = self._user_parts.get(name)
        if before is not None and _place(before.target) != where:
            raise self._error(
                f"{where} cannot be the {self.kind} {name!r}, which {_place(before.target)} is: "
                "choose another name."
            )
        self._remember(name, target, f"the {self.kind} {name!r} is {where}")
        return target

    def build(self, conf: Settings, *leading: Any) -> ProductT:
        """What the part of `conf` makes of the leading arguments and its settings."""
        part = self.part_of(conf)
        names = self._leading["class" if part.signature.is_class else "function"] or ()
        arguments = dict(zip(names, leading, strict=True)) | part.signature.arguments(conf)
        if part.is_own:
            product: ProductT = part.target(**arguments)
            return product
        try:
            product = part.target(**arguments)
        except Exception as error:
            error.add_note(f"{part.origin}; it was called with {conf!r}")
            raise
        self._check_product(part, product)
        return product

    def part_of(self, conf: Settings) -> RegisteredPart:
        """The part that settings are of."""
        if isinstance(conf, DerivedSettings):
            return type(conf)._part
        part = self.find(getattr(conf, self.tag))
        assert part is not None and type(conf) is part.settings, conf
        return part

    def find(self, name: str) -> RegisteredPart | None:
        """The part `name`, None where there is none; an error for a broken package."""
        if name in self.own:
            if name not in self._loaded:
                self._loaded[name] = self._read_own(name)
            return self._loaded[name]
        if name not in self._user_parts:
            points = plugins.entry_points_by_name(self.entry_point_group).get(name, [])
            if not points:
                return None
            if len(points) > 1:
                packages = " and ".join(plugins.package_name(point) for point in points)
                raise self._error(
                    f"the packages {packages} both bring {with_article(self.kind)} {name!r}: "
                    "uninstall one of them."
                )
            origin = self._origin_of(name, points[0])
            try:
                target = points[0].load()
            except Exception as error:
                raise self._error(
                    f"{origin}, which cannot be imported: {type(error).__name__}: {error}."
                ) from error
            self._remember(name, target, origin)
        return self._user_parts[name]

    # -- inside -----------------------------------------------------------------------------------

    def _read_own(self, name: str) -> RegisteredPart:
        module, _, attribute = self.own[name].partition(":")
        target = getattr(importlib.import_module(module), attribute)
        origin = f"the {self.kind} {name!r} of dune_rl"
        signature = self._signature_of(target, name, origin)
        own = signature.settings_type
        if own is not None and issubclass(own, self._base):
            return RegisteredPart(target, own, signature, origin, is_own=True)
        return self._with_derived_settings(target, name, signature, origin, is_own=True)

    def _remember(self, name: str, target: Any, origin: str) -> None:
        signature = self._signature_of(target, name, origin)
        self._user_parts[name] = self._with_derived_settings(target, name, signature, origin, is_own=False)

    def _with_derived_settings(
        self, target: Any, name: str, signature: PartSignature, origin: str, *, is_own: bool
    ) -> RegisteredPart:
        bases = (DerivedSettings, self._base)
        settings: Any = derive_settings(signature, name, self.tag, bases, origin, self._error)
        part = RegisteredPart(target, settings, signature, origin, is_own)
        settings._part, settings._registry = part, self
        return part

    def _signature_of(self, target: Any, name: str, origin: str) -> PartSignature:
        return read_signature(
            target,
            name,
            origin,
            form=self._form,
            leading=self._leading,
            reserved={self.tag, *self._base.model_fields},
            tag=self.tag,
            product=self._returned,
            error=self._error,
        )

    def _check_product(self, part: RegisteredPart, product: Any) -> None:
        missing = missing_members(self._product, product)
        if missing is None:
            return
        wanted = with_article(self._product.__name__)
        lacking = f" without {', '.join(missing)}" if missing else ""
        raise self._error(
            f"{part.origin}, which must return {wanted}, and returned {product!r:.80}{lacking}."
        )

    def _origin_of(self, name: str, point: EntryPoint) -> str:
        return f"the package {plugins.package_name(point)} brings the {self.kind} {name!r} as {point.value}"


def missing_members(product: Any, value: Any) -> list[str] | None:
    """What `value` lacks of a protocol, sorted; empty where it is no instance of a class; None: it fits."""
    if getattr(product, "_is_protocol", False):
        members = {name for base in product.__mro__ for name in (*vars(base), *_annotations(base))}
        wanted = (name for name in members if name == "__call__" or not name.startswith("_"))
        return sorted(name for name in wanted if not _has(value, name)) or None
    return None if isinstance(value, product) else []


def _has(value: Any, name: str) -> bool:
    # Not `hasattr` first, which would compute properties.
    return hasattr(type(value), name) or hasattr(value, name)


def _annotations(base: type) -> Mapping[str, Any]:
    found: Mapping[str, Any] = vars(base).get("__annotations__", {})
    return found


def _restore_settings(location: str, name: str, target: Any, values: dict[str, Any]) -> Any:
    module, _, attribute = location.partition(":")
    registry: Registry[Any] = getattr(importlib.import_module(module), attribute)
    if target is not None and name not in registry._user_parts:
        registry.register(target, name)
    settings = registry.settings_class(name)
    assert settings is not None
    return settings.model_validate(values)


def _place(target: Any) -> str:
    return f"{getattr(target, '__module__', '?')}:{getattr(target, '__qualname__', target)}"
