"""`python -m dune_rl.drive`: a policy drives a robot over live topics, or a bag is played into it."""

import csv
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Self

from pydantic import Field, model_validator

from dune_rl.commands import command_line
from dune_rl.config.checks import validate
from dune_rl.core.errors import ConfigError
from dune_rl.core.files import check_free, write_csv
from dune_rl.core.suggestions import split_word, typed_word
from dune_rl.ros.dds_types import require_live_topics
from dune_rl.ros.library import require_rosbags
from dune_rl.ros.settings import DrivingConf, NetworkConf

_HINT = "python -m dune_rl.drive checkpoint=runs/NAME"
_TOPICS, _PEERS = "topics.", "peers"
# What is of bags alone; all settings of live topics are those of the two other classes.
_OF_BAGS = ("out", "overwrite")


class DriveConf(DrivingConf, NetworkConf):
    """Settings of `python -m dune_rl.drive`; see `LiveDriver`, and with a `bag` `actions_from_bag`."""

    bag: str | None = Field(None, min_length=1)
    checkpoint: str | None = Field(None, min_length=1)
    policy: str | None = Field(None, min_length=1)
    topics: dict[str, str] = Field(default_factory=dict)
    robot: str | None = Field(None, min_length=1)
    base: str | None = Field(None, min_length=1)
    period_s: float | None = Field(None, gt=0.0, le=3600.0)
    out: str | None = Field(None, min_length=1)
    overwrite: bool = False

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if (self.checkpoint is None) == (self.policy is None):
            raise ValueError(f"give one policy, checkpoint=PATH or policy=FILE.onnx: {_HINT}")
        if self.policy is not None and Path(self.policy).suffix != ".onnx":
            raise ValueError(
                f"policy={self.policy} must end in .onnx; a run's is {typed_word('checkpoint', self.policy)}"
            )
        if self.checkpoint is not None and Path(self.checkpoint).suffix == ".onnx":
            raise ValueError(
                f"checkpoint={self.checkpoint} is an ONNX file: write {typed_word('policy', self.checkpoint)}"
            )
        live = {*DrivingConf.model_fields, *NetworkConf.model_fields}
        for name in self.model_fields_set & (live if self.bag is not None else {*_OF_BAGS}):
            other = "live topics: leave bag out" if self.bag is not None else "bags: give bag=FOLDER"
            raise ValueError(f"{name} is of {other}, or {name}")
        return self


def parse_words(words: Sequence[str]) -> DriveConf:
    """The settings among the words of a command line; `ConfigError` where they are not valid."""
    values: dict[str, Any] = {"topics": {}}
    for word in words:
        key, equals, text = split_word(word.lstrip("+"))
        if not equals:
            raise ConfigError(f"cannot read {word!r}; write key=value: {_HINT}")
        if key.startswith(_TOPICS):
            values["topics"][key.removeprefix(_TOPICS)] = text
        elif key == _PEERS:
            values[key] = [each.strip() for each in text.strip("[]").split(",") if each.strip()]
        else:
            values[key] = text
    return validate(DriveConf, values)


def run(words: Sequence[str]) -> None:
    """Drive on live topics, or play the bag that the command line names into the policy."""
    conf = parse_words(words)
    # Before what reads them is loaded, which takes seconds.
    for name, path in (("bag", conf.bag), ("policy", conf.policy)):
        if path is not None and not Path(path).exists():
            raise ConfigError(f"{name}={path}: there is no such {'file' if name == 'policy' else 'bag'}")
    if conf.bag is None:
        _drive(conf)
    else:
        _play(conf, conf.bag)


def _drive(conf: DriveConf) -> None:
    require_live_topics()
    # Only now, since loading PyTorch takes seconds.
    from dune_rl.clients.driven_policy import load_driven_policy
    from dune_rl.clients.live_driver import LiveDriver
    from dune_rl.learning.process import stop_on_signals
    from dune_rl.ros.dds import Participant

    report = partial(command_line.print_line, command_line.make_console())
    policy = load_driven_policy(conf.checkpoint, conf.policy, conf.robot)
    participant = Participant(conf)
    try:
        driver = LiveDriver(
            policy,
            participant,
            conf,
            report,
            origin=conf.where,
            topics=conf.topics,
            robot=conf.robot,
            base=conf.base,
            period_s=conf.period_s,
        )
        # Exceptions of signals would be lost in the code in C that calls Python for each message.
        with stop_on_signals() as stop:
            report(str(driver.run(stop)))
        if stop.signal is not None:
            sys.exit(128 + stop.signal)
    finally:
        participant.close()


def _play(conf: DriveConf, bag: str) -> None:
    require_rosbags()
    out = None if conf.out is None else Path(conf.out)
    if out is not None:
        check_free(out, overwrite=conf.overwrite)
    # Only now, since loading PyTorch takes seconds.
    from dune_rl.clients.bag_player import actions_from_bag

    found = actions_from_bag(
        bag,
        conf.checkpoint,
        onnx=conf.policy,
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
