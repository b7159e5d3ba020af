"""Populations of actors for a cross-play: options of `actors`, and actors that runs trained."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from dune_rl.config.agents import NONE, AgentGroupConf, ResolvedGroup, roaming_task
from dune_rl.config.checks import validate
from dune_rl.config.commands import EvaluateConf
from dune_rl.config.compose import compose_environment
from dune_rl.config.saved import upgrade_saved
from dune_rl.config.schema import EnvConf
from dune_rl.core.errors import ConfigError, DuneError
from dune_rl.core.files import sha256_of
from dune_rl.core.paths import conf_folder
from dune_rl.core.suggestions import closest
from dune_rl.evaluation.policies import checkpoint_name
from dune_rl.learning.checkpoint import LAST_POLICY_FILE, read_policy_file

OPTION, CHECKPOINT = "option", "checkpoint"


@dataclass(frozen=True)
class ActorPopulation:
    """A population of actors: an option of `actors`, or the actors of a run with its weights.

    `kind` is "option" or "checkpoint". `groups` are the agent groups as plain data; `weights` is the file by
    which they act, and `sha256` its checksum.
    """

    name: str
    kind: str
    location: str
    weights: str | None
    sha256: str | None
    groups: Mapping[str, Any]

    def plain(self) -> dict[str, Any]:
        """What identifies it, as plain data: all but the settings of its groups."""
        return {key: value for key, value in asdict(self).items() if key != "groups"}


def find_populations(conf: EvaluateConf, config_dirs: Sequence[str] = ()) -> tuple[ActorPopulation, ...]:
    """The populations that `conf` names; `ConfigError` names every one that is none."""
    found, faults = [], []
    for location in conf.populations:
        try:
            found.append(_population(location, config_dirs))
        except DuneError as error:
            faults.append(f"populations: {error}")
    if faults:
        raise ConfigError("\n".join(faults))
    # Each has a folder of its name.
    count = Counter(one.name for one in found)
    for index, one in enumerate(found):
        if count[one.name] > 1:
            found[index] = replace(one, name=one.location.strip("/").replace("/", "_"))
    for name, number in Counter(one.name for one in found).items():
        if number > 1:
            raise ConfigError(f"populations: {name} is there twice; leave one of them out")
    return tuple(found)


def _population(location: str, config_dirs: Sequence[str]) -> ActorPopulation:
    options = [
        file.stem
        for folder in (conf_folder(), *map(Path, config_dirs))
        for file in sorted((folder / "actors").glob("*.yaml"))
    ]
    if location in options:
        option = compose_environment("flat", (), {"actors": location}, config_dirs=config_dirs).actors
        external = [name for name, group in option.items() if group.controller == "external"]
        if external:
            raise ConfigError(
                f"nobody drives {external[0]} of actors={location}; give a run that trained it in its place"
            )
        groups = {name: group.model_dump(mode="json") for name, group in option.items()}
        return ActorPopulation(location, OPTION, location, None, None, groups)
    path = Path(location)
    if not path.exists():
        if path.suffix or len(path.parts) > 1:
            raise ConfigError(f"there is no {location}; name a run, a policy file or an option of actors")
        if near := closest(location, options, 0.75):
            what = f"and no run; did you mean {near}? Options"
        else:
            what = f"and no run: there are {', '.join(sorted(options))}; options"
        raise ConfigError(f"{location} is no option of actors, {what} of your own need --config-dir FOLDER")
    # Of a run the last policy: its best is the robots' best, among which adversaries may do worst.
    file, content = read_policy_file(path, LAST_POLICY_FILE)
    config = upgrade_saved(content["config"])
    saved = {name: config[name] for name in EnvConf.model_fields if name in config}
    conf = validate(EnvConf, saved)
    actors = [one for one in conf.groups if one.name in conf.actors]
    if not any(one.is_external for one in actors):
        trained = ", ".join(sorted(content["groups"]))
        raise ConfigError(f"{location} trained no actors, but {trained}; give one that did")
    groups = {one.name: _plain(one, str(file)) for one in actors}
    return ActorPopulation(checkpoint_name(path), CHECKPOINT, location, str(file), sha256_of(file), groups)


def _plain(group: ResolvedGroup, weights: str) -> dict[str, Any]:
    """A group of a run as plain data, which acts by the file `weights` where it learned in that run."""
    values = {name: getattr(group, name) for name in AgentGroupConf.model_fields}
    sensors = {name: entry.model_dump(mode="json") for name, entry in (group.sensors or {}).items()}
    values |= {
        "controller": {"checkpoint": weights} if group.is_external else group.controller,
        "sensors": sensors or NONE,
        # Its goals, and no rewards, which nobody reads.
        "task": NONE if group.task is None else roaming_task(group.task),
        "metrics": NONE,
    }
    models = {name: value for name, value in values.items() if isinstance(value, BaseModel)}
    return values | {name: value.model_dump(mode="json") for name, value in models.items()}
