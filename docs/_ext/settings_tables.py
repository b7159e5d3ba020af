"""Reference tables of settings (name, default, allowed values, meaning) from the schema and conf/*.yaml."""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from dune_rl.core.settings import Settings

Schema = Mapping[str, Any]
_REQUIRED = "*required*"
_MARKUP = re.compile(r"[|*<]")
_BRACES = re.compile(r"\{.*\}|\[[^\]]*,[^\]]*\]")
_TYPES = {"integer": "whole number", "number": "number", "boolean": "`true`, `false`", "string": "text"}


@dataclass(frozen=True)
class Setting:
    """A row: the dotted `path`, and its cells as Markdown; `meaning` is empty where nothing says it."""

    path: str
    default: str
    allowed: str
    meaning: str

    @property
    def name(self) -> str:
        """The last part of the path."""
        return self.path.rsplit(".", 1)[-1]


@dataclass
class Section:
    """The settings of one class, and the sections within it; `about` is the docstring of the class."""

    path: str
    about: str
    settings: list[Setting] = field(default_factory=list)
    sections: list["Section"] = field(default_factory=list)

    def all_settings(self) -> Iterator[Setting]:
        """The settings here and in all sections within."""
        yield from self.settings
        for section in self.sections:
            yield from section.all_settings()


def read_section(
    model: type[Settings],
    path: str,
    comments: Mapping[str, str],
    *,
    only: frozenset[str] | None = None,
    without: frozenset[str] = frozenset(),
) -> Section:
    """The section of a settings class at `path`, whose meanings are `comments` by path within it.

    `only` limits it to some of its fields, and fields of names in `without` are left out at every depth.
    """
    schema = model.model_json_schema()
    reader = _SchemaReader(schema.get("$defs", {}), comments, without)
    section = reader.section(schema, path, "", {})
    if only is not None:
        paths = {f"{path}.{name}" if path else name for name in only}
        section.settings = [each for each in section.settings if each.path in paths]
        section.sections = [each for each in section.sections if each.path in paths]
    section.about = model.__doc__ or ""
    return section


def render_section(section: Section, level: int) -> str:
    """A section as Markdown, with a heading of this level for each section within it."""
    parts = []
    if section.settings:
        rows = [
            f"| `{each.name}` | {each.default} | {each.allowed} | {as_code(each.meaning)} |"
            for each in section.settings
        ]
        parts.append("\n".join(["| setting | default | allowed | meaning |", "|---|---|---|---|", *rows]))
    for inner in section.sections:
        parts.append(f"{'#' * level} `{inner.path}`")
        if inner.about:
            parts.append(as_code(_sentence(first_paragraph(inner.about))))
        parts.append(render_section(inner, min(level + 1, 6)))
    return "\n\n".join(part for part in parts if part)


@dataclass(frozen=True)
class _SchemaReader:
    definitions: Schema
    comments: Mapping[str, str]
    without: frozenset[str]

    def section(self, schema: Schema, path: str, inside: str, defaults: Schema) -> Section:
        """The section of an object's schema; `inside` is its path in the comments, with a dot behind it."""
        section = Section(path, schema.get("description", ""))
        for name, stated in schema.get("properties", {}).items():
            if name in self.without:
                continue
            own = f"{path}.{name}" if path else name
            known = name in defaults
            default = defaults[name] if known else stated.get("default")
            inner = self.nested(stated)
            meaning = self.comments.get(f"{inside}{name}", "") or stated.get("description", "")
            if inner is not None:
                found = self.section(inner, own, f"{inside}{name}.", default or {})
                found.about = self.comments.get(f"{inside}{name}", "") or found.about
                section.sections.append(found)
            if inner is None or "anyOf" in stated:
                required = not known and "default" not in stated and name in schema.get("required", ())
                text = _REQUIRED if required else _value(default)
                section.settings.append(Setting(own, text, self.allowed(stated), meaning))
        return section

    def nested(self, stated: Schema) -> Schema | None:
        """The schema of an object with settings of its own; None for plain values and unions."""
        options = [each for each in stated.get("anyOf", [stated]) if each.get("type") != "null"]
        found = self.resolve(options[0]) if len(options) == 1 else {}
        return found if found.get("properties") else None

    def resolve(self, stated: Schema) -> Schema:
        reference = stated.get("$ref")
        return self.definitions[reference.rsplit("/", 1)[-1]] if reference else stated

    def allowed(self, stated: Schema) -> str:
        """Type and range in words."""
        if "anyOf" in stated or "oneOf" in stated:
            options = [self.allowed(each) for each in stated.get("anyOf", stated.get("oneOf"))]
            return ", or ".join(dict.fromkeys(options))
        stated = self.resolve(stated)
        if "const" in stated:
            return f"`{stated['const']}`"
        if "enum" in stated:
            return ", ".join(f"`{each}`" for each in stated["enum"])
        kind = stated.get("type")
        if kind == "null":
            return "`null`"
        if kind == "array":
            return self._list(stated)
        if kind == "object" or stated.get("properties"):
            return "section"
        limits = _limits(stated)
        return f"{_TYPES.get(kind or '', 'a value')}{limits}"

    def _list(self, stated: Schema) -> str:
        if "prefixItems" in stated:
            kinds = list(dict.fromkeys(self.allowed(each) for each in stated["prefixItems"]))
            count = len(stated["prefixItems"])
            return f"{count} of: {kinds[0]}" if len(kinds) == 1 else f"[{', '.join(kinds)}]"
        items = self.allowed(stated["items"]) if "items" in stated else "values"
        least = f", at least {stated['minItems']}" if stated.get("minItems") else ""
        return f"list of {items}{least}"


def _limits(stated: Schema) -> str:
    parts = []
    for key, sign in (
        ("minimum", "≥"),
        ("exclusiveMinimum", ">"),
        ("maximum", "≤"),
        ("exclusiveMaximum", "<"),
    ):
        if key in stated:
            parts.append(f"{sign} {_number(stated[key])}")
    if "multipleOf" in stated:
        parts.append(f"a multiple of {_number(stated['multipleOf'])}")
    return f" {', '.join(parts)}" if parts else ""


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) and value >= 10_000 else f"{value:.10g}"


def _value(value: Any) -> str:
    if isinstance(value, dict) and not value:
        return "`{}`"
    if isinstance(value, dict):
        return "see below"
    text = f"{value:_}" if type(value) is int and value >= 100_000 else json.dumps(value, ensure_ascii=False)
    return f"`{text.replace(chr(34), '')}`"


def first_paragraph(text: str) -> str:
    """The first paragraph of a docstring, on one line."""
    return " ".join(text.strip().split("\n\n")[0].split())


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}" + ("" if text.endswith((".", ":")) else ".")


def as_code(text: str) -> str:
    """The text with YAML in braces, and what Markdown would take for markup, made literal."""
    text = _BRACES.sub(lambda found: f"`{found[0]}`", text) if "`" not in text else text
    parts = re.split(r"(`[^`]*`)", text)
    plain = (part if part.startswith("`") else _MARKUP.sub(r"\\\g<0>", part) for part in parts)
    # A table's cells end at bars, in code as well.
    return re.sub(r"(?<!\\)\|", r"\\|", "".join(plain))
