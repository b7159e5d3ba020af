"""What the comments of conf/*.yaml say about each setting."""

from collections.abc import Iterator
from pathlib import Path

import yaml

from dune_rl.core import paths

_MARK = " # "


def read_comments(file: str) -> dict[str, str]:
    """The comment of each setting of a file of `conf/` ("task/point_goal"), by its dotted path.

    A comment stands behind a setting's value. One that ends with a colon goes on in the line below. A
    section may have its comment in the lines above it instead.
    """
    path = paths.conf_folder() / f"{file}.yaml"
    lines = path.read_text().splitlines()
    root = yaml.compose("\n".join(lines))
    assert isinstance(root, yaml.MappingNode)
    return {name: text for name, row in _settings(root, "") if (text := _comment_at(lines, row))}


def option_summary(path: Path) -> str:
    """The comment at the top of an option's file: what the option is."""
    lines = []
    for line in path.read_text().splitlines():
        if not line.startswith("#"):
            break
        if not line.startswith("# @"):
            lines.append(line.removeprefix("#").strip())
    return " ".join(lines)


def _settings(node: yaml.MappingNode, prefix: str) -> Iterator[tuple[str, int]]:
    for key, value in node.value:
        yield f"{prefix}{key.value}", key.start_mark.line
        if isinstance(value, yaml.MappingNode):
            yield from _settings(value, f"{prefix}{key.value}.")


def _comment_at(lines: list[str], row: int) -> str:
    _, mark, text = lines[row].partition(_MARK)
    if mark:
        for line in lines[row + 1 :]:
            if not (text.endswith(":") and line.lstrip().startswith("# ")):
                break
            text = f"{text} {line.strip().removeprefix('# ')}"
        return text.strip()
    above: list[str] = []
    for line in reversed(lines[:row]):
        if not line.lstrip().startswith("# "):
            break
        above.insert(0, line.strip().removeprefix("# "))
    # The comment at the top of a file describes the file.
    return " ".join(above) if len(above) < row else ""
