"""The software and the hardware that results depend on."""

import os
import platform
import shutil
import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dune_rl.core.paths import package_folder

if TYPE_CHECKING:
    from packaging.requirements import Requirement

# The extras whose packages results depend on.
_EXTRAS = ("", "onnx")
# Packages whose module has another name.
_MODULES = {"hydra-core": "hydra", "pillow": "PIL", "pycollada": "collada"}
_GIT_S = 10.0


def required_packages(extra: str = "") -> list["Requirement"]:
    """What this package needs on this system or, with `extra`, what that adds.

    Nothing where this package is not installed, but on the path alone.
    """
    try:
        lines = requires("dune_rl") or ()
    except PackageNotFoundError:
        return []
    # In the function, so that what misses this package can be told.
    from packaging.requirements import Requirement

    found = [Requirement(line) for line in lines]
    return [
        each
        for each in found
        if (each.marker is None or each.marker.evaluate({"extra": extra}))
        and (not extra or "extra" in str(each.marker))
    ]


def module_name(package: str) -> str:
    """The module by which a package that this one needs is imported: "PIL" of "pillow"."""
    return _MODULES.get(package, package.replace("-", "_"))


def package_versions() -> dict[str, str]:
    """Versions of this package and of all installed packages that it needs."""
    names = ["dune_rl", *(package.name for extra in _EXTRAS for package in required_packages(extra))]
    found = {}
    for name in names:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def available_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def git_commit() -> dict[str, Any] | None:
    """Commit of the checkout that this package is part of, and whether files differ from it; None without."""
    git, folder = shutil.which("git"), package_folder()
    if git is None:
        return None

    def ask(*words: str) -> str | None:
        try:
            answer = subprocess.run(
                [git, "-C", str(folder), *words], capture_output=True, text=True, timeout=_GIT_S, check=False
            )
        except (OSError, subprocess.TimeoutExpired):
            return None
        return answer.stdout.strip() if answer.returncode == 0 else None

    # An installed package may lie in a checkout of something else.
    if ask("ls-files", "--error-unmatch", "__init__.py") is None:
        return None
    commit, changed = ask("rev-parse", "HEAD"), ask("status", "--porcelain", "--untracked-files=no")
    return None if commit is None else {"commit": commit, "changed": bool(changed)}


def short_commit() -> str:
    """The commit's first twelve digits, with "+" where files differ from it; empty without a checkout."""
    found = git_commit()
    return "" if found is None else found["commit"][:12] + "+" * bool(found["changed"])


def processor_name() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def memory_gib() -> float | None:
    """Memory of the machine [GiB]; None where it is not known."""
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (AttributeError, OSError, ValueError):
        return None
