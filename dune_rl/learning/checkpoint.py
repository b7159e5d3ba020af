"""Checkpoint files: written atomically, and read without executing code from them."""

import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field, ValidationError

from dune_rl.core.errors import CheckpointError, DuneError
from dune_rl.core.files import check_not_later, write_atomically
from dune_rl.core.untrusted_files import check_archive, first_line, printable
from dune_rl.core.version import VERSION as PACKAGE_VERSION

FORMAT = "dune_rl"
VERSION = 3
# The published policies of experiments/flat: one policy, with flat keys.
_OLD_POLICY_VERSION = 2
# Of a run: its settings, and all that it goes on with.
CONFIG_FILE = "config.yaml"
CHECKPOINT_FILE = "checkpoint.pt"
BEST_POLICY_FILE = "policy_best.pt"
LAST_POLICY_FILE = "policy_last.pt"
# A published policy.
POLICY_FILE = "policy.pt"
# What a folder is searched for, in this order, where it stands for a policy.
POLICY_SOURCES = (BEST_POLICY_FILE, POLICY_FILE, CHECKPOINT_FILE)


class _Entry(BaseModel):
    # The weights are checked by the network that takes them.
    algorithm: str
    spec: dict[str, Any]
    network: dict[str, Any]


class _Content(BaseModel):
    """What files of every kind have."""

    groups: dict[str, _Entry]
    config: dict[str, Any]
    started_from: dict[str, dict[str, str]] = {}


class _Counters(BaseModel, strict=True):
    # As much as 64 bits of TensorBoard's steps hold, and more.
    frames: int = Field(ge=0, lt=2**60)
    next_save: int
    next_evaluation: int
    evaluated_at: int
    best_score: float


class _Collector(BaseModel, strict=True):
    mode: str
    scenes: int
    warming: int | None
    level: float | None = None


class _Log(BaseModel, strict=True):
    recent: dict[str, Any]
    history: list[dict[str, Any]]
    has_session: bool


class _Progress(BaseModel):
    """What a training goes on with, beside its learners: `Trainer` writes and reads it."""

    counters: _Counters
    collector: _Collector
    log: _Log
    random: dict[str, Any]
    population: dict[str, Any] | None


def write_checkpoint_file(path: Path, kind: str, content: Mapping[str, Any]) -> None:
    """Write `content` (plain containers and tensors) as a file of this `kind`; raises CheckpointError."""
    # Imported here: the command lines import this module, and many of them do not need PyTorch.
    import torch

    try:
        with write_atomically(path) as temporary:
            head = {"format": FORMAT, "version": VERSION, "written_by": PACKAGE_VERSION, "kind": kind}
            torch.save({**head, **content}, temporary)
    except (OSError, RuntimeError) as error:
        # PyTorch's writer raises a RuntimeError, about offsets in the file, where the disk is full.
        reason = getattr(error, "strerror", None) or "the disk seems to be full"
        raise CheckpointError(
            f"{path} cannot be written: {reason}.\n"
            "Free some space or allow writing there; what was saved before is intact."
        ) from error


def read_checkpoint_file(path: Path, *kinds: str) -> dict[str, Any]:
    """The content of a file of one of these `kinds`, on the CPU; raises CheckpointError with a remedy."""
    import torch

    if path.is_file() and not zipfile.is_zipfile(path):
        raise CheckpointError(
            f"{path} is truncated, or no checkpoint at all ({path.stat().st_size} bytes).\n"
            f"Copy it again, or give another {BEST_POLICY_FILE} or {CHECKPOINT_FILE} of the run's folder."
        )
    try:
        with path.open("rb") as file:
            check_archive(file)
        content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise CheckpointError(
            f"There is no {path}.\n"
            f"Give a run's folder, or a {BEST_POLICY_FILE} or {CHECKPOINT_FILE} inside one, "
            "or a published policy.pt."
        ) from error
    # A damaged pickle may make its reader raise anything.
    except Exception as error:
        raise CheckpointError(_unreadable(path, error)) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise CheckpointError(
            f"{path} was not written by dune_rl.\nGive a {BEST_POLICY_FILE} or {CHECKPOINT_FILE} of a run."
        )
    version, kind = (printable(str(content.get(key))) for key in ("version", "kind"))
    if version not in (str(VERSION), str(_OLD_POLICY_VERSION)):
        check_not_later(path, content.get("version"), VERSION, content.get("written_by"), CheckpointError)
        raise CheckpointError(
            f"{path} has format {version}; this dune_rl reads {VERSION}.\n"
            "Use the version of dune_rl that wrote it, or train again."
        )
    if kind not in kinds:
        raise CheckpointError(f"{path} is a {kind}, but a {' or '.join(kinds)} is needed here.")
    with interpreting(path):
        if version == str(_OLD_POLICY_VERSION):
            content = _read_old_policy(content)
        _Content.model_validate(content)
    return content


def read_progress(path: Path) -> dict[str, Any]:
    """The content of a run's checkpoint, with which a training goes on; raises CheckpointError."""
    content = read_checkpoint_file(path, "checkpoint")
    with interpreting(path):
        _Progress.model_validate(content)
    return content


@contextmanager
def interpreting(path: Path) -> Iterator[None]:
    """A context in which the content of the file at `path` is used.

    What is not as dune_rl writes it becomes a CheckpointError.
    """
    try:
        yield
    except DuneError:
        raise
    except ValidationError as error:
        first = error.errors()[0]
        where = printable(".".join(map(str, first["loc"])))
        raise CheckpointError(_unreadable(path, ValueError(f"{where}: {first['msg']}"))) from error
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RuntimeError) as error:
        raise CheckpointError(_unreadable(path, error)) from error


def _read_old_policy(content: dict[str, Any]) -> dict[str, Any]:
    moved = {"spec": "layout", "network": "architecture", "policy": "policy"}
    entry = {"algorithm": "sac", **{key: content[old] for key, old in moved.items()}}
    rest = {key: value for key, value in content.items() if key not in moved.values()}
    return {**rest, "groups": {"rover": entry}}


def _unreadable(path: Path, error: Exception) -> str:
    if isinstance(error, OSError):
        return f"{path} cannot be read: {error.strerror or error}.\nCheck the path and its permissions."
    return (
        f"{path} is damaged, or was not written by dune_rl ({type(error).__name__}: {first_line(error)}).\n"
        f"Give another {BEST_POLICY_FILE} or {CHECKPOINT_FILE} of the run's folder."
    )


def find_checkpoint_file(path: Path, *names: str) -> Path:
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


def read_policy_file(path: Path, *first: str) -> tuple[Path, dict[str, Any]]:
    """A file of policies, or the file of a run's folder, and its content; raises CheckpointError.

    Of a folder it is the file of a name in `first`, else the best policy, else the published one.
    """
    file = find_checkpoint_file(path, *first, *POLICY_SOURCES)
    return file, read_checkpoint_file(file, "policy", "checkpoint")
