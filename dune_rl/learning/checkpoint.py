"""Checkpoints: written atomically, read without executing anything in them."""

import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from pydantic import Field

from dune_rl.errors import CheckpointError
from dune_rl.files import write_atomically
from dune_rl.settings import Settings

FORMAT = "dune_rl"
VERSION = 2
CHECKPOINT_FILE = "checkpoint.pt"
BEST_POLICY_FILE = "policy.pt"
LAST_POLICY_FILE = "policy_last.pt"


class CheckpointConf(Settings):
    """How often a run is saved; it is always saved at its end and when interrupted."""

    every_frames: int = Field(200_000, ge=1)
    replay: bool = Field(True, description="keep the replay buffer too; an interrupted run always does")


def write(path: Path, kind: str, content: Mapping[str, Any]) -> None:
    """Write `content` (plain containers and tensors) as a file of this `kind`; raises CheckpointError."""
    try:
        with write_atomically(path) as temporary:
            torch.save({"format": FORMAT, "version": VERSION, "kind": kind, **content}, temporary)
    except OSError as error:
        raise CheckpointError(
            f"{path} cannot be written: {error.strerror or error}.\n"
            "Free some space or allow writing there; what was saved before is intact."
        ) from error


def read(path: Path, *kinds: str) -> dict[str, Any]:
    """The content of a file of one of these `kinds`, on the CPU; raises CheckpointError with a remedy."""
    if path.is_file() and not zipfile.is_zipfile(path):
        raise CheckpointError(
            f"{path} is truncated, or no checkpoint at all ({path.stat().st_size} bytes).\n"
            f"Copy it again, or give another {BEST_POLICY_FILE} or {CHECKPOINT_FILE} of the run's folder."
        )
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise CheckpointError(
            f"There is no {path}.\n"
            f"Give a run's folder, or a {BEST_POLICY_FILE} or {CHECKPOINT_FILE} inside one."
        ) from error
    except (OSError, RuntimeError, EOFError, ValueError, KeyError, pickle.UnpicklingError) as error:
        raise CheckpointError(_unreadable(path, error)) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise CheckpointError(
            f"{path} was not written by dune_rl.\nGive a {BEST_POLICY_FILE} or {CHECKPOINT_FILE} of a run."
        )
    if content["version"] != VERSION:
        raise CheckpointError(
            f"{path} has format {content['version']}; this dune_rl reads {VERSION}.\n"
            "Use the version of dune_rl that wrote it, or train anew."
        )
    if content["kind"] not in kinds:
        raise CheckpointError(f"{path} is a {content['kind']}, but a {' or '.join(kinds)} is needed here.")
    return content


def _unreadable(path: Path, error: Exception) -> str:
    if isinstance(error, OSError):
        return f"{path} cannot be read: {error.strerror or error}.\nCheck the path and its permissions."
    return (
        f"{path} is damaged, or was not written by dune_rl.\n"
        f"Give another {BEST_POLICY_FILE} or {CHECKPOINT_FILE} of the run's folder."
    )


def find(path: Path, *names: str) -> Path:
    """`path` itself, or the first of the files `names` that it holds as a folder; raises CheckpointError."""
    if not path.is_dir():
        return path
    for name in names:
        if (path / name).is_file():
            return path / name
    raise CheckpointError(
        f"The folder {path} holds no {' or '.join(names)}.\n"
        "Give the folder of one run; one that was killed before its first save holds none."
    )
