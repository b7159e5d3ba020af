"""Which files an import depends on, so that its result can be kept until one of them changes."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path


class FileDependencies:
    """What has been looked at: `read` maps paths to digests of their bytes, `absent` are those not there.

    `complete` is False where the result depends on more than that.
    """

    def __init__(self) -> None:
        self.read: dict[str, str] = {}
        self.absent: set[str] = set()
        self.complete = True


_recording: ContextVar[FileDependencies | None] = ContextVar("recording", default=None)


@contextmanager
def record_dependencies() -> Iterator[FileDependencies]:
    """What is looked at within the block."""
    sources = FileDependencies()
    token = _recording.set(sources)
    try:
        yield sources
    finally:
        _recording.reset(token)


def record_read(path: Path, data: bytes) -> None:
    """The file at `path` had these bytes."""
    if (sources := _recording.get()) is not None:
        sources.read[str(path.absolute())] = hashlib.sha256(data).hexdigest()


def record_absent(path: Path) -> None:
    """There was nothing at `path` that could be used."""
    if (sources := _recording.get()) is not None:
        sources.absent.add(str(path.absolute()))


def mark_incomplete() -> None:
    """Something else decided, such as what lies in a folder or where a link leads."""
    if (sources := _recording.get()) is not None:
        sources.complete = False
