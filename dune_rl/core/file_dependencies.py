"""Tracking of the files that an import depends on, so that its result can be cached until one changes."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path


class FileDependencies:
    """Files that were read, with digests of their bytes, and paths that were `absent`.

    `complete` is False if the result depends on anything else.
    """

    def __init__(self) -> None:
        self.read: dict[str, str] = {}
        self.absent: set[str] = set()
        self.complete = True


_recording: ContextVar[FileDependencies | None] = ContextVar("recording", default=None)


@contextmanager
def record_dependencies() -> Iterator[FileDependencies]:
    sources = FileDependencies()
    token = _recording.set(sources)
    try:
        yield sources
    finally:
        _recording.reset(token)


def record_read(path: Path, data: bytes) -> None:
    """Record that the file at `path` had these bytes."""
    if (sources := _recording.get()) is not None:
        sources.read[str(path.absolute())] = hashlib.sha256(data).hexdigest()


def record_absent(path: Path) -> None:
    """Record that there was no usable file at `path`."""
    if (sources := _recording.get()) is not None:
        sources.absent.add(str(path.absolute()))


def mark_incomplete() -> None:
    """Record a dependency of another kind, such as a folder's listing or a link's target."""
    if (sources := _recording.get()) is not None:
        sources.complete = False
