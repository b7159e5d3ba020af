"""Where evaluations of a report come from, and what of it differs from what is installed."""

import json
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.evaluation.episode_sets.files import read_episode_set, set_names
from dune_rl.evaluation.folder import PROVENANCE
from dune_rl.reporting.runs import Note


def read_origin(path: Path) -> dict[str, Any]:
    """The provenance of an evaluation, empty for a study without; raises ConfigError if it is damaged."""
    file = path / PROVENANCE
    if not file.exists():
        return {}
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        content = None
    if isinstance(content, dict) and isinstance(content.get("files", {}), dict):
        return content
    raise ConfigError(
        f"{PROVENANCE} is damaged, so that nothing tells whether it is complete; evaluate again"
    )


def total_episodes(provenance: Mapping[str, Any]) -> str:
    """How many episodes an evaluation was to have, in words; nothing of runs, whose number is not known."""
    episodes, policies = provenance.get("episodes"), provenance.get("policies")
    if not isinstance(episodes, int):
        return ""
    return f" of {episodes * max(1, len(policies) if isinstance(policies, list) else 1)}"


def notes_on_origin(path: Path, provenance: Mapping[str, Any]) -> list[Note]:
    """What a reader must know of where an evaluation comes from: another set or version, or unknown."""
    if not provenance:
        return [
            Note(
                path,
                f"has no {PROVENANCE}: nothing says by which command, version and weights its episodes were "
                "made, nor whether they are complete and as they were written",
            )
        ]
    notes = []
    used = provenance.get("set")
    if isinstance(used, dict):
        installed = installed_checksum(str(used.get("name")))
        if installed is None:
            notes.append(Note(path, f"the set {used.get('name')} is not installed, so it is not checked"))
        elif installed != used.get("sha256"):
            notes.append(
                Note(
                    path,
                    f"was made on another set {used.get('name')} than the installed one (checksums "
                    f"{str(used.get('sha256'))[:12]} and {installed[:12]}): kept apart",
                )
            )
    packages = provenance.get("packages")
    made_with = packages.get("dune_rl") if isinstance(packages, dict) else None
    if made_with is not None and made_with != installed_version():
        notes.append(
            Note(path, f"was made with dune_rl {made_with}; this report is of {installed_version()}")
        )
    return notes


def installed_checksum(name: str) -> str | None:
    """The checksum of the installed episode set `name`; None where it is not among them or damaged."""
    if name not in set_names():
        return None
    try:
        return read_episode_set(name).header.sha256
    except ConfigError:
        return None


def installed_version() -> str:
    """The version of this package."""
    try:
        return version("dune_rl")
    except PackageNotFoundError:
        return "unknown"
