"""The folder of an export: what may stand in its place, and what says that it is one."""

import contextlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dune_rl.core.replaced_folder import check_replaceable, replace_folder

MANIFEST = "export.json"
_ENTRIES = "entries"


def check_folder(out: Path, *, overwrite: bool) -> None:
    """Raise ConfigError if `out` holds something that must stay; exports alone may be overwritten."""
    check_replaceable(out, "an export", _find_others, overwrite=overwrite)


def _find_others(out: Path) -> list[Path]:
    own = {MANIFEST, *_entries_of(out)}
    return [each for each in out.iterdir() if each.name not in own]


def _entries_of(out: Path) -> list[str]:
    """Names of what an export wrote into a folder; none for a folder without one."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        entries = json.loads((out / MANIFEST).read_bytes()).get(_ENTRIES)
        return [name for name in entries if isinstance(name, str)] if isinstance(entries, list) else []
    return []


@contextmanager
def replace_export(out: Path, manifest: Mapping[str, Any], *, overwrite: bool) -> Iterator[Path]:
    """An empty folder that takes the place of the export in `out`; see `replace_folder`.

    A file in it has the `manifest` and names its other entries.
    """
    with replace_folder(out, lambda: check_folder(out, overwrite=overwrite), last=MANIFEST) as new:
        yield new
        entries = sorted(each.name for each in new.iterdir())
        text = json.dumps({**manifest, _ENTRIES: entries}, indent=2) + "\n"
        (new / MANIFEST).write_text(text, encoding="utf-8")
