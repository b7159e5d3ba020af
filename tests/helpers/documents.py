"""The pages of the documentation, and their blocks of code."""

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md")))
CLIENTS_PAGE = DOCS / "how_to" / "clients.md"
TUTORIAL = DOCS / "tutorial.md"
# The pages whose files make the package `my_dunes`.
EXTENSION_PAGES = (DOCS / "how_to" / "extend.md", *sorted((DOCS / "how_to").glob("add_a*.md")))
_BLOCK = re.compile(r"^```(\S*)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
_COMMAND = re.compile(r"(?:\S*python) -m (dune_rl[.\w]*.*)$", flags=re.MULTILINE)


class Block(NamedTuple):
    """A block of code: its language, and its text."""

    language: str
    text: str


def code_blocks(page: Path) -> list[Block]:
    """The blocks of code of a page, in order."""
    return [Block(*found) for found in _BLOCK.findall(page.read_text())]


def commands(page: Path) -> list[str]:
    """The package's commands in the shell blocks of a page, in order: "dune_rl.train +world=flat"."""
    return [
        found.strip()
        for language, text in code_blocks(page)
        if language in ("sh", "bash")
        for found in _COMMAND.findall(re.sub(r"\s*\\\n\s*", " ", text))
    ]


def extension_text() -> str:
    """The pages that show the package `my_dunes`, as one text."""
    return "\n".join(page.read_text() for page in EXTENSION_PAGES)


def page_name(page: Path) -> str:
    """A page's path in the repository, for messages and names of tests."""
    return str(page.relative_to(ROOT))
