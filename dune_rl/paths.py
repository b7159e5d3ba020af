"""Where the packaged configurations and assets lie, in a checkout and in an installed wheel."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def _data_folder(name: str) -> Path:
    installed = _PACKAGE / "_data" / name
    return installed if installed.is_dir() else _PACKAGE.parent / name


def conf_folder() -> Path:
    """The Hydra configuration tree, absolute."""
    return _data_folder("conf")


def assets_folder() -> Path:
    """Robot descriptions and their meshes, absolute."""
    return _data_folder("assets")
