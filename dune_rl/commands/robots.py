"""Check of a URDF: `python -m dune_rl.robots FILE` prints the robot's derived values, or what is wrong."""

import warnings
from collections.abc import Sequence
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import ValidationError
from yaml import YAMLError

from dune_rl.commands.command_line import print_error
from dune_rl.core.errors import ConfigError
from dune_rl.core.suggestions import closest
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.robots.urdf.robot import UrdfRobot

_USAGE = "usage: python -m dune_rl.robots FILE.urdf [robot.SETTING=VALUE ...]"


def run(words: Sequence[str]) -> None:
    """Print a summary of the URDF that `words` begin with.

    Further words are settings of the robot, as on other command lines: `robot.drive.kind=skid_steer`.
    """
    if not words or any("=" not in word for word in words[1:]):
        raise ConfigError(_USAGE)
    try:
        conf = UrdfConf(**_settings(words[1:]) | {"path": words[0]})
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            summary = UrdfRobot(conf, 1).summary()
    except ValidationError as error:
        faults = [_sentence(fault["type"], fault["loc"], fault["msg"]) for fault in error.errors()]
        raise ConfigError("\n".join(faults)) from None
    except (OmegaConfBaseException, YAMLError) as error:
        raise ConfigError(f"{' '.join(words[1:])}: {str(error).splitlines()[0]}\n{_USAGE}") from None
    for warning in caught:
        print_error(f"warning: {warning.message}")
    print(summary)


def _sentence(kind: str, path: Sequence[int | str], message: str) -> str:
    """What is wrong with a setting, and what was probably meant."""
    name = ".".join(map(str, ("robot", *path)))
    if kind == "model_type":
        return f"{name} has settings of its own; write {name}.SETTING=VALUE (conf/robot/urdf.yaml)"
    if kind != "extra_forbidden":
        return f"{name}: {message.lower()}; see conf/robot/urdf.yaml"
    section: Any = UrdfConf
    for part in path[:-1]:
        field = section.model_fields.get(part) if hasattr(section, "model_fields") else None
        section = None if field is None else field.annotation
    near = closest(str(path[-1]), getattr(section, "model_fields", ()))
    if near is None:
        return f"{name} is not a setting; see conf/robot/urdf.yaml"
    return f"{name} is not a setting; did you mean {name.rpartition('.')[0]}.{near}?"


def _settings(words: Sequence[str]) -> dict[str, Any]:
    """Settings of the robot from words such as `robot.drive.kind=ackermann`; `robot.` may be left out."""
    found = OmegaConf.to_container(OmegaConf.from_dotlist([word.removeprefix("robot.") for word in words]))
    assert isinstance(found, dict), "a list of dotted words makes a dict"
    return {str(key): value for key, value in found.items()}
