"""Words for what was probably meant, and for what there is to choose from."""

import difflib
from collections.abc import Iterable


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
