"""What a machine has: packages, and folders that can be written."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from dune_rl.core.machine import module_name, package_versions, required_packages
from dune_rl.core.paths import cache_folder
from dune_rl.physics.process import suppress_stderr

if TYPE_CHECKING:
    from rich.console import Console

# What extras of the package are for.
_EXTRAS = {"onnx": "policies in ONNX files"}
# What results depend on most.
_MAIN_PACKAGES = (
    "numpy",
    "numba",
    "torch",
    "torchrl",
    "tensordict",
    "pybullet",
    "dartpy",
    "gymnasium",
    "pettingzoo",
)
_WIDTH = 10
_INSTALL = "pip install -c constraints.txt -e ."


@dataclass(frozen=True)
class Finding:
    """A line of the report: what was looked at, what was found, and whether that is to be mended."""

    subject: str
    text: str
    is_fault: bool = False

    def show(self, console: "Console") -> None:
        """Print it, the text indented beside the subject."""
        from rich.padding import Padding
        from rich.table import Table
        from rich.text import Text

        row = Table.grid(padding=(0, 1, 0, 0))
        row.add_column(width=_WIDTH)
        row.add_column(overflow="fold")
        row.add_row(Text(self.subject, "red" if self.is_fault else "cyan"), Text(self.text))
        console.print(Padding(row, 0))


def check_packages(tested: Mapping[str, str]) -> list[Finding]:
    """What is missing or too old, what differs from the versions of the reference, and absent extras."""
    if not required_packages():
        text = "dune_rl is on the path and not installed, so that its packages are not known"
        return [Finding("packages", f"{text}: {_INSTALL}", is_fault=True)]
    here, found = package_versions(), []
    for package in required_packages():
        version = here.get(package.name)
        if version is None or not package.specifier.contains(version, prereleases=True):
            told = f"{package.name} {version}" if version else f"no {package.name}"
            wanted = f"{package.name}=={_public(tested[package.name])}" if package.name in tested else package
            text = f"{told}, but {package.specifier} is needed: pip install '{wanted}'"
            found.append(Finding("package", text, is_fault=True))
    main = ", ".join(f"{name} {here[name]}" for name in _MAIN_PACKAGES if name in here)
    found.append(Finding("libraries", main))
    others = other_versions(here, tested)
    text = "as in the reference"
    if others:
        text = f"other than in the reference: {', '.join(others)}"
    found.append(Finding("versions", text))
    for extra, purpose in _EXTRAS.items():
        absent = [package.name for package in required_packages(extra) if package.name not in here]
        if absent:
            text = f"no {', '.join(absent)}, for {purpose}: pip install 'dune_rl[{extra}]'"
            found.append(Finding("extra", text))
    return found


def check_imports() -> list[Finding]:
    """The packages that are there and cannot be imported."""
    found = []
    for package in required_packages():
        try:
            # PyBullet tells when it was built.
            with suppress_stderr():
                import_module(module_name(package.name))
        # Of any kind, as in the libraries in C that a package loads.
        except Exception as error:
            reason = str(error).partition("\n")[0]
            text = f"{package.name} cannot be imported: {reason}. Install the tested versions: {_INSTALL}"
            found.append(Finding("package", text, is_fault=True))
    return found


def other_versions(here: Mapping[str, str], there: Mapping[str, str]) -> list[str]:
    """Packages of both whose versions differ, without what follows a +: "numpy 2.4.6 (2.3.0)"."""
    return [
        f"{name} {here[name]} ({version})"
        for name, version in there.items()
        if name in here and _public(here[name]) != _public(version)
    ]


def _public(version: str) -> str:
    return version.partition("+")[0]


def check_cache() -> Finding:
    """Where worlds are kept for later processes."""
    folder = cache_folder()
    if folder is None:
        return Finding("cache", "off: every process builds its worlds anew")
    if _can_be_written(folder):
        return Finding("cache", f"worlds are kept in {folder}")
    return Finding("cache", f"{folder} cannot be written; set DUNE_RL_CACHE to a folder", is_fault=True)


def check_compiled() -> Finding:
    """Where compiled code is kept for later processes."""
    from dune_rl.geometry.frames import find_angles

    kept = getattr(find_angles._cache, "cache_path", None)  # type: ignore[attr-defined]
    if kept and _can_be_written(Path(kept)):
        return Finding("compiled", f"code is kept, for example in {kept}")
    text = "code cannot be kept, so that every process compiles for a minute; set NUMBA_CACHE_DIR to a folder"
    return Finding("compiled", text, is_fault=True)


def _can_be_written(folder: Path) -> bool:
    try:
        there = next(path for path in (folder, *folder.parents) if path.exists())
        return there.is_dir() and os.access(there, os.W_OK | os.X_OK)
    except OSError:
        return False
