"""`python -m dune_rl.benchmark`: measure the cost of a step."""

from dune_rl.commands.command_line import command

main = command("benchmark")

if __name__ == "__main__":
    main()
