"""Sphinx extension: a link to a film (MP4) also plays it in the page."""

from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator


class Film(nodes.General, nodes.Element):
    """A film, with its `filename` below the folder of downloads."""


def setup(app: Sphinx) -> dict[str, Any]:
    """Place each film below the paragraph, or in the cell of the table, that links it."""

    def add_films(app: Sphinx, document: nodes.document, page: str) -> None:
        for link in list(document.findall(addnodes.download_reference)):
            name = link.get("filename", "")
            paragraph = link.parent
            while not isinstance(paragraph, nodes.paragraph | nodes.document):
                paragraph = paragraph.parent
            if name.endswith(".mp4") and isinstance(paragraph, nodes.paragraph):
                paragraph.parent.insert(paragraph.parent.index(paragraph) + 1, Film(filename=name))

    def visit(writer: HTML5Translator, node: Film) -> None:
        source = f"{writer.builder.dlpath}/{node['filename']}"
        writer.body.append(f'<video controls muted preload="metadata" src="{source}"></video>')

    app.add_node(Film, html=(visit, lambda writer, node: None))
    app.connect("doctree-resolved", add_films)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
