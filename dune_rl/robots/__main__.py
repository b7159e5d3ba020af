"""Check of a URDF: `python -m dune_rl.robots FILE` prints the robot's derived values, or what is wrong."""

import sys

from dune_rl.errors import RobotError
from dune_rl.robots.urdf.conf import UrdfConf
from dune_rl.robots.urdf.robot import UrdfRobot


def main(words: list[str]) -> int:
    """Print a summary of the URDF in `words`; returns 2 if it cannot be used."""
    if len(words) != 1:
        print("usage: python -m dune_rl.robots FILE.urdf", file=sys.stderr)
        return 2
    try:
        print(UrdfRobot(UrdfConf(path=words[0]), 1).summary())
    except RobotError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
