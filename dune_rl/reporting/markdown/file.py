"""Tables in Markdown files that are made from files of results: `python -m dune_rl.report into=README.md`.

A block begins with a comment that says what it is made of, in YAML, and ends with another:

    <!-- report: table
    methods:
      trained: {folder: experiments/inspection, policy: inspection}
    measures: [SR, TR]
    -->
    | method | SR | TR |
    ...
    <!-- end report -->

Folders are relative to the Markdown file. What is between the comments is written anew; the rest stays.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import write_atomically
from dune_rl.core.settings import Settings
from dune_rl.core.untrusted_files import parse_yaml
from dune_rl.reporting.inputs import Note
from dune_rl.reporting.markdown.grid import GridConf, make_grid
from dune_rl.reporting.markdown.pair import PairConf, make_pair
from dune_rl.reporting.markdown.protocols import ProtocolsConf, make_protocols
from dune_rl.reporting.markdown.sources import BlockSources
from dune_rl.reporting.markdown.table import TableConf, make_table

_MAKERS: Mapping[str, tuple[type[Settings], Callable[[Any, BlockSources], str]]] = {
    "table": (TableConf, make_table),
    "pair": (PairConf, make_pair),
    "grid": (GridConf, make_grid),
    "protocols": (ProtocolsConf, make_protocols),
}
_BEGIN = re.compile(r"<!-- report: (\w+)\r?\n(.*?)^-->(\r?\n)", flags=re.MULTILINE | re.DOTALL)
_END = "<!-- end report -->"
_CODE = re.compile(r"(^```.*?^```\r?$)", flags=re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Rewritten:
    """The text of a file with its blocks written anew, and how many there are.

    `skipped` and `notes` are what is to be known of the folders that they were made from.
    """

    text: str
    blocks: int
    skipped: Sequence[Note]
    notes: Sequence[Note]


def rewrite_file(file: Path) -> Rewritten:
    """Write the blocks of a Markdown file anew, with the line endings that they have.

    Raises ConfigError, and changes nothing, where there is none, or one that cannot be made.
    """
    try:
        text = file.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise ConfigError(f"into={file}: there is no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"into={file} cannot be read as text: {error}") from None
    found = rewrite_text(text, file)
    if not found.blocks:
        kinds = ", ".join(_MAKERS)
        raise ConfigError(
            f"{file} has no block that begins with <!-- report: and one of {kinds}; see docs/how_to/report.md"
        )
    if found.text != text:
        with write_atomically(file) as temporary:
            temporary.write_text(found.text, encoding="utf-8", newline="")
    return found


def rewrite_text(text: str, file: Path) -> Rewritten:
    """The text of `file` with its blocks written anew; code in fences stays."""
    parts = _CODE.split(text)
    sources = BlockSources(file.parent)
    count, done = 0, ""
    for part in parts:
        if part.startswith("```"):
            done += part
            continue
        while found := _BEGIN.search(part):
            end = part.find(_END, found.end())
            following = _BEGIN.search(part, found.end())
            if end < 0 or (following and following.start() < end):
                raise ConfigError(f"{file}: the block '<!-- report: {found[1]}' has no {_END}")
            made = make_block(found[1], found[2], file, sources)
            done += part[: found.end()] + made.replace("\n", found[3]) + _END
            part = part[end + len(_END) :]
            count += 1
        done += part
    return Rewritten(done, count, sources.skipped, sources.notes)


def make_block(kind: str, settings: str, file: Path, sources: BlockSources) -> str:
    """The Markdown of a block of `file` from its settings; raises ConfigError where they are wrong."""
    if kind not in _MAKERS:
        raise ConfigError(f"{file}: there is no block {kind!r}; there are {', '.join(_MAKERS)}")
    model, make = _MAKERS[kind]
    try:
        conf = model.model_validate(parse_yaml(settings))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ConfigError(f"{file}: the block of {kind}: {where}: {first['msg']}") from None
    except ValueError as error:
        raise ConfigError(f"{file}: the block of {kind} is not YAML: {error}") from None
    try:
        return make(conf, sources)
    except ConfigError as error:
        raise ConfigError(f"{file}: {error}") from None
