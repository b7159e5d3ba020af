"""Sphinx extension: functions and classes of the Python interface get a table of their parameters.

A row has the parameter's type, its default, and the sentence of the docstring that names it.
"""

import inspect
import re
from collections.abc import Sequence
from typing import Any

from short_types import shorten_types
from sphinx.application import Sphinx
from sphinx.util.typing import stringify_annotation

_LEFT_OUT = ("self", "cls")
_MODULE = re.compile(r"\b(?:[a-z_]\w*\.)+(?=[A-Za-z])")
# A sentence ends outside of code.
_SENTENCE = re.compile(r"(?<=[.;])\s+(?=(?:[^`]*`[^`]*`)*[^`]*$)")
# A table of one parameter says no more than the signature.
_LEAST = 2


def parameter_table(thing: Any, docstring: Sequence[str]) -> list[str]:
    """The lines of a reStructuredText table; none for less than two parameters."""
    try:
        signature = inspect.signature(thing, eval_str=True)
    except (TypeError, ValueError, NameError):
        return []
    parameters = [each for each in signature.parameters.values() if each.name not in _LEFT_OUT]
    if len(parameters) < _LEAST or getattr(thing, "_is_protocol", False):
        return []
    sentences = [part for text in " ".join(docstring).split("  ") for part in _SENTENCE.split(text)]
    lines = [".. list-table::", "   :header-rows: 1", ""]
    rows = [("parameter", "type", "default", "meaning")]
    for each in parameters:
        stars = {each.VAR_POSITIONAL: "*", each.VAR_KEYWORD: "**"}.get(each.kind, "")
        rows.append((f"``{stars}{each.name}``", _type(each), _default(each), _meaning(each.name, sentences)))
    for row in rows:
        lines += [f"   {'*' if number == 0 else ' '} - {cell}" for number, cell in enumerate(row)]
    return [*lines, ""]


def _type(parameter: inspect.Parameter) -> str:
    if parameter.annotation is parameter.empty:
        return ""
    full = shorten_types(stringify_annotation(parameter.annotation, "fully-qualified-except-typing"))
    return f"``{_MODULE.sub('', full)}``"


def _default(parameter: inspect.Parameter) -> str:
    if parameter.default is parameter.empty:
        return "" if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD) else "*required*"
    shown = repr(parameter.default)
    return "``...``" if "<" in shown else f"``{shown}``"


def _meaning(name: str, sentences: Sequence[str]) -> str:
    return next((each.strip().rstrip(":;") for each in sentences if re.search(rf"`{name}\b", each)), "")


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the table below each docstring."""

    def add_table(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
        if what in ("function", "method", "class"):
            table = parameter_table(thing, lines)
            if table:
                lines += ["", *table]

    app.connect("autodoc-process-docstring", add_table)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
