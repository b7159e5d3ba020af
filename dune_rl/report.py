"""`python -m dune_rl.report`: pages, figures and tables of runs and evaluations."""

from dune_rl.commands.report import main

if __name__ == "__main__":
    main()
