"""Sphinx extension: signatures have the names of array types (`Array`) in place of what these stand for."""

import re
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

_ARRAY = "ndarray[tuple[Any, ...], dtype[{}]]"
# The names that dune_rl.state gives these types.
_NAMES = {
    _ARRAY.format("float64"): "Array",
    _ARRAY.format("bool"): "Flags",
    _ARRAY.format("int64"): "Counts",
    _ARRAY.format("float32"): "Floats",
    _ARRAY.format("Any"): "Array",
}


_OTHER_ARRAY = re.compile(r"ndarray\[tuple\[Any, \.\.\.\], dtype\[(\w+)\]\]")
_ARRAY_LIKE = (
    "_Buffer | _SupportsArray[dtype[Any]] | _NestedSequence[_SupportsArray[dtype[Any]]] | complex | bytes"
    " | str | _NestedSequence[complex | bytes | str]"
)
# Ranges of settings, which the reference of settings has.
_RANGE = re.compile(r"Annotated\[([\w.]+), FieldInfo\(.*?\)\](?= =|\]|,|$)")


def shorten_types(text: str) -> str:
    """The text of a signature's part with short names of types, and without ranges."""
    for long, short in _NAMES.items():
        text = text.replace(long, short)
    text = _OTHER_ARRAY.sub(r"NDArray[\1]", text).replace(_ARRAY_LIKE, "ArrayLike")
    return _RANGE.sub(r"\1", text)


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the replacement to Sphinx."""

    def shorten(app: Sphinx, document: nodes.document, page: str) -> None:
        parts = (addnodes.desc_parameter, addnodes.desc_returns, addnodes.desc_annotation)
        for node in list(document.findall(lambda each: isinstance(each, parts))):
            assert isinstance(node, nodes.Element)
            text = "".join(child.astext() for child in node.children)
            short = shorten_types(text)
            if short != text:
                node.children.clear()
                node += addnodes.desc_sig_name("", short)

    def leave_out(
        app: Sphinx,
        what: str,
        name: str,
        thing: Any,
        options: Any,
        signature: str | None,
        returns: str | None,
    ) -> tuple[str | None, str | None]:
        # Nobody calls a protocol, and a default that is made for each object cannot be written.
        signature = "" if getattr(thing, "_is_protocol", False) else signature
        return signature and signature.replace("<factory>", "..."), returns

    app.connect("doctree-resolved", shorten)
    app.connect("autodoc-process-signature", leave_out)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
