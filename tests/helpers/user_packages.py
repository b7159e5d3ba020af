"""Packages of users: the files that a text shows, installed as pip would leave them."""

import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dune_rl.behaviours.registry import BEHAVIOURS
from dune_rl.bodies.motion import MOTION_MODELS
from dune_rl.core.registry import Registry
from dune_rl.env.curriculum import CURRICULA
from dune_rl.env.randomisation import RANDOMISATIONS
from dune_rl.learning.networks.registry import ENCODERS
from dune_rl.learning.registry import ALGORITHMS
from dune_rl.metrics.registry import METRICS
from dune_rl.physics.interface import ENGINES
from dune_rl.robots.registry import ROBOTS
from dune_rl.sensors.registry import SENSORS
from dune_rl.tasks.registry import REWARDS, START_SOURCES, TERMINATIONS
from dune_rl.worlds.registry import WORLDS

REGISTRIES: tuple[Registry[Any], ...] = (
    *(WORLDS, ROBOTS, ENGINES, SENSORS, BEHAVIOURS, REWARDS, TERMINATIONS, METRICS, RANDOMISATIONS),
    *(ENCODERS, ALGORITHMS),
    *(START_SOURCES, MOTION_MODELS, CURRICULA),
)
_SHOWN_FILE = re.compile(r"^```\w+\n# ([\w/.]+)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
# Hydra wants the package in the first line.
_PACKAGED_FILE = re.compile(
    r"^```yaml\n(# @package _global_\n)# (\S+\.yaml)\n(.*?)^```$", re.MULTILINE | re.DOTALL
)


def shown_files(text: str) -> dict[str, str]:
    """The blocks of a text that open with a path, or have it behind Hydra's package, by it."""
    packaged = {name: header + content for header, name, content in _PACKAGED_FILE.findall(text)}
    return dict(_SHOWN_FILE.findall(text)) | packaged


def write_package(text: str, folder: Path) -> Path:
    """Write the files that a text shows to `folder`, and install the package that they make."""
    for name, content in shown_files(text).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    install_package(folder, project["name"], project["entry-points"])
    return folder


def install_package(folder: Path, package: str, groups: Mapping[str, Mapping[str, str]]) -> None:
    """What pip leaves beside a package's modules, for a folder that Python searches.

    `groups` are its entry points: `{"dune_rl.worlds": {"crater": "my_worlds:crater"}}`.
    """
    info = folder / f"{package.replace('-', '_')}-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 0.1\n")
    lines = [
        line
        for group, points in groups.items()
        for line in (f"[{group}]", *(f"{name} = {value}" for name, value in points.items()), "")
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))


@contextmanager
def registries_restored() -> Iterator[None]:
    """Afterwards no part is registered that was not before."""
    before = [dict(registry._user_parts) for registry in REGISTRIES]
    try:
        yield
    finally:
        for registry, parts in zip(REGISTRIES, before, strict=True):
            registry._user_parts.clear()
            registry._user_parts.update(parts)


@contextmanager
def packages_on_path(folder: Path) -> Iterator[None]:
    """Python finds what is in `folder`; afterwards none of its parts is known, and none of its modules."""
    modules = set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        with registries_restored():
            yield
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - modules:
            if str(folder) in str(getattr(sys.modules[name], "__file__", "")):
                del sys.modules[name]
