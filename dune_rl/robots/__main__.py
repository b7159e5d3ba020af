"""`python -m dune_rl.robots FILE.urdf`: check a robot's description."""

from dune_rl.commands.command_line import command

if __name__ == "__main__":
    command("robots")()
