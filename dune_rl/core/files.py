"""Files that are written whole or not at all, and their checksums."""

import contextlib
import csv
import hashlib
import os
import secrets
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from dune_rl.core.errors import CheckpointError, ConfigError, DuneError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_MOMENT_S = 5.0


def check_not_later(
    path: Path, version: object, known: int, written_by: object, error: type[DuneError]
) -> None:
    """Raise `error` if the format `version` of a file is later than the `known` one.

    `written_by` is the version of dune_rl that the file says it was written by; None where it says nothing.
    """
    if isinstance(version, int) and version > known:
        from dune_rl.core.untrusted_files import printable
        from dune_rl.core.version import VERSION

        writer = f"dune_rl {printable(written_by)}" if isinstance(written_by, str) else "a later dune_rl"
        raise error(
            f"{path} has format {version}, of {writer}; this is dune_rl {VERSION}, which reads format "
            f"{known}.\nInstall the version that wrote it, or a later one."
        )


@contextmanager
def write_atomically(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place, whole and on disk, unless the block fails.

    A link stays one: its target is replaced. What a process that was killed left beside it is removed.
    """
    asked, path = path, Path(os.path.realpath(path))
    _remove_abandoned(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    with errors_naming(asked):
        # Not `mkstemp`, whose files are for their owner alone.
        handle = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        # Until the end, so that others see that this process lives.
        try_lock(handle)
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
        os.close(handle)
    _sync_folder(path.parent)


def check_writable(folder: Path) -> None:
    """Raise ConfigError where a folder, which need not be there, cannot be made or written to."""
    there = next(each for each in (folder, *folder.parents) if os.path.lexists(each))
    if not there.exists():
        raise ConfigError(
            f"cannot write {folder}: {there} is a link that leads nowhere; choose another place"
        )
    if not there.is_dir():
        found = "a file of that name is in the way" if there == folder else f"{there} is a file"
        raise ConfigError(f"cannot write {folder}: {found}; choose another place")
    if not os.access(there, os.W_OK | os.X_OK):
        raise ConfigError(f"cannot write {folder}: no permission; choose another place")


def check_free(file: Path, *, overwrite: bool) -> None:
    """Raise ConfigError where a file cannot be made, or is there already and may not be replaced."""
    if file.is_dir():
        raise ConfigError(f"{file} is a folder: name a file")
    if file.exists() and not file.is_file():
        # Such as /dev/null, which a new file would replace.
        raise ConfigError(f"{file} is no ordinary file; choose another name")
    if file.exists() and not overwrite:
        raise ConfigError(f"{file} exists; choose another name, or overwrite=true")
    check_writable(file.parent if file.exists() or not file.is_symlink() else file)


@contextmanager
def removing_empty(folder: Path) -> Iterator[None]:
    """Remove `folder` and its parents at the end, those that were not there before and are empty."""
    new = [each for each in (folder, *folder.absolute().parents) if not each.exists()]
    try:
        yield
    finally:
        for each in new:
            with contextlib.suppress(OSError):
                each.rmdir()


@contextmanager
def errors_naming(path: Path) -> Iterator[None]:
    """Lets an OSError of a temporary file name the path that was to be written."""
    try:
        yield
    except OSError as error:
        error.filename = str(path)
        raise


def _remove_abandoned(path: Path) -> None:
    with contextlib.suppress(OSError):
        for other in path.parent.iterdir():
            if not (other.name.startswith(f".{path.name}.") and other.name.endswith(".tmp")):
                continue
            handle = os.open(other, os.O_RDWR)
            try:
                # A file that was begun this moment has no lock yet.
                abandoned = time.time() - os.fstat(handle).st_mtime > _MOMENT_S and try_lock(handle)
            finally:
                os.close(handle)
            if abandoned:
                other.unlink(missing_ok=True)


def try_lock(handle: int) -> bool | None:
    """Lock an open file; false where another process has it, None where there are no such locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        # As some network file systems answer.
        return None
    return True


def _sync_folder(folder: Path) -> None:
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file as hexadecimal digits; raises OSError if it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_csv(path: Path) -> list[dict[str, str]]:
    """The rows of a table that `write_csv` wrote; none without the file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def write_csv(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write `rows` atomically, one line each, with the columns of the first; raises CheckpointError."""
    try:
        with write_atomically(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]) if rows else [])
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise CheckpointError(
            f"{path} cannot be written: {error.strerror or error}.\nGive a folder that allows writing."
        ) from error
