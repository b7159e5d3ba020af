"""Every public function, class and method in the reference of the Python interface has a docstring."""

import importlib
import inspect
import re
from collections.abc import Iterator
from functools import cached_property

import pytest
from documents import DOCS

import dune_rl

PAGES = sorted((DOCS / "reference" / "api").glob("*.md"))
TEXT = "\n".join(page.read_text() for page in PAGES)
MODULES = sorted(set(re.findall(r"^\.\. automodule:: (\S+)$", TEXT, flags=re.MULTILINE)))
# Modules whose public names the pages list one by one.
LISTED = ("dune_rl", "dune_rl.worlds", "dune_rl.env.torchrl")


def public_names(module: str) -> list[str]:
    """The names that a module offers: its `__all__`, or else what it defines."""
    space = importlib.import_module(module)
    stated = getattr(space, "__all__", None)
    own = [name for name, value in vars(space).items() if getattr(value, "__module__", None) == module]
    return [name for name in stated or own if not name.startswith("_")]


def public_things(module: str) -> Iterator[tuple[str, object]]:
    """The functions, classes and methods of a module, by their paths."""
    space = importlib.import_module(module)
    for name in public_names(module):
        value = getattr(space, name)
        if inspect.isclass(value) or inspect.isroutine(value):
            yield f"{module}.{name}", value
        if inspect.isclass(value):
            for member, held in vars(value).items():
                function = held.fget if isinstance(held, property) else getattr(held, "__func__", held)
                function = held.func if isinstance(held, cached_property) else function
                if not member.startswith("_") and inspect.isfunction(function):
                    yield f"{module}.{name}.{member}", function


@pytest.mark.parametrize("module", [*LISTED, *MODULES])
def test_public_things_have_docstrings_that_say_something(module: str) -> None:
    things = dict(public_things(module))
    assert things
    for path, thing in things.items():
        said = (inspect.getdoc(thing) or "").strip()
        assert len(said.split()) >= 2, f"{path} has no docstring"


@pytest.mark.parametrize("module", ["dune_rl", "dune_rl.worlds"])
def test_every_public_name_is_in_the_reference(module: str) -> None:
    errors = set(public_names("dune_rl.core.errors"))
    for name in public_names(module):
        if name not in errors:
            assert re.search(rf"\b{name}\b", TEXT), f"{module}.{name} is not in docs/reference/api"


def test_the_errors_are_in_the_reference() -> None:
    assert "dune_rl.core.errors" in MODULES
    assert {name for name in dune_rl.__all__ if name.endswith("Error")} <= set(
        public_names("dune_rl.core.errors")
    )
