"""What a machine computed, in a file with which other machines compare."""

import json
import os
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field, ValidationError

from dune_rl.commands.doctor.checks import Finding, other_versions
from dune_rl.core.errors import ConfigError
from dune_rl.core.files import write_atomically
from dune_rl.core.paths import assets_folder

REFERENCE = assets_folder() / "doctor" / "reference.json"


class Reference(BaseModel):
    """Digests of short drives by "ENGINE WORLD", control steps per second, and what they were made with."""

    processor: str
    versions: dict[str, str]
    git: dict[str, Any] | None = None
    digests: dict[str, str]
    steps_per_s: int = Field(gt=0, lt=10**9)

    @classmethod
    def read(cls, path: Path) -> "Reference":
        """Raises ConfigError if `path` is no such file."""
        try:
            return cls.model_validate_json(path.read_bytes())
        except (OSError, ValidationError) as error:
            why = "is not a file that doctor wrote" if isinstance(error, ValidationError) else error.strerror
            raise ConfigError(
                f"reference={path}: {why}; write one on the other machine with out=FILE.json"
            ) from None

    def write(self, path: Path) -> None:
        """Write the file whole, or not at all."""
        with write_atomically(path) as temporary:
            temporary.write_text(json.dumps(self.model_dump(), indent=1) + "\n", encoding="utf-8")


def check_place(path: Path) -> None:
    """Raise ConfigError if no file can be written at `path`."""
    try:
        fits = path.is_file() or not path.exists()
        fits = fits and path.parent.is_dir() and os.access(path.parent, os.W_OK | os.X_OK)
    except OSError:
        fits = False
    if not fits:
        raise ConfigError(f"out={path}: no file can be written there; name one in a folder that is there")


def compare_drives(here: Reference, there: Reference, is_given: bool) -> Finding:
    """Whether short drives gave the bytes of the reference, and else why not.

    A difference is a fault only where processor and versions are equal. A reference that `is_given` may be of
    other code, that of the package is not.
    """
    common = [name for name in here.digests if name in there.digests]
    differ = [name for name in common if here.digests[name] != there.digests[name]]
    alone = sorted({*here.digests} ^ {*there.digests})
    more = f"; not compared: {', '.join(alone)}" if alone else ""
    if not common:
        return Finding("results", f"the reference has none of the drives{more}", is_fault=True)
    if not differ:
        text = f"{len(common)} of {len(common)} drives have the reference's bytes"
        return Finding("results", text + more)
    reasons = []
    if here.processor != there.processor:
        reasons.append(f"its processor is {there.processor}")
    if other_versions(here.versions, there.versions):
        reasons.append("its versions are others")
    if is_given and here.git != there.git:
        reasons.append("its code may be other")
    elif here.git is not None and here.git.get("changed"):
        reasons.append("the code here has changes that are not committed")
    text = f"{len(differ)} of {len(common)} drives differ from the reference ({', '.join(differ)})"
    why = " and ".join(reasons) or "though processor and versions are equal, which should not be: report it"
    return Finding("results", f"{text}: {why}{more}", is_fault=not reasons)
