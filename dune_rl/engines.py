"""`python -m dune_rl.engines`: compare the two physics engines."""

from dune_rl.commands.engines import main

if __name__ == "__main__":
    main()
