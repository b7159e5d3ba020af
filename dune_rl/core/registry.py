"""Plugin registry of worlds, robots, sensors, behaviours, terms and algorithms ("parts").

There is one registry for each kind. A part is a function or a class. A registry has three sources: built-in
parts, by import path (`"module:attribute"`, imported on first use); entry points of installed packages (group
`dune_rl.worlds`, `dune_rl.rewards`, ...; listed without importing them); and parts registered at run time.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.metadata import EntryPoint
from pkgutil import resolve_name
from typing import Any, ClassVar, Generic, TypeVar

from dune_rl.core import plugins
from dune_rl.core.errors import DuneError, DuneWarning, RegistryError
from dune_rl.core.settings import Settings
from dune_rl.core.signatures import PartSignature, derive_settings, read_signature, with_article
from dune_rl.core.suggestions import advise, one_of

ProductT = TypeVar("ProductT")
Target = TypeVar("Target", bound=Callable[..., Any])


@dataclass(frozen=True)
class RegisteredPart:
    """A registered function or class with its settings class, signature and origin.

    Error messages about the part start with `origin`. `is_own` marks built-in parts.
    """

    target: Callable[..., Any]
    settings: type[Settings]
    signature: PartSignature
    origin: str
    is_own: bool


class DerivedSettings(Settings):
    """Base of settings classes that are created at run time from the parameters of a part.

    Such a class cannot be pickled by name. A pickle has the part's name and, for a user's part, its function
    or class.
    """

    _part: ClassVar[RegisteredPart]
    _registry: ClassVar["Registry[Any]"]

    def __reduce__(self) -> tuple[Any, ...]:
        values = {field: getattr(self, field) for field in type(self).model_fields}
        registry, part = type(self)._registry, type(self)._part
        target = None if part.is_own else part.target
        return _restore_settings, (registry.location, values[registry.tag], target, values)

    def __hash__(self) -> int:
        # Settings may be unhashable lists.
        return hash((type(self), self.model_dump_json()))


class Registry(Generic[ProductT]):
    """The registered parts of one kind by name, and their settings classes.

    A part's settings are its parameters with their types, defaults and ranges (`Annotated[float,
    pydantic.Field(gt=0)]`), or one parameter whose type is a `Settings` class. Some parameters are not
    settings but are passed by the caller, such as `state, group`: `function_leading` names those of a
    function, which must come first, and `class_leading` those of a class, in any position. Either is None if
    parts cannot be functions, or classes.

    The settings class of each part derives from `base`, whose field `tag` holds the part's name. `product` is
    the class or protocol of the objects that `build` returns; `returned` is that of a function's return
    value, if it differs. `form` describes a valid part, for messages. `location` is the import path of the
    registry object.
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
        self.base, self._product, self._form = base, product, form
        self._returned = product if returned is None else returned
        self._leading = {"function": function_leading, "class": class_leading}
        self._error, self._warning = error, warning
        self._loaded: dict[str, RegisteredPart] = {}
        self._user_parts: dict[str, RegisteredPart] = {}

    # -- listing ----------------------------------------------------------------------------------

    @property
    def entry_point_group(self) -> str:
        """The entry-point group in which packages add parts."""
        return f"dune_rl.{self.kind.replace(' ', '_')}s"

    def names(self) -> list[str]:
        """Names of all parts, sorted, without importing users' packages."""
        return sorted({*self.own, *self.user_names()})

    def user_names(self) -> list[str]:
        """Names of users' parts, sorted. Warns of entry points with the name of a built-in part."""
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
        """Whether `settings_class` imports no user's package for this name."""
        return name in self.own or name in self._user_parts

    def settings_class(self, name: str) -> Any | None:
        """The settings class of the part `name`; see `find`."""
        part = self.find(name)
        return None if part is None else part.settings

    # -- settings ---------------------------------------------------------------------------------

    def parse_settings(self, value: Any) -> Any:
        """Parse a mapping as the settings of the part that its tag names; return other values unchanged.

        For pydantic's `BeforeValidator`: raises `ValueError` for invalid values.
        """
        if not isinstance(value, Mapping):
            return value
        name = value.get(self.tag)
        if not isinstance(name, str):
            raise ValueError(
                f"{self.tag} must be the name of {with_article(self.kind)}: {one_of(self.names())}"
            )
        try:
            settings = self.settings_class(name)
        except DuneError as error:
            raise ValueError(str(error)) from None
        if settings is None:
            raise ValueError(self.unknown(name))
        return settings.model_validate(value)

    def tag_entries(self, value: Any) -> Any:
        """Add the entry's name as tag to entries of a mapping that have none, and drop null entries.

        For a `BeforeValidator` of a dictionary of settings.
        """
        if not isinstance(value, Mapping):
            return value
        return {
            name: {self.tag: name, **entry} if isinstance(entry, Mapping) else entry
            for name, entry in value.items()
            if entry is not None
        }

    def unknown(self, name: str) -> str:
        """Error message for an unknown name, with a suggestion."""
        known = self.names()
        remedy = advise(name, known)
        return (
            f"there is no {self.kind} {name!r} (is the package that brings it installed?); {remedy}"
            if known
            else f"there is no {self.kind} {name!r}"
        )

    # -- registering and building -----------------------------------------------------------------

    def register(self, target: Target, name: str | None = None) -> Target:
        """Register a part in this process as `name` (default: its `__name__`), and return it.

        Registering it again replaces it, as when a notebook's cell runs twice. Raises an error if the name is
        taken, or a parameter cannot be a setting.
        """
        name = name if name is not None else str(getattr(target, "__name__", target))
        where = _import_path(target)
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
        if before is not None and _import_path(before.target) != where:
            raise self._error(
                f"{where} cannot be the {self.kind} {name!r}, which {_import_path(before.target)} is: "
                "choose another name."
            )
        self._remember(name, target, f"the {self.kind} {name!r} is {where}")
        return target

    def build(self, conf: Settings, *leading: Any) -> ProductT:
        """Call the part of `conf` with the leading arguments and its settings, and check the result."""
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
        if isinstance(conf, DerivedSettings):
            return type(conf)._part
        part = self.find(getattr(conf, self.tag))
        assert part is not None and type(conf) is part.settings, conf
        return part

    def find(self, name: str) -> RegisteredPart | None:
        """The part `name`, None if it does not exist; raises an error for a broken package."""
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

    # -- loading ----------------------------------------------------------------------------------

    def _read_own(self, name: str) -> RegisteredPart:
        target = resolve_name(self.own[name])
        origin = f"the {self.kind} {name!r} of dune_rl"
        signature = self._signature_of(target, name, origin)
        own = signature.settings_type
        if own is not None and issubclass(own, self.base):
            return RegisteredPart(target, own, signature, origin, is_own=True)
        return self._with_derived_settings(target, name, signature, origin, is_own=True)

    def _remember(self, name: str, target: Any, origin: str) -> None:
        signature = self._signature_of(target, name, origin)
        self._user_parts[name] = self._with_derived_settings(target, name, signature, origin, is_own=False)

    def _with_derived_settings(
        self, target: Any, name: str, signature: PartSignature, origin: str, *, is_own: bool
    ) -> RegisteredPart:
        bases = (DerivedSettings, self.base)
        settings: Any = derive_settings(signature, name, self.tag, bases, partial(self._fail, origin))
        part = RegisteredPart(target, settings, signature, origin, is_own)
        settings._part, settings._registry = part, self
        return part

    def _signature_of(self, target: Any, name: str, origin: str) -> PartSignature:
        return read_signature(
            target,
            name,
            partial(self._fail, origin),
            form=self._form,
            leading=self._leading,
            reserved={self.tag, *self.base.model_fields},
            tag=self.tag,
            product=self._returned,
        )

    def _fail(self, origin: str, reason: str) -> DuneError:
        return self._error(f"{origin}, {reason}")

    def _check_product(self, part: RegisteredPart, product: Any) -> None:
        missing = missing_members(self._product, product)
        if missing is None:
            return
        expected = with_article(self._product.__name__)
        lacking = f" without {', '.join(missing)}" if missing else ""
        raise self._error(
            f"{part.origin}, which must return {expected}, but returned {product!r:.80}{lacking}."
        )

    def _origin_of(self, name: str, point: EntryPoint) -> str:
        return f"the package {plugins.package_name(point)} brings the {self.kind} {name!r} as {point.value}"


def missing_members(product: Any, value: Any) -> list[str] | None:
    """Members of a protocol that `value` lacks; [] if it is no instance of a class; None if it fits."""
    if getattr(product, "_is_protocol", False):
        members = {name for base in product.__mro__ for name in (*vars(base), *_annotations(base))}
        public = (name for name in members if name == "__call__" or not name.startswith("_"))
        return sorted(name for name in public if not _has(value, name)) or None
    return None if isinstance(value, product) else []


def _has(value: Any, name: str) -> bool:
    # The type first: `hasattr` of the object would compute properties.
    return hasattr(type(value), name) or hasattr(value, name)


def _annotations(base: type) -> Mapping[str, Any]:
    found: Mapping[str, Any] = vars(base).get("__annotations__", {})
    return found


def _restore_settings(location: str, name: str, target: Any, values: dict[str, Any]) -> Any:
    registry: Registry[Any] = resolve_name(location)
    if target is not None and name not in registry._user_parts:
        registry.register(target, name)
    settings = registry.settings_class(name)
    assert settings is not None
    return settings.model_validate(values)


def _import_path(target: Any) -> str:
    return f"{getattr(target, '__module__', '?')}:{getattr(target, '__qualname__', target)}"
