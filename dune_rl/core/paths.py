"""Paths of the packaged configuration and assets, in a checkout and in a wheel, of the cache and results."""

import os
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

_LONGEST_STEM, _LONGEST_WORD = 120, 60
_PACKAGE = Path(__file__).resolve().parents[1]


def package_folder() -> Path:
    """The source text of dune_rl, absolute."""
    return _PACKAGE


def _data_folder(name: str) -> Path:
    installed = _PACKAGE / "_data" / name
    return installed if installed.is_dir() else _PACKAGE.parent / name


def conf_folder() -> Path:
    """The Hydra configuration tree, absolute."""
    return _data_folder("conf")


def assets_folder() -> Path:
    """Robot descriptions and their meshes, absolute."""
    return _data_folder("assets")


def cache_folder() -> Path | None:
    """Folder of the disk cache: $DUNE_RL_CACHE (None for "off" or an empty value), or ~/.cache/dune_rl.

    As the XDG base directory specification has it, $XDG_CACHE_HOME stands for ~/.cache if it is absolute.
    """
    named = os.environ.get("DUNE_RL_CACHE")
    if named is not None:
        return None if named.strip().lower() in ("", "off") else Path(named).expanduser().absolute()
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "dune_rl"
    except RuntimeError:
        # No home folder is known.
        return None


def unused_folder(parent: Path, now: datetime, words: Iterable[str]) -> Path:
    """A folder in `parent` that is not there yet: <date>_<words>, with a number behind it where one is."""
    stem = "_".join([f"{now:%Y-%m-%d_%H-%M-%S}", *map(file_stem, words)])[:_LONGEST_STEM]
    folder, number = parent / stem, 1
    while folder.exists():
        number += 1
        folder = parent / f"{stem}_{number}"
    return folder


def file_stem(text: str) -> str:
    """Text as a part of a file's name: letters, digits, -, _ and . alone."""
    kept = "".join(char if char.isascii() and (char.isalnum() or char in "-.") else "_" for char in text)
    return "_".join(filter(None, kept.split("_"))).strip("._")[:_LONGEST_WORD] or "unnamed"
