"""The folder of an export: what may stand in its place, and how it is put there as a whole."""

import contextlib
import json
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.core.files import errors_naming

MANIFEST = "export.json"
_ENTRIES = "entries"


def check_folder(out: Path, *, overwrite: bool) -> None:
    """Raise ConfigError if `out` holds something that must stay; exports alone may be overwritten."""
    parent = next(each for each in (out, *out.absolute().parents) if each.exists())
    if not parent.is_dir():
        raise ConfigError(f"cannot write {out}: {parent} is a file; choose another out=FOLDER")
    if not out.exists() or not any(out.iterdir()):
        return
    others = sorted({each.name for each in out.iterdir()} - {MANIFEST, *_entries_of(out)})
    if others:
        raise ConfigError(f"out={out} holds other files ({others[0]}); choose another folder")
    if not overwrite:
        raise ConfigError(f"out={out} holds an export already; choose another folder, or add overwrite=true")


def _entries_of(out: Path) -> list[str]:
    """Names of what an export wrote into a folder; none for a folder without one."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        entries = json.loads((out / MANIFEST).read_bytes()).get(_ENTRIES)
        return [name for name in entries if isinstance(name, str)] if isinstance(entries, list) else []
    return []


@contextmanager
def write_aside(out: Path, manifest: Mapping[str, Any], *, overwrite: bool) -> Iterator[Path]:
    """An empty folder beside `out` that takes its place when the block ends, and goes where the block fails.

    A file in it has the `manifest` and names its other entries. Raises ConfigError if `out` holds something
    that must stay.
    """
    check_folder(out, overwrite=overwrite)
    # A link stays one, and its target is what is on the same file system.
    place = out.resolve()
    made = [each for each in place.parents if not each.exists()]
    place.parent.mkdir(parents=True, exist_ok=True)
    with errors_naming(out):
        aside = Path(tempfile.mkdtemp(prefix=f".{place.name}.", suffix=".tmp", dir=place.parent))
    new, old = aside / "new", aside / "old"
    try:
        new.mkdir()
        yield new
        entries = sorted(each.name for each in new.iterdir())
        text = json.dumps({**manifest, _ENTRIES: entries}, indent=2) + "\n"
        (new / MANIFEST).write_text(text, encoding="utf-8")
        check_folder(out, overwrite=overwrite)
        if place.exists():
            place.rename(old)
        try:
            new.rename(place)
        except BaseException:
            if old.exists():
                old.rename(place)
            raise
        made = []
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()
