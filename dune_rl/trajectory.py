"""`python -m dune_rl.trajectory`: an actor's way through way-points."""

from dune_rl.commands.trajectory import main

if __name__ == "__main__":
    main()
