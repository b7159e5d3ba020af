"""`python -m dune_rl.evaluate`: measure policies on numbered episodes."""

from dune_rl.commands.evaluate import main

if __name__ == "__main__":
    main()
