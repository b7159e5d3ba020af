"""`python -m dune_rl.drive`: play a bag into a policy, and print or write its actions."""

import csv
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import Field

from dune_rl.config.checks import validate
from dune_rl.core.errors import ConfigError
from dune_rl.core.files import write_csv
from dune_rl.core.settings import Settings
from dune_rl.ros.library import require_rosbags

_HINT = "python -m dune_rl.drive bag=FOLDER checkpoint=runs/NAME"
_TOPICS = "topics."


class DriveConf(Settings):
    """Settings of `python -m dune_rl.drive`; see `actions_from_bag`."""

    bag: str = Field(min_length=1)
    checkpoint: str = Field(min_length=1)
    topics: dict[str, str] = Field(default_factory=dict)
    robot: str | None = Field(None, min_length=1)
    base: str | None = Field(None, min_length=1)
    period_s: float | None = Field(None, gt=0.0, le=3600.0)
    out: str | None = Field(None, min_length=1)
    overwrite: bool = False


def parse_words(words: Sequence[str]) -> DriveConf:
    """The settings among the words of a command line; `ConfigError` where they are not valid."""
    values: dict[str, Any] = {"topics": {}}
    for word in words:
        key, equals, text = word.lstrip("+").partition("=")
        if not equals:
            raise ConfigError(f"cannot read {word!r}; write key=value: {_HINT}")
        if key.startswith(_TOPICS):
            values["topics"][key.removeprefix(_TOPICS)] = text
        else:
            values[key] = text
    missing = [f"{name} is missing: {_HINT}" for name in ("bag", "checkpoint") if name not in values]
    if missing:
        raise ConfigError(missing[0])
    return validate(DriveConf, values)


def run(words: Sequence[str]) -> None:
    """Play the bag that the command line names into the policy."""
    conf = parse_words(words)
    require_rosbags()
    out = None if conf.out is None else Path(conf.out)
    if out is not None and out.exists() and (out.is_dir() or not conf.overwrite):
        raise ConfigError(f"out={out} exists; choose another file, or overwrite=true")
    # Only now, since loading PyTorch takes seconds.
    from dune_rl.clients.bag_player import actions_from_bag

    found = actions_from_bag(
        conf.bag,
        conf.checkpoint,
        topics=conf.topics,
        robot=conf.robot,
        base=conf.base,
        period_s=conf.period_s,
    )
    rows = found.rows()
    if out is None:
        writer = csv.DictWriter(sys.stdout, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return
    out.parent.mkdir(parents=True, exist_ok=True)
    write_csv(out, rows)
    print(f"{len(rows):,} actions: {out}")
