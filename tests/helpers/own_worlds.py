"""Worlds of a user's own: the files that a text shows, and packages as pip would leave them."""

import re
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dune_rl.worlds.registry import WORLDS

_SHOWN = re.compile(r"^```\w+\n# ([\w/.]+)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)


def write(text: str, folder: Path) -> Path:
    """Write the blocks of a text that open with a path to `folder`, and install the package they make."""
    for name, content in _SHOWN.findall(text):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    install(folder, project["name"], project["entry-points"]["dune_rl.worlds"])
    return folder


def install(folder: Path, package: str, worlds: dict[str, str]) -> None:
    """What pip leaves beside a package's modules, for a folder that Python searches."""
    info = folder / f"{package.replace('-', '_')}-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 0.1\n")
    lines = [f"{name} = {value}" for name, value in worlds.items()]
    (info / "entry_points.txt").write_text("\n".join(["[dune_rl.worlds]", *lines]) + "\n")


@contextmanager
def known(folder: Path) -> Iterator[None]:
    """Python finds what is in `folder`; afterwards no world of a user is known, and none of its modules."""
    modules, worlds = set(sys.modules), dict(WORLDS._user_parts)
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        WORLDS._user_parts.clear()
        WORLDS._user_parts.update(worlds)
        for name in set(sys.modules) - modules:
            if str(folder) in str(getattr(sys.modules[name], "__file__", "")):
                del sys.modules[name]
