"""What the site makes of a page's Markdown: generated parts, included files, and links out of docs/.

A page says `<!-- generated: NAME -->` where `generated_pages` writes its text, and
`<!-- include: ../../experiments/flat/README.md -->` where another Markdown file of the repository is shown.
Links of an included file are relative to that file, and are rewritten for the page that shows it.
"""

import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
_GENERATED = re.compile(r"^<!-- generated: (.+?) -->$", flags=re.MULTILINE)
_INCLUDE = re.compile(r"^<!-- include: (\S+) -->$", flags=re.MULTILINE)
_HEADING = re.compile(r"^(#+) ", flags=re.MULTILINE)
_CODE = re.compile(r"^```.*?^```$", flags=re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)\s#]+)")


def shown_pages(docs: Path = DOCS) -> dict[Path, Path]:
    """The page that shows each included file of the repository."""
    shown = {}
    for page in sorted(docs.rglob("*.md")):
        for included in _INCLUDE.findall(page.read_text()):
            shown[(page.parent / included).resolve()] = page
    return shown


def expand_page(
    text: str, page: Path, shown: Mapping[Path, Path], generate: Callable[[str, int], str]
) -> str:
    """The Markdown of a page with its generated and included parts, and with links to pages of the site."""

    def include(found: re.Match[str]) -> str:
        file = (page.parent / found[1]).resolve()
        return redirect_links(file.read_text(), file, page, shown)

    text = redirect_links(text, page, page, shown)
    text = _INCLUDE.sub(include, text)
    parts = _GENERATED.split(text)
    pairs = zip(parts[::2], [*parts[1::2], ""], strict=True)
    # Headings of a generated part are one level below the heading that it stands under.
    done = ""
    for before, words in pairs:
        done += before
        if words:
            done += generate(words, len(_HEADING.findall(_CODE.sub("", done))[-1]) + 1)
    return done


def redirect_links(text: str, origin: Path, page: Path, shown: Mapping[Path, Path]) -> str:
    """The text of the file `origin` with its relative links made relative to `page`.

    A link to a file that a page of the site shows leads to that page. Raises FileNotFoundError for a link to
    a file that is not there, and IsADirectoryError for one to a folder, which a site cannot show.
    """

    def redirect(found: re.Match[str]) -> str:
        target = (origin.parent / found[1]).resolve()
        if target.is_dir() and (target / "README.md").resolve() in shown:
            target = target / "README.md"
        if target.is_dir():
            raise IsADirectoryError(f"{origin}: {found[1]} is a folder; link a file in it")
        if not target.is_file():
            raise FileNotFoundError(f"{origin}: there is no {found[1]}")
        return os.path.relpath(shown.get(target, target), page.parent)

    parts = re.split(r"(^```.*?^```$)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if part.startswith("```") else _LINK.sub(redirect, part) for part in parts)
