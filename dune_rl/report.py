"""`python -m dune_rl.report`: pages, figures and tables of runs and evaluations."""

from dune_rl.commands.command_line import command

main = command("report")

if __name__ == "__main__":
    main()
