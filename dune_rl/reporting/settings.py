"""Settings of `python -m dune_rl.report`, and which of its words are folders."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from dune_rl.config.checks import validate
from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings


class ReportConf(Settings):
    """Settings of a report."""

    out: str | None = Field(None, min_length=1)
    overwrite: bool = False
    title: str | None = Field(None, min_length=1)
    into: str | None = Field(None, min_length=1)
    failures: int = Field(12, ge=0, le=100)


def parse_words(words: Sequence[str]) -> tuple[list[Path], ReportConf]:
    """The folders and the settings among the words of a command line; `ConfigError` where they are not valid.

    A word with = is a setting, unless there is a folder of that name.
    """
    folders = [word for word in words if "=" not in word or Path(word).exists()]
    settings = [word for word in words if word not in folders]
    values = {key: text for key, _, text in (word.partition("=") for word in settings)}
    conf = validate(ReportConf, values)
    if conf.into is None and not folders:
        raise ConfigError("name the folders of runs or evaluations: python -m dune_rl.report runs/NAME")
    others = [*folders, *(key for key in values if key != "into")]
    if conf.into is not None and others:
        raise ConfigError(
            f"into={conf.into} writes the tables that the file itself asks for; leave {others[0]} out"
        )
    return [Path(word) for word in folders], conf
