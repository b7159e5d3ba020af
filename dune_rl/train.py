"""`python -m dune_rl.train`: train a robot."""

from dune_rl.commands.train import main

if __name__ == "__main__":
    main()
