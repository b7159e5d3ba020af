"""`python -m dune_rl.ros`: a scene on live topics of ROS 2."""

from dune_rl.commands.command_line import command

if __name__ == "__main__":
    command("ros")()
