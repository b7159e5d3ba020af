"""What a run is called by in TensorBoard's table of hyperparameters."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from dune_rl.learning.run.events import HParam

# Of the algorithm's settings, those that say how it is run.
_NOT_LEARNED_WITH = ("name", "collector", "evaluation", "checkpoint", "threads", "replay")
_NOT_SETTINGS = ("run_dir", "resume", "film", "hydra")


def choose_hyperparameters(config: Mapping[str, Any], words: Sequence[str] = ()) -> dict[str, HParam]:
    """What tells runs apart in a resolved `config`: world, algorithm with settings, seed, and all `words`.

    `words` are those of the command line or of a job of a sweep, KEY=VALUE: whatever a sweep changes has a
    column, also in the run that has the default.
    """
    found: dict[str, HParam] = {}
    for name in ("world", "robot"):
        option = config.get(name)
        if isinstance(option, Mapping) and "name" in option:
            found[name] = str(option["name"])
    learning = config.get("learning") or {}
    if "name" in learning:
        found["algorithm"] = str(learning["name"])
    chosen = {key: value for key, value in learning.items() if key not in _NOT_LEARNED_WITH}
    found |= {f"learning.{name}": value for name, value in _leaves(chosen)}
    for name in ("seed", "total_frames"):
        if name in config:
            found[name] = config[name]
    for word in words:
        name, _, text = word.lstrip("+").partition("=")
        if text and not name.startswith("~") and name.split(".")[0].split("/")[0] not in _NOT_SETTINGS:
            found[name] = _value(config, name, text)
    return found


def _leaves(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, HParam]]:
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", _plain(value)


def _value(config: Mapping[str, Any], name: str, text: str) -> HParam:
    """The setting's resolved value; the word's text where it names an option of several settings."""
    found: Any = config
    for key in name.split("."):
        found = found.get(key) if isinstance(found, Mapping) else None
    return text if found is None or isinstance(found, Mapping) else _plain(found)


def _plain(value: Any) -> HParam:
    return value if isinstance(value, bool | int | float | str) else str(value)
