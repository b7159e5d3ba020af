"""Registry of robots: built-in ones, those of installed packages, and those registered at run time."""

from dune_rl.core.errors import RobotError
from dune_rl.core.registry import Registry
from dune_rl.robots.robot import Robot
from dune_rl.robots.settings import RobotSettings

ROBOTS: Registry[Robot] = Registry(
    "robot",
    "dune_rl.robots.registry:ROBOTS",
    own={
        "rover_zero": "dune_rl.robots.rover_zero:RoverZero",
        "leo_rover": "dune_rl.robots.leo_rover:LeoRover",
        "hyperdog": "dune_rl.robots.hyperdog:HyperDog",
        "urdf": "dune_rl.robots.urdf.robot:UrdfRobot",
    },
    base=RobotSettings,
    product=Robot,
    form="a function of (num_robots) that returns a Robot, or a class of robots",
    function_leading=("num_robots",),
    class_leading=("num_robots",),
    error=RobotError,
)
