"""Sphinx extension: expands the pages' Markdown as `page_sources` says."""

from typing import Any

from generated_pages import generated_part, load_parts
from page_sources import DOCS, expand_page, shown_pages
from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the expansion to Sphinx."""
    shown = shown_pages()
    load_parts()

    def expand(app: Sphinx, name: str, source: list[str]) -> None:
        page = DOCS / f"{name}.md"
        if page.is_file():
            source[0] = expand_page(source[0], page, shown, generated_part)

    app.connect("source-read", expand)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
