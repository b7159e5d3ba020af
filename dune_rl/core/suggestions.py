"""Words for what was probably meant, for what there is to choose from, and for what to type."""

import difflib
import re
import shlex
from collections.abc import Iterable

# Texts that Hydra takes as they are: no numbers, no words of its grammar.
_PLAIN = re.compile(r"(?!(?i:null|true|false|nan|inf)$)(\.{0,2}/)?[A-Za-z_][A-Za-z0-9_./-]*")


def closest(word: str, known: Iterable[str], likeness: float = 0.6) -> str | None:
    """The known word that was probably meant: at least so alike, of 1."""
    matches = difflib.get_close_matches(word, list(known), n=1, cutoff=likeness)
    return matches[0] if matches else None


def one_of(words: Iterable[str]) -> str:
    """The words as a choice: "a, b or c"."""
    listed = list(words)
    return listed[0] if len(listed) == 1 else f"{', '.join(listed[:-1])} or {listed[-1]}"


def advise(word: str, known: Iterable[str]) -> str:
    """What to write instead of an unknown word: "did you mean b?" or "choose a, b or c"."""
    listed = list(known)
    near = closest(word, listed)
    return f"did you mean {near}?" if near else f"choose {one_of(listed)}"


def text_word(key: str, text: str) -> str:
    """The override that sets `key` to a text."""
    return f"{key}={quote_text(text)}"


def quote_text(text: str) -> str:
    """A text in an override, in quotes where Hydra does not read it without."""
    if _PLAIN.fullmatch(text):
        return text
    # Before a quote, and at the end, backslashes are doubled.
    escaped = re.sub(r'(\\*)("|$)', lambda found: 2 * found[1] + (found[2] and '\\"'), text)
    return f'"{escaped}"'


def typed_word(key: str, text: object) -> str:
    """The override that sets `key` to a text, as it is typed in a shell."""
    return shlex.quote(text_word(key, str(text)))


def split_word(word: str) -> tuple[str, str, str]:
    """Key, "=" and text of a word that Hydra does not read; the quotes of `quote_text` are removed."""
    key, equals, text = word.partition("=")
    if len(text) > 1 and text[0] == text[-1] == '"':
        text = re.sub(r'(\\+)("|$)', lambda found: found[1][: len(found[1]) // 2] + found[2], text[1:-1])
    elif len(text) > 1 and text[0] == text[-1] == "'":
        text = text[1:-1]
    return key, equals, text
