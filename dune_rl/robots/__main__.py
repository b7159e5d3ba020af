"""`python -m dune_rl.robots FILE.urdf`: check a robot's description."""

import sys

from dune_rl.commands.robots import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
