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

# What the parts of a provenance are, where they are there.
_KINDS = {"files": dict, "packages": dict, "git": dict, "hardware": dict, "policies": list, "command": list}


def read_origin(path: Path) -> dict[str, Any]:
    """The provenance of an evaluation, empty for a study without; raises ConfigError if it is damaged."""
    file = path / PROVENANCE
    if not file.exists():
        return {}
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        content = None
    if isinstance(content, dict):
        known = {str(key): value for key, value in content.items() if value is not None}
        if all(isinstance(known.get(key, kind()), kind) for key, kind in _KINDS.items()):
            return known
    raise ConfigError(
        f"{PROVENANCE} is damaged, so that nothing tells whether it is complete; evaluate again"
    )


def total_episodes(provenance: Mapping[str, Any]) -> str:
    """How many episodes an evaluation was to have, in words; nothing of runs, whose number is not known."""
    episodes = provenance.get("episodes")
    return "" if episodes is None else f" of {episodes * max(1, len(provenance.get('policies', ())))}"


def policy_origins(provenance: Mapping[str, Any], policy: str) -> list[dict[str, Any]]:
    """What the provenance says of the policy of this name, such as the place of its weights."""
    return [each for each in provenance.get("policies", ()) if each.get("name") == policy]


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
    made_with = provenance.get("packages", {}).get("dune_rl")
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
