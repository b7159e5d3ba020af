"""`python -m dune_rl.view`: pictures, films and maps."""

from dune_rl.commands.view import main

if __name__ == "__main__":
    main()
