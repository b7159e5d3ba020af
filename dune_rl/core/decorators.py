"""The decorators `dune_rl.register_world`, `register_reward`, ...: each fills one registry."""

from collections.abc import Callable
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, TypeVar, overload

if TYPE_CHECKING:
    from dune_rl.core.registry import Registry

Target = TypeVar("Target", bound=Callable[..., Any])


class RegisterDecorator:
    """Makes a function or class known to this process as a part of one kind, by its own name or another.

    `@register_reward` takes the function's name, `@register_reward("near_miss")` another. Its parameters,
    which have types and defaults, become settings. Worker processes get the function along. A package
    declares the same with an entry point, for command lines too. A name that is taken, and parameters that
    cannot be settings, are errors.
    """

    def __init__(self, location: str, then: Callable[[str], None] | None = None) -> None:
        """`location` is that of the registry; `then` is called with each new name."""
        self._location, self._then = location, then

    @overload
    def __call__(self, target: Target) -> Target: ...
    @overload
    def __call__(self, target: str) -> Callable[[Target], Target]: ...
    def __call__(self, target: Any) -> Any:
        if isinstance(target, str):
            return lambda function: self._register(function, target)
        return self._register(target, None)

    def _register(self, target: Any, name: str | None) -> Any:
        # Only now: registries lie beside their parts, and dune_rl itself must import fast.
        registry: Registry[Any] = resolve_name(self._location)
        registry.register(target, name)
        if self._then is not None:
            self._then(name if name is not None else target.__name__)
        return target
