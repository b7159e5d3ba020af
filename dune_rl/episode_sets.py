"""`python -m dune_rl.episode_sets`: list, make and check episode sets."""

from dune_rl.commands.episode_sets import main

if __name__ == "__main__":
    main()
