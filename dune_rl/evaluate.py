"""`python -m dune_rl.evaluate`: measure policies on numbered episodes."""

from dune_rl.commands.command_line import command

main = command("evaluate")

if __name__ == "__main__":
    main()
