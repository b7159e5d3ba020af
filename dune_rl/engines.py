"""`python -m dune_rl.engines`: compares the two physics engines."""

from dune_rl.engine_comparison.command_line import main

if __name__ == "__main__":
    main()
