"""What a run is called by in TensorBoard's table of hyperparameters."""

from collections.abc import Mapping, Sequence
from typing import Any

from dune_rl.learning.run.events import HParam

# These say how a run is run, and not what is learned.
_LEFT_OUT = (
    *("run_dir", "resume", "film", "hydra", "device"),
    *("learning.collector", "learning.evaluation", "learning.checkpoint", "learning.threads"),
)


def choose_hyperparameters(config: Mapping[str, Any], words: Sequence[str] = ()) -> dict[str, HParam]:
    """What tells runs apart in a resolved `config`: world, robot, algorithm, seed, length, and all `words`.

    `words` are those of the command line or of a job of a sweep, KEY=VALUE: whatever a sweep changes has a
    column, also in the run that has the default. TensorBoard shows few columns at first: there are no others.
    """
    found: dict[str, HParam] = {}
    for name, section in (("world", "world"), ("robot", "robot"), ("algorithm", "learning")):
        option = config.get(section)
        if isinstance(option, Mapping) and "name" in option:
            found[name] = str(option["name"])
    for name in ("seed", "total_frames"):
        if name in config:
            found[name] = config[name]
    for word in words:
        name, _, text = word.lstrip("+").partition("=")
        left_out = any(name == each or name.startswith((f"{each}.", f"{each}/")) for each in _LEFT_OUT)
        if text and not name.startswith("~") and not left_out:
            found[name] = _value(config, name, text)
    return found


def _value(config: Mapping[str, Any], name: str, text: str) -> HParam:
    """The setting's resolved value; the word's text where it names an option of several settings."""
    found: Any = config
    for key in name.split("."):
        found = found.get(key) if isinstance(found, Mapping) else None
    if isinstance(found, bool | int | float | str):
        return found
    return text if found is None or isinstance(found, Mapping) else str(found)
