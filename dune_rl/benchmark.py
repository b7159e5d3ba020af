"""`python -m dune_rl.benchmark`: measure the cost of a step."""

from dune_rl.commands.benchmark import main

if __name__ == "__main__":
    main()
