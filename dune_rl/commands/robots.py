"""Check of a URDF: `python -m dune_rl.robots FILE` prints the robot's derived values, or what is wrong."""

import warnings
from collections.abc import Sequence

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from dune_rl.commands.command_line import print_error
from dune_rl.config.checks import validate
from dune_rl.core.errors import ConfigError
from dune_rl.core.settings import Settings
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.robots.urdf.robot import UrdfRobot

_USAGE = "usage: python -m dune_rl.robots FILE.urdf [robot.SETTING=VALUE ...]"


class _Words(Settings):
    robot: UrdfConf


def run(words: Sequence[str]) -> None:
    """Print a summary of the URDF that `words` begin with.

    Further words are settings of the robot, as on other command lines: `robot.drive.kind=skid_steer`.
    """
    if not words or any("=" not in word for word in words[1:]):
        raise ConfigError(_USAGE)
    try:
        given = OmegaConf.to_container(
            OmegaConf.from_dotlist([each.removeprefix("robot.") for each in words[1:]])
        )
    except (OmegaConfBaseException, YAMLError) as error:
        raise ConfigError(f"{' '.join(words[1:])}: {str(error).splitlines()[0]}\n{_USAGE}") from None
    assert isinstance(given, dict), "a list of dotted words makes a dict"
    conf = validate(_Words, {"robot": {**given, "path": words[0]}}).robot
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        summary = UrdfRobot(conf, 1).summary()
    for warning in caught:
        print_error(f"warning: {warning.message}")
    print(summary)
